"""What is logged of a run, as channels: those of the simulator's trace, with their units.

The robot logs what its own sensors and drives have: encoders on the rotors with their offsets, an IMU that may be
askew, torques that the drives ask for and report. The lab sees base, feet and ground from outside, by motion
capture and force plates, and knows how they are.
"""

from __future__ import annotations

from math import cos, floor, log2, sin, tan

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.blind.a1.robot import Decision, own_velocity
from benchmarks.blind.a1.sensing import Errors, coloured
from benchmarks.blind.a1.world import RATE
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

UNITS = {
    "vx": "m/s", "vy": "m/s", "vz": "m/s", "wz": "rad/s", "vx_cmd": "m/s", "vy_cmd": "m/s", "wz_cmd": "rad/s",
    "vx_est": "m/s", "vy_est": "m/s", "x": "m", "y": "m", "z": "m", "height": "m", "roll": "rad", "pitch": "rad",
    "yaw": "rad", "omega": "rad/s", "acc_pred": "m/s^2", "qp_iterations": "", "qp_solved": "", "fallen": "",
    "stance": "", "q": "rad", "dq": "rad/s", "tau_cmd": "N*m", "tau": "N*m", "foot_position": "m",
    "foot_velocity": "m/s", "foot_force": "N", "contact": "",
}  # fmt: skip

NOISE = {
    "vx": 5e-4, "vy": 5e-4, "vz": 5e-4, "wz": 2e-3, "x": 1e-4, "y": 1e-4, "z": 1e-4, "height": 1e-4, "roll": 3e-4,
    "pitch": 3e-4, "yaw": 3e-4, "omega": 2e-3, "q": 2e-4, "dq": 5e-3, "tau_cmd": 5e-3, "tau": 2e-2,
    "foot_position": 2e-4, "foot_velocity": 1e-3, "foot_force": 0.5,
}  # fmt: skip
"""Standard deviations of what is logged, in each channel's unit; correlated over 4 ms.

They resolve about a quarter of that: a power of two, which 32-bit floats hold exactly.
"""

_TOUCHES = 1.0
"""[N] at which a contact switch closes."""


