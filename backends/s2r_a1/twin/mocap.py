"""Motion capture of a twin: its pose at 100 Hz with the noise of markers, on a clock of its own.

A line is JSON: ``{"t", "x", "y", "z", "qw", "qx", "qy", "qz"}``, with time [s], position of the base origin [m] and
attitude in the world frame. ``t`` differs from the robot's clock by a constant that depends only on the seed.
"""

from __future__ import annotations

import json
from collections import deque

import numpy as np

from s2r_a1.twin.injects import Injects, acting_faults
from s2r_a1.wire import FloatArray
from s2r_sim.controller.gains import RATE
from s2r_sim.robot import rotation
from s2r_sim.robot.signals import RobotState

FREQUENCY = 100
"""A definition: poses per second."""
POSITION_NOISE, ATTITUDE_NOISE = 1e-4, 1e-3
"""Levels [m] and [rad]: standard deviations of a pose, as of a body with markers about 0.1 m apart."""
_KEYS = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")
_OFFSET = 1000.0
"""A level [s]: largest difference of the clocks, drawn from a uniform distribution."""


class Mocap:
    """Turns true states, one per round, into lines of poses, which are interpolated between two rounds."""

    def __init__(self, seed: int, noise: bool) -> None:
        self._noise = np.random.default_rng([seed, 7]) if noise else None
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._offset = float(np.random.default_rng([seed, 5]).uniform(-_OFFSET, _OFFSET))
        self._before: FloatArray | None = None
        self._sent = 0

    def lines(self, round_: int, truth: RobotState, injects: Injects = ()) -> list[bytes]:
        """Return the lines of poses that arrive in a round, of poses up to its end."""
        late = sum(one.number for one in acting_faults(injects, round_, "late_poses"))
        self._waiting += [(round_ + round(late * RATE), line) for line in self._taken(round_, truth)]
        arriving = []
        while self._waiting and self._waiting[0][0] <= round_:
            arriving.append(self._waiting.popleft()[1])
        return arriving

    def _taken(self, round_: int, truth: RobotState) -> list[bytes]:
        x, y, z, w = rotation.quaternion(*truth.rpy.tolist())
        pose = np.array([*truth.position, w, x, y, z])
        before = pose if self._before is None else self._before
        if pose[3:] @ before[3:] < 0.0:  # q and −q are the same attitude
            pose[3:] *= -1.0
        self._before = pose
        lines = []
        # In units of 1 / (RATE · FREQUENCY) seconds all times are whole numbers.
        end = (round_ + 1) * FREQUENCY
        while self._sent * RATE <= end:
            part = 1.0 - (end - self._sent * RATE) / FREQUENCY
            lines.append(self._line(self._sent / FREQUENCY, before + part * (pose - before)))
            self._sent += 1
        return lines

    def _line(self, seconds: float, pose: FloatArray) -> bytes:
        if self._noise is not None:
            pose[:3] += POSITION_NOISE * self._noise.normal(size=3)
            w, turn = (
                pose[3],
                ATTITUDE_NOISE / 2.0 * self._noise.normal(size=3),
            )  # a small rotation, in body axes
            pose[3:] += np.array([-turn @ pose[4:], *(w * turn + np.cross(pose[4:], turn))])
        pose[3:] /= np.linalg.norm(pose[3:])
        numbers = [seconds + self._offset, *pose.tolist()]
        return (json.dumps(dict(zip(_KEYS, numbers, strict=True))) + "\n").encode()
