"""Motion capture of a twin: its true pose at 200 Hz, on a clock of its own.

A line is JSON: ``{"t", "x", "y", "z", "qw", "qx", "qy", "qz"}``, with time [s], position of the base origin [m] and
attitude in the world frame. ``t`` differs from the robot's clock by a constant that depends only on the seed.
"""

from __future__ import annotations

import json

import numpy as np

from s2r_a1.wire import FloatArray
from s2r_sim.controller.gains import RATE
from s2r_sim.robot import rotation
from s2r_sim.robot.signals import RobotState

FREQUENCY = 200
"""A definition: poses per second."""
_KEYS = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")
_OFFSET = 1000.0
"""A level [s]: largest difference of the clocks, drawn from a uniform distribution."""


class Mocap:
    """Turns true states, one per round, into lines of poses, which are interpolated between two rounds."""

    def __init__(self, seed: int) -> None:
        self._offset = float(np.random.default_rng([seed, 5]).uniform(-_OFFSET, _OFFSET))
        self._before: FloatArray | None = None
        self._sent = 0

    def lines(self, round_: int, truth: RobotState) -> list[bytes]:
        """Return the lines of poses up to the end of a round."""
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
        pose[3:] /= np.linalg.norm(pose[3:])
        numbers = [seconds + self._offset, *pose.tolist()]
        return (json.dumps(dict(zip(_KEYS, numbers, strict=True))) + "\n").encode()
