"""The turtlebot with a catalogue of unmodelled effects for ``s2r diagnose``.

An effect is a small function that changes the measured pose, or the wheels' response to a command. Every rollout makes
it anew, so it may have a state.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import exp
from pathlib import Path
from typing import Self

from s2r_spec.backend import Effect, EffectParameter
from s2r_spec.effects import Choice, Values, as_values, choose, read_word, settings, words
from s2r_spec.errors import UsageError
from s2r_turtlebot import Body, Figures, TurtlebotBackend, ideal

_AXLE = 0.16
"""[m] between the wheels."""


@dataclass(frozen=True)
class BodyEffect(Effect):
    """An effect of this robot; ``make(figures, **values)`` returns its function for one rollout.

    ``order`` is its place in the loop: 0 for the measured pose, and from 1 on the path from a command to the ground.
    Effects act in this order, in whatever order they were added.
    """

    order: int
    make: Callable[..., Body]


def _position(figures: Figures, left: float) -> Body:
    return lambda x, y, heading: (x, y + left, heading)


def _heading(figures: Figures, angle: float) -> Body:
    return lambda x, y, heading: (x, y, heading + angle)


def _latency(figures: Figures, delay: float) -> Body:
    """Return wheels that receive u(t − delay), and stand still before the first command arrives.

    A command is held for a tick. If two apply within one tick, the result is their mean, weighted by their times.
    """
    ticks, share = divmod(delay / figures.step, 1)
    queue = deque([(0.0, 0.0)] * (int(ticks) + 1))

    def body(v: float, w: float) -> tuple[float, float]:
        queue.append((v, w))
        (v1, w1), (v0, w0) = queue.popleft(), queue[0]
        return v0 + share * (v1 - v0), w0 + share * (w1 - w0)

    return body


def _lag(figures: Figures, time: float) -> Body:
    keep = exp(-figures.step / time) if time else 0.0
    state = [0.0, 0.0]

    def body(v: float, w: float) -> tuple[float, float]:
        if keep:
            state[:] = v + keep * (state[0] - v), w + keep * (state[1] - w)
            return state[0], state[1]
        return v, w

    return body


def _speed_limit(figures: Figures, speed: float) -> Body:
    def body(v: float, w: float) -> tuple[float, float]:
        fastest = abs(v) + abs(w) * _AXLE / 2
        factor = min(1.0, speed / fastest) if fastest else 1.0
        return factor * v, factor * w

    return body


def _wheel_radius(figures: Figures, factor: float) -> Body:
    return lambda v, w: (factor * v, factor * w)


def _uneven_wheels(figures: Figures, share: float) -> Body:
    return lambda v, w: (v + share * w * _AXLE / 2, w + share * v * 2 / _AXLE)


def _axle_length(figures: Figures, factor: float) -> Body:
    return lambda v, w: (v, w / factor)


def _turning_slip(figures: Figures, coefficient: float) -> Body:
    return lambda v, w: (v, w / (1 + coefficient * abs(v)))


def _number(
    name: str, unit: str, low: float, high: float, nominal: float, prior: str
) -> tuple[EffectParameter]:
    return (EffectParameter(name, unit, low, high, nominal, prior),)


CATALOGUE = (
    BodyEffect(
        "position_bias", "sensing", "The robot's estimate of its position is this much too far to the left.",
        _number("left", "m", -0.2, 0.2, 0.0, "normal, 0.04 m"), 0, _position,
    ),
    BodyEffect(
        "heading_bias", "sensing", "The robot's estimate of its heading is this much too far to the left.",
        _number("angle", "rad", -0.5, 0.5, 0.0, "normal, 0.1 rad"), 0, _heading,
    ),
    BodyEffect(
        "latency", "timing", "Commands reach the wheels this much later; before the first one the wheels stand still.",
        _number("delay", "s", 0.0, 0.3, 0.0, "half-normal, 0.06 s"), 1, _latency,
    ),
    BodyEffect(
        "speed_limit", "actuation", "No wheel turns faster than this; both slow down by the same factor.",
        _number("speed", "m/s", 0.1, 1.0, 1.0, "1 minus half-normal, 0.3 m/s"), 2, _speed_limit,
    ),
    BodyEffect(
        "motor_lag", "actuation", "The speed of the wheels follows the command with this time constant.",
        _number("time", "s", 0.0, 0.5, 0.0, "half-normal, 0.1 s"), 3, _lag,
    ),
    BodyEffect(
        "wheel_radius", "geometry", "Both wheels are larger than drawn by this factor, so the robot drives faster.",
        _number("factor", "", 0.7, 1.3, 1.0, "normal around 1, standard deviation 0.1"), 4, _wheel_radius,
    ),
    BodyEffect(
        "uneven_wheels", "geometry", "The right wheel travels farther by this share, and the left wheel less by it.",
        _number("share", "", -0.1, 0.1, 0.0, "normal, 0.02"), 5, _uneven_wheels,
    ),
    BodyEffect(
        "axle_length", "geometry", "The axle is longer than in the drawing by this factor, so the robot turns less.",
        _number("factor", "", 0.5, 1.6, 1.0, "normal around 1, standard deviation 0.15"), 6, _axle_length,
    ),
    BodyEffect(
        "turning_slip", "contact", "The faster the robot drives, the less it turns, because the wheels slide sideways.",
        _number("coefficient", "s/m", 0.0, 4.0, 0.0, "half-normal, 0.8 s/m"), 7, _turning_slip,
    ),
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
        # By name, because an effect's repr has memory addresses, which differ between processes.
        changes = [(effect.name, values) for effect, values in self._changes()]
        return hashlib.sha256(f"{super().model_hash} {changes!r}".encode() + source).hexdigest()

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

    def _changes(self) -> list[tuple[BodyEffect, dict[str, float]]]:
        """Return the effects that are not nominal, in the order of their action."""
        chosen = settings(CATALOGUE, self.added)
        nominal = {effect.name: {p.name: p.nominal for p in effect.parameters} for effect in CATALOGUE}
        changed = (e for e in CATALOGUE if chosen.get(e.name, nominal[e.name]) != nominal[e.name])
        return [(effect, chosen[effect.name]) for effect in changed]

    def _body(self) -> tuple[Body, Body]:
        changes = [(e.order, e.make(self.figures, **values)) for e, values in self._changes()]
        look = [body for order, body in changes if order == 0]
        wheels = [body for order, body in changes if order > 0]
        return _chain(look), _chain(wheels)


def turtlebot(options: str = "") -> TurtlebotWithEffects:
    """Return the backend ``turtlebot``; ``turtlebot:latency.delay=0.1`` adds an effect.

    Raises:
        UsageError: as :meth:`TurtlebotWithEffects.with_effects`, or an option sets no effect.
    """
    robot = TurtlebotWithEffects()
    for word in filter(None, options.split(",")):
        values = read_word(word)
        if values is None:
            raise UsageError(
                f"the backend 'turtlebot' has no option {word!r}; its options are the parameters of its effects, such "
                f"as latency.delay=0.1"
            )
        robot = robot.with_effects(values)
    return robot


def _chain(parts: list[Body]) -> Body:
    if not parts:
        return ideal

    def body(*values: float) -> tuple[float, ...]:
        for part in parts:
            values = part(*values)
        return values

    return body
