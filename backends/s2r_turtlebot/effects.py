"""The turtlebot with a catalogue of unmodelled effects for ``s2r diagnose``.

An effect changes a number of :class:`Physics`: an error of the measured pose, or of the wheels' response to a command.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import exp
from pathlib import Path
from typing import Any, Self

import numpy as np

from s2r_spec.backend import Effect, read_test
from s2r_spec.effects import (
    Choice,
    ModelEffect,
    Values,
    add_effects,
    adds,
    as_values,
    choose,
    limits,
    read_options,
    scales,
    words,
)
from s2r_spec.trace import Trace
from s2r_turtlebot import Body, Constants, TurtlebotBackend, ideal

_AXLE = 0.16
"""[m] between the wheels."""
_CRUISE = 0.4
"""[m/s] at which slip of any power is the same."""


@dataclass(frozen=True)
class Physics:
    """Constants of the robot that effects change; with the defaults it measures its pose, and drives as commanded."""

    left: float = 0.0  # error of the measured position, to the left [m]
    heading: float = 0.0  # error of the measured heading [rad]
    delay: float = 0.0  # from a command to the wheels [s]
    jitter: float = 0.0  # standard deviation of the delay, as a share of it
    speed: float = 1.0  # fastest wheel [m/s]; at 1 there is no limit
    own: float = 0.0  # 0: at the limit both wheels slow down by one factor; 1: each has its own limit
    lag: float = 0.0  # time constant of the wheels' speed [s]
    dead: float = 0.0  # part of the lag that is dead time, as of a lag of several stages
    radius: float = 1.0  # of the wheels, over that of the drawing
    uneven: float = 0.0  # share by which the right wheel travels farther, and the left one less
    axle: float = 1.0  # length, over that of the drawing
    slip: float = 0.0  # loss of turning rate with speed [s/m]
    wheel: float = 0.0  # 0: with the robot's speed; 1: with the mean speed of its wheels, also on the spot
    power: float = 0.0  # 0: in proportion to speed; 1: to its square, with the same loss at :data:`_CRUISE`

    def look(self, x: Any, y: Any, heading: Any) -> tuple[Any, Any, Any]:
        """Return the measured pose [m, m, rad], of numbers or of arrays."""
        return x, y + self.left, heading + self.heading

    def wheels(self, step: float, seed: int) -> Body:
        """Return the wheels of one rollout.

        They take a command every ``step`` [s], and return speed [m/s] and turning rate [rad/s].
        """
        arrived = self._delayed(step, seed)
        lag = self.lag * (1.0 - self.dead)
        keep = exp(-step / lag) if lag else 0.0
        speed = rate = 0.0

        radius, uneven, axle = self.radius, self.uneven, self.axle

        def body(v: float, w: float) -> tuple[float, float]:
            nonlocal speed, rate
            v, w = self._limited(*arrived(v, w))
            speed, rate = v + keep * (speed - v), w + keep * (rate - w)
            v, w = radius * speed, radius * rate
            v, w = v + uneven * w * _AXLE / 2, w + uneven * v * 2 / _AXLE
            return v, w / axle / self._slipping(abs(v), abs(w) * _AXLE / 2)

        return body

    def _slipping(self, straight: float, turning: float) -> float:
        """Return the factor by which slip divides the turning rate, at speeds [m/s] of the robot and by its turn."""
        if not self.slip:
            return 1.0
        speed = straight + self.wheel * (max(straight, turning) - straight)
        return 1 + self.slip * speed * float((speed / _CRUISE) ** self.power)

    def _delayed(self, step: float, seed: int) -> Body:
        """Return the delay: the wheels receive u(t − delay), and stand still before the first command arrives.

        A command is held for a tick. If two apply within one tick, the result is their mean, weighted by their times.
        With a jitter every tick has a delay of its own, so that the mean delay stays as it is.
        """
        if not self.delay and not (self.lag and self.dead):
            return ideal
        # A stream of its own leaves the slip of a rollout as it is.
        random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
        sent = [(0.0, 0.0)]

        def arrived(v: float, w: float) -> tuple[float, float]:
            sent.append((v, w))
            delay = self.delay * max(0.0, 1 + self.jitter * random.normal()) if self.jitter else self.delay
            delay += self.dead * self.lag
            ticks, share = divmod(delay / step, 1)
            last = len(sent) - 1 - int(ticks)
            (v1, w1), (v0, w0) = sent[max(0, last - 1)], sent[max(0, last)]
            return v0 + share * (v1 - v0), w0 + share * (w1 - w0)

        return arrived

    def _limited(self, v: float, w: float) -> tuple[float, float]:
        """Return the speed and the turning rate that the fastest wheel allows."""
        if self.speed >= 1.0 or (fastest := abs(v) + abs(w) * _AXLE / 2) <= self.speed:
            return v, w
        left, right = (min(max(v + side * w * _AXLE / 2, -self.speed), self.speed) for side in (-1, 1))
        v, w = self.speed / fastest * v, self.speed / fastest * w
        return v + self.own * ((left + right) / 2 - v), w + self.own * ((right - left) / _AXLE - w)


def commands_at(pose: tuple[Any, ...], ox: float, oy: float, robot: Constants) -> tuple[Any, Any]:
    """Return :func:`s2r_turtlebot.command` at (n,) poses; the check of the backend compares both."""
    (sx, sy), (ex, ey), c, s = robot.start, robot.goal, np.cos(pose[2]), np.sin(pose[2])
    x, y = pose[0] + robot.ahead * c, pose[1] + robot.ahead * s
    gx, gy, dx, dy = ex - x, ey - y, x - ox, y - oy
    distance, square = np.maximum(np.hypot(gx, gy), 1e-9), np.maximum(dx * dx + dy * dy, 1e-9)
    pull = robot.speed * np.tanh(distance / robot.reach) / distance
    side = 1.0 if (ex - sx) * (oy - sy) >= (ey - sy) * (ox - sx) else -1.0
    turn = side * robot.speed * robot.swirl * np.exp(-square / robot.keep**2) / robot.keep
    ux, uy = pull * gx - turn * dy, pull * gy + turn * dx
    lacking = np.maximum(0.0, -robot.decay * (square - robot.keep**2) - 2 * (dx * ux + dy * uy)) / (
        2 * square
    )
    ux, uy = ux + lacking * dx, uy + lacking * dy
    return c * ux + s * uy, (c * uy - s * ux) / robot.ahead


effect = ModelEffect.of
CATALOGUE = (  # of a parameter: name, unit, low, high, nominal value, prior, and what it changes
    effect("position_bias", "sensing", "The robot's estimate of its position is this much too far to the left.",
           ("left", "m", -0.2, 0.2, 0.0, "normal, 0.04 m", adds("left"))),
    effect("heading_bias", "sensing", "The robot's estimate of its heading is this much too far to the left.",
           ("angle", "rad", -0.5, 0.5, 0.0, "normal, 0.1 rad", adds("heading"))),
    effect("latency", "timing",
           "Commands reach the wheels this much later; before the first one the wheels stand still. "
           "It varies from tick to tick; jitter is its standard deviation, as a share of it.",
           ("delay", "s", 0.0, 0.3, 0.0, "half-normal, 0.06 s", adds("delay")),
           ("jitter", "", 0.0, 0.5, 0.0, "half-normal, 0.15", adds("jitter"))),
    effect("speed_limit", "actuation",
           "No wheel turns faster than this. At own = 0 both slow down by the same factor; at own = 1 each has the "
           "limit by itself.",
           ("speed", "m/s", 0.1, 1.0, 1.0, "1 minus half-normal, 0.3 m/s", limits("speed")),
           ("own", "", 0.0, 1.0, 0.0, "uniform", adds("own"))),
    effect("motor_lag", "actuation",
           "The speed of the wheels follows the command with this time constant. A part of it may be dead time, as of "
           "a lag of several stages.",
           ("time", "s", 0.0, 0.5, 0.0, "half-normal, 0.1 s", adds("lag")),
           ("dead", "", 0.0, 0.8, 0.0, "half-normal, 0.25", adds("dead"))),
    effect("wheel_radius", "geometry", "Both wheels are larger than drawn by this factor, so the robot drives faster.",
           ("factor", "", 0.7, 1.3, 1.0, "normal around 1, standard deviation 0.1", scales("radius"))),
    effect("uneven_wheels", "geometry",
           "The right wheel travels farther by this share, and the left wheel less by it.",
           ("share", "", -0.1, 0.1, 0.0, "normal, 0.02", adds("uneven"))),
    effect("axle_length", "geometry",
           "The axle is longer than in the drawing by this factor, so the robot turns less.",
           ("factor", "", 0.5, 1.6, 1.0, "normal around 1, standard deviation 0.15", scales("axle"))),
    effect("turning_slip", "contact",
           "The faster the robot drives, the less it turns, because the wheels slide sideways. At wheel = 1 the speed "
           "is that of the wheels, at power = 1 its square counts.",
           ("coefficient", "s/m", 0.0, 4.0, 0.0, "half-normal, 0.8 s/m", adds("slip")),
           ("wheel", "", 0.0, 1.0, 0.0, "uniform", adds("wheel")),
           ("power", "", 0.0, 1.0, 0.0, "uniform", adds("power"))),
)  # fmt: skip


@dataclass(frozen=True)
class TurtlebotWithEffects(TurtlebotBackend):
    """The turtlebot with effects, at first none; :meth:`with_effects` adds them."""

    added: Choice = ()

    def __post_init__(self) -> None:
        """Set the name, with the added effects."""
        object.__setattr__(self, "name", ":".join(filter(None, ("turtlebot", ",".join(words(self.added))))))

    @property
    def model_hash(self) -> str:
        """Hash of the robot without effects, of the added effects, and of this file."""
        source = Path(__file__).read_bytes()
        return hashlib.sha256(f"{super().model_hash} {self._physics!r}".encode() + source).hexdigest()

    def effects(self) -> tuple[Effect, ...]:
        """Return the catalogue."""
        return CATALOGUE

    def chosen(self) -> Values:
        """Return effect → parameter → value of the added effects."""
        return as_values(self.added)

    def with_effects(self, values: Values) -> Self:
        """Return this robot with these effects added: ``{"latency": {"delay": 0.1}}``.

        Raises:
            UsageError: an effect or a parameter is unknown, or a value out of range.
        """
        return replace(self, added=choose("turtlebot", CATALOGUE, self.added, values))

    def commands(self, trace: Trace, params: Mapping[str, float]) -> Trace:
        """Return ``v`` and ``w`` of the law at the recorded poses, and the distances of these.

        See :class:`s2r_spec.backend.HasControlLaw`. A sample has the command of the tick that led to it, so that of
        the pose one sample before.
        """
        if not {"x", "y"} <= set(trace.channels):
            return trace.only(())
        ox, oy = read_test(self.name, self.parameters, params).values()
        x, y, goal = trace["x"], trace["y"], self.constants.goal
        law = {"d_goal": np.hypot(x - goal[0], y - goal[1]), "d_obs": np.hypot(x - ox, y - oy)}
        if "heading" in trace.channels:
            sent = commands_at(self._physics.look(x, y, trace["heading"]), ox, oy, self.constants)
            law |= {name: np.append(np.nan, one[:-1]) for name, one in zip("vw", sent, strict=True)}
        law = {name: values for name, values in law.items() if name in trace.channels}
        return trace.only(law).with_channels(lambda name, _: law[name])

    @property
    def _physics(self) -> Physics:
        return add_effects(Physics(), CATALOGUE, self.added)

    def _body(self, seed: int) -> tuple[Body, Body]:
        physics = self._physics
        if physics == Physics():
            return ideal, ideal
        return physics.look, physics.wheels(self.constants.step, seed)


def turtlebot(options: str = "") -> TurtlebotWithEffects:
    """Return the backend ``turtlebot``; ``turtlebot:latency.delay=0.1`` adds an effect.

    Raises:
        UsageError: as :meth:`TurtlebotWithEffects.with_effects`, or an option sets no effect.
    """
    return TurtlebotWithEffects(added=read_options("turtlebot", options, {}, CATALOGUE)[1])
