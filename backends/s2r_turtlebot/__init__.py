"""The `turtlebot` backend: drive to a goal and around an obstacle, on wheels that slip.

It is Example 1 of Akella, Ubellacker and Ames, and the smallest complete backend: copy it to begin your own. From top
to bottom: constants, controller, robot, and the declarations of a backend. ``effects.py`` adds unmodelled effects.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import ceil, cos, exp, hypot, sin, tanh
from pathlib import Path
from typing import Self

import numpy as np

from s2r_spec.backend import Channel, Parameter, read_test
from s2r_spec.trace import Trace


@dataclass(frozen=True)
class Constants:
    """The constants of a rollout, besides test and seed. Lengths in m, times in s."""

    start: tuple[float, float] = (-0.8, 0.0)
    goal: tuple[float, float] = (0.8, 0.0)
    step: float = 0.02  # control period
    speed: float = 0.4  # cruising speed [m/s]
    reach: float = 0.15  # distance to the goal within which the robot slows down
    ahead: float = 0.05  # distance from the axle to the steered point, which can move in any direction
    keep: float = 0.3  # distance from the obstacle's centre that the steered point keeps
    decay: float = 3.0  # fastest relative decrease of the barrier [1/s]
    swirl: float = 1.0  # speed around the obstacle close to it, as a share of the cruising speed
    slip: float = 0.1  # standard deviation of a wheel speed's relative error, averaged over one second


Body = Callable[..., tuple[float, ...]]


def ideal(*values: float) -> tuple[float, ...]:
    """Return the values unchanged: the robot measures its true pose, and drives as commanded. See effects.py."""
    return values


def steer(x: float, y: float, ox: float, oy: float, robot: Constants) -> tuple[float, float]:
    """Return the velocity [m/s] of the steered point: towards the goal, with a barrier around the obstacle.

    The desired velocity is an attraction to the goal plus a swirl around the obstacle, on the side where the straight
    path passes it, so that the robot does not stop in front of it. The result is the nearest velocity for which the
    barrier h = |p − o|² − keep² satisfies ḣ ≥ −decay h. This quadratic program has one constraint, and a projection on
    its half-plane solves it.
    """
    gx, gy = robot.goal[0] - x, robot.goal[1] - y
    distance = hypot(gx, gy)
    pull = robot.speed * tanh(distance / robot.reach) / max(distance, 1e-9)
    dx, dy = x - ox, y - oy
    square = max(dx * dx + dy * dy, 1e-9)
    barrier = square - robot.keep**2
    (sx, sy), (ex, ey) = robot.start, robot.goal
    side = 1.0 if (ex - sx) * (oy - sy) >= (ey - sy) * (ox - sx) else -1.0
    turn = side * robot.speed * robot.swirl * exp(-square / robot.keep**2) / robot.keep
    ux, uy = pull * gx - turn * dy, pull * gy + turn * dx
    lacking = max(0.0, -robot.decay * barrier - 2 * (dx * ux + dy * uy)) / (2 * square)
    return ux + lacking * dx, uy + lacking * dy


def command(pose: tuple[float, ...], ox: float, oy: float, robot: Constants) -> tuple[float, float]:
    """Return the commanded speed [m/s] and turning rate [rad/s] at a measured pose."""
    x, y, c, s = *pose[:2], cos(pose[2]), sin(pose[2])
    ux, uy = steer(x + robot.ahead * c, y + robot.ahead * s, ox, oy, robot)
    return c * ux + s * uy, (c * uy - s * ux) / robot.ahead


def drive(
    ox: float, oy: float, ticks: int, seed: int, robot: Constants, look: Body = ideal, wheels: Body = ideal
) -> np.ndarray:
    """Return (ticks + 1, 5) of x, y, heading, v and w, for a unicycle with white noise on speed and turning rate."""
    # The error in one tick exceeds the mean error over one second by the square root of the ratio of the two times.
    errors = np.random.default_rng(seed).normal(scale=robot.slip / robot.step**0.5, size=(ticks, 2))
    (x, y), heading = robot.start, 0.0
    rows = [(x, y, heading, 0.0, 0.0)]
    for forward, turning in errors.tolist():
        v, w = command(look(x, y, heading), ox, oy, robot)
        speed, rate = wheels(v, w)
        x += robot.step * speed * (1 + forward) * cos(heading)
        y += robot.step * speed * (1 + forward) * sin(heading)
        heading += robot.step * (rate + turning)
        rows.append((x, y, heading, v, w))
    return np.array(rows)


CHANNELS = (
    Channel("x", "m", "position of the middle of the axle"),
    Channel("y", "m", "position, to the left"),
    Channel("heading", "rad", "0 towards +x, not wrapped"),
    Channel("v", "m/s", "commanded forward speed, before slip"),
    Channel("w", "rad/s", "commanded turning rate, before slip"),
    Channel("d_goal", "m", "distance to the goal"),
    Channel("d_obs", "m", "distance to the centre of the obstacle"),
)
PARAMETERS = (
    Parameter("ox", "m", -0.4, 0.4, 0.0, "obstacle's centre, along the straight path"),
    Parameter("oy", "m", -1.0, 1.0, 1.0, "obstacle's centre, to the left of the straight path"),
)


@dataclass(frozen=True)
class TurtlebotBackend:
    """A two-wheeled robot that drives from (−0.8, 0) to (0.8, 0) m, with an obstacle at (ox, oy).

    The model has no collisions: the specification judges the distances. A rollout is a pure function of its parameters
    and its seed.
    """

    duration: float = 8.0
    constants: Constants = field(default_factory=Constants)
    name: str = field(default="turtlebot", init=False)
    deterministic: bool = field(default=True, init=False)
    channels: tuple[Channel, ...] = field(default=CHANNELS, init=False, repr=False)
    parameters: tuple[Parameter, ...] = field(default=PARAMETERS, init=False, repr=False)

    @property
    def cost(self) -> float:
        """Expected time of one rollout on one core [s]: about 3 µs a tick."""
        return 3e-6 * self.duration / self.constants.step

    @property
    def model_hash(self) -> str:
        """Hash of the constants and of this file."""
        return hashlib.sha256(repr(self.constants).encode() + Path(__file__).read_bytes()).hexdigest()

    def with_duration(self, seconds: float) -> Self:
        """Return this robot with rollouts of this duration [s]."""
        return replace(self, duration=seconds)

    def _body(self, seed: int) -> tuple[Body, Body]:
        """Return the localisation and the wheels, new for every rollout."""
        return ideal, ideal

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Run one test; a missing parameter takes its default, and an unknown one raises a UsageError."""
        ox, oy = read_test(self.name, self.parameters, params).values()
        step = self.constants.step
        ticks = ceil(self.duration / step - 1e-9)
        x, y, heading, v, w = drive(ox, oy, ticks, seed, self.constants, *self._body(seed)).T
        to_goal = np.hypot(x - self.constants.goal[0], y - self.constants.goal[1])
        columns = (x, y, heading, v, w, to_goal, np.hypot(x - ox, y - oy))
        units = {channel.name: channel.unit for channel in self.channels}
        return Trace(step * np.arange(ticks + 1.0), dict(zip(units, columns, strict=True)), units)
