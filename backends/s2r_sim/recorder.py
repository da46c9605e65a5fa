"""Writes down what happened, one row per control tick."""

from __future__ import annotations

from itertools import accumulate
from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from s2r_sim.base_task import Command
from s2r_sim.channels import CHANNELS
from s2r_sim.controller import Tick
from s2r_sim.physics import State

FloatArray = NDArray[np.float64]


class Recorder:
    """One row per control tick, one column per number, in the order of ``CHANNELS``."""

    def __init__(self, ticks: int) -> None:
        self._rows = np.zeros((ticks, sum(channel.width for channel in CHANNELS)))
        self.length = 0

    def write(
        self,
        truth: State,
        command: Command,
        done: Tick,
        torque: FloatArray,
        foot_forces: FloatArray,
        fallen: bool,
    ) -> None:
        """Append a row."""
        motors, solution = done.motors, done.solution
        roll, pitch, yaw = truth.rpy.tolist()
        x, y, height = truth.position.tolist()
        vx, vy, _ = truth.velocity.tolist()
        wx, wy, wz = truth.omega.tolist()
        scalars = (
            cos(yaw) * vx + sin(yaw) * vy,
            cos(yaw) * vy - sin(yaw) * vx,
            -sin(pitch) * wx + cos(pitch) * (sin(roll) * wy + cos(roll) * wz),
            *command,
            *(x, y, height, roll, pitch, yaw),
            0 if solution is None else solution.iterations,
            solution is not None,
            fallen,
            *done.stance,
        )
        asked = motors.tau + motors.kp * (motors.q - truth.q) + motors.kd * (motors.dq - truth.dq)
        row = self._rows[self.length]
        np.concatenate([scalars, truth.q, truth.dq, asked, torque, foot_forces], out=row)
        self.length += 1

    def channels(self) -> dict[str, FloatArray]:
        """Return name → (length,) or (length, width) samples written so far."""
        ends = accumulate(channel.width for channel in CHANNELS)
        rows = self._rows[: self.length]
        return {
            channel.name: rows[:, end - 1] if channel.width == 1 else rows[:, end - channel.width : end]
            for channel, end in zip(CHANNELS, ends, strict=True)
        }
