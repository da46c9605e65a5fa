"""Writes down what happened at every control tick, and makes channels of it at the end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from s2r_sim.base_task import Command
from s2r_sim.controller import Tick
from s2r_sim.physics import State

FloatArray = NDArray[np.float64]


class Recorder:
    """Keeps references tick by tick and computes over whole arrays once, which costs a tenth."""

    def __init__(self, command: Command) -> None:
        self._command = command
        self._truth: list[FloatArray] = []
        self._done: list[Tick] = []
        self._torque: list[FloatArray] = []
        self._foot_forces: list[FloatArray] = []

    def __len__(self) -> int:
        return len(self._done)

    def write(self, truth: State, done: Tick, torque: FloatArray, foot_forces: FloatArray) -> None:
        """Append a tick. The arrays must not change afterwards."""
        self._truth.append(truth.flat)
        self._done.append(done)
        self._torque.append(torque)
        self._foot_forces.append(foot_forces)

    def channels(self, fallen: bool) -> dict[str, FloatArray]:
        """Return name → (n,) or (n, width) samples, in the order of ``CHANNELS``.

        ``fallen`` says whether the last sample is that of a fall.
        """
        n = len(self)
        truth = State(np.array(self._truth).T)
        roll, pitch, yaw = truth.rpy
        vx, vy, _ = truth.velocity
        wx, wy, wz = truth.omega
        iterations = [0 if done.solution is None else done.solution.iterations for done in self._done]
        solved = [done.solution is not None for done in self._done]
        return {
            "vx": np.cos(yaw) * vx + np.sin(yaw) * vy,
            "vy": np.cos(yaw) * vy - np.sin(yaw) * vx,
            "wz": np.cos(pitch) * (np.sin(roll) * wy + np.cos(roll) * wz) - np.sin(pitch) * wx,
            "vx_cmd": np.full(n, self._command.vx),
            "vy_cmd": np.full(n, self._command.vy),
            "wz_cmd": np.full(n, self._command.wz),
            "x": truth.position[0],
            "y": truth.position[1],
            "height": truth.position[2],
            "roll": roll,
            "pitch": pitch,
            "yaw": yaw,
            "qp_iterations": np.array(iterations, dtype=float),
            "qp_solved": np.array(solved, dtype=float),
            "fallen": np.append(np.zeros(n - 1), float(fallen)),
            "stance": np.array([done.stance for done in self._done], dtype=float),
            "q": truth.q.T,
            "dq": truth.dq.T,
            "tau_cmd": self._asked(truth),
            "tau": np.array(self._torque),
            "foot_force": np.array(self._foot_forces),
        }

    def _asked(self, truth: State) -> FloatArray:
        """Return (n, 12) what the motor law asks for, before clipping [N m]."""
        q, dq, kp, kd, tau = (np.array(rows) for rows in zip(*(d.motors for d in self._done), strict=True))
        asked: FloatArray = tau + kp * (q - truth.q.T) + kd * (dq - truth.dq.T)
        return asked