class Log:
    """Collects ticks, and makes a trace of them at the end."""

    def __init__(self, ticks: int, command: float, slope: float, torque_limit: float) -> None:
        self._command, self._slope = command, slope
        self._truth, self._rotors = np.zeros((ticks, 36)), np.zeros((ticks, 24))
        self._feet = np.zeros((ticks, 24))
        self._motors = np.zeros((ticks, 5, 12))
        self._rest = np.zeros((ticks, 12))
        self._torque = np.zeros((ticks, 12))
        self._force = np.zeros((ticks, 4, 3))
        self._n = 0

    def __len__(self) -> int:
        return self._n

    def write(
        self,
        truth: FloatArray,
        rotors: FloatArray,
        feet: FloatArray,
        done: Decision,
        torque: FloatArray,
        force: FloatArray,
    ) -> None:
        """Append a tick; ``rotors`` (24,) is by the encoders, ``force`` (4, 3) in the axes of the flat ground."""
        n = self._n
        self._truth[n], self._rotors[n] = truth, rotors
        self._feet[n], self._motors[n] = feet.ravel(), done.motors
        self._rest[n, :4], self._rest[n, 4:10] = done.stance, done.base
        self._rest[n, 10:] = done.iterations, done.solved
        self._torque[n], self._force[n] = torque, force
        self._n += 1

    def trace(
        self, measured: FloatArray, errors: Errors, settling: int, fallen: bool, rng: Generator
    ) -> Trace:
        """Return the trace; ``measured`` (ticks, 36) and errors begin ``settling`` ticks before the command."""
        n = self._n
        truth, feet, rest = self._truth[:n], self._feet[:n], self._rest[:n]
        vx, vy, vz = truth[:, 6:9].T
        c, s = np.cos(truth[:, 5]), np.sin(truth[:, 5])
        now = slice(settling, settling + n)
        own = self._own(measured[now], errors.force[now], _axes(*truth[:, 3:6].T))
        scale, bias = errors.scale[now], errors.bias[now]
        said = truth + errors.lasting[now]
        said[:, 6] = scale * vx + c * bias[:, 0] - s * bias[:, 1]
        said[:, 7] = scale * vy + s * bias[:, 0] + c * bias[:, 1]
        said[:, 12:] = self._rotors[:n]
        roll, pitch, yaw = said[:, 3:6].T
        axes = _axes(roll, pitch, yaw)
        spin = np.einsum("nij,nj->ni", axes, said[:, 9:12])
        q, dq, kp, kd, tau = (self._motors[:n, row] for row in range(5))
        force = self._force[:n] @ _leaning(self._slope).T
        values = {
            "vx": c * vx + s * vy,
            "vy": c * vy - s * vx,
            "vz": vz,
            "wz": spin[:, 2],
            "vx_cmd": np.full(n, self._command),
            "vy_cmd": np.zeros(n),
            "wz_cmd": np.zeros(n),
            "vx_est": scale * (c * own[:, 0] + s * own[:, 1]) + bias[:, 0],
            "vy_est": scale * (c * own[:, 1] - s * own[:, 0]) + bias[:, 1],
            "x": truth[:, 0],
            "y": truth[:, 1],
            "z": truth[:, 2],
            "height": truth[:, 2] - tan(self._slope) * truth[:, 0],
            "roll": roll,
            "pitch": pitch,
            "yaw": yaw,
            "omega": said[:, 9:12],
            "acc_pred": _felt(rest[:, 4:10], rest[:, 11], axes, said, c, s),
            "qp_iterations": rest[:, 10],
            "qp_solved": rest[:, 11],
            "fallen": np.append(np.zeros(n - 1), float(fallen)),
            "stance": rest[:, :4],
            "q": said[:, 12:24],
            "dq": said[:, 24:36],
            "tau_cmd": tau + kp * (q - said[:, 12:24]) + kd * (dq - said[:, 24:36]),
            "tau": self._torque[:n],
            "foot_position": feet[:, :12],
            "foot_velocity": feet[:, 12:],
            "foot_force": force.reshape(n, 12),
            "contact": (force[:, :, 2] > _TOUCHES).astype(float),
        }
        for name, deviation in NOISE.items():
            width = values[name].reshape(n, -1).shape[1]
            noise = coloured(rng, n, width, deviation, 0.004)
            step = 2.0 ** floor(log2(deviation / 4.0))
            values[name] = step * np.round((values[name] + noise.reshape(values[name].shape)) / step)
        meta = {"source": "twin of an A1"} | ({"failure": "fall"} if fallen else {})
        return Trace(np.arange(n) / RATE, values, units=UNITS, meta=meta)

    def _own(self, measured: FloatArray, force_error: FloatArray, axes: FloatArray) -> FloatArray:
        """Return (n, 3) the robot's own velocity estimate; it starts afresh at the command."""
        n = self._n
        change = np.diff(self._truth[:n, 6:9], axis=0, prepend=self._truth[:1, 6:9]) * RATE
        change[:, 2] += 9.81
        force = np.einsum("nji,nj->ni", axes, change) + force_error
        return own_velocity(measured, force, self._rest[:n, :4])


def _leaning(slope: float) -> FloatArray:
    """Return (3, 3) axes of the flat ground in the world, which has it rise along x by ``slope`` [rad]."""
    return np.array([[cos(slope), 0.0, -sin(slope)], [0.0, 1.0, 0.0], [sin(slope), 0.0, cos(slope)]])


def _axes(roll: FloatArray, pitch: FloatArray, yaw: FloatArray) -> FloatArray:
    """Return (n, 3, 3) base axes in the world, Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    return np.moveaxis(np.array(rows), 2, 0)


def _felt(
    spatial: FloatArray, solved: FloatArray, axes: FloatArray, said: FloatArray, c: FloatArray, s: FloatArray
) -> FloatArray:
    """Return (n, 3) the predicted acceleration of the trunk's origin, forward, left, up; 0 without a prediction."""
    velocity = np.einsum("nji,nj->ni", axes, said[:, 6:9])
    classical = spatial[:, :3] + np.cross(said[:, 9:12], velocity)
    world = np.einsum("nij,nj->ni", axes, classical)
    forward, left = c * world[:, 0] + s * world[:, 1], c * world[:, 1] - s * world[:, 0]
    return np.stack((forward, left, world[:, 2]), axis=1) * solved[:, None]
