"""What effects do between a robot and its controller: to the observation, and to the targets.

Observation at tick k, with the delay d of that tick in control periods, d = n + f:

    o_k = (1 − f) m_{k−n} + f m_{k−n−1},   m = R_imuᵀ v + bias of vectors, q + offset of joints

Target at physics step i, with its delay in physics steps, d = n + f, and the time constant of the lag:

    u_i = (1 − f) T(i − n) + f T(i − n − 1),   y_i = y_{i−1} + (1 − exp(−Δt/τ)) (u_i − y_{i−1})

T(i) is the target of the control period of step i. A command, a phase and the last action are the controller's own:
they have no delay. With jitter j a tick has the delay d max(0, 1 + j N(0, 1)).

A record has what a robot would log: positions and velocities of joints, sensors of the model, attitude and angular
velocity of the root as they were received; position and linear velocity of the root as motion capture has them, in a
world whose vertical is that of gravity.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp
from typing import Any

import numpy as np

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.effects.physics import Physics, rotated
from s2r_mujoco.joints import scalar_joints
from s2r_mujoco.observation import Part
from s2r_mujoco.plan import Plan


class Loop:
    """Observations and targets of one rollout after the other."""

    def __init__(self, physics: Physics, model: Any, plan: Plan, parts: Sequence[Part]) -> None:
        self._physics, self._step, self._decimation = physics, plan.step, plan.decimation
        self._model, self._root, self._imu = model, plan.root, rotated(*physics.tilt).T
        self._level = rotated(-physics.slope[1], physics.slope[0])
        ends = np.cumsum([0, *(part.width for part in parts)])
        self._parts = [(slice(a, b), part) for a, b, part in zip(ends[:-1], ends[1:], parts, strict=True)]
        known = [np.full(part.width, part.senses == "known") for part in parts]
        self._measured = ~np.concatenate([*known, np.zeros(0, dtype=bool)])
        self._keep = exp(-model.opt.timestep / physics.lag) if physics.lag else 0.0
        has_target = plan.law.has_target & ~plan.law.speed
        self._shift = np.where(has_target, physics.offset[plan.joints.dof], 0.0)
        self.begin(np.zeros(0), 0)

    def begin(self, first: FloatArray, seed: int) -> None:
        """Begin a rollout; ``first`` is the target before any arrives."""
        self._random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
        self._seen: list[FloatArray] = []
        self._sent: list[FloatArray] = []
        self._first, self._last = first, first
        self._late = 0.0
        self._ages: list[float] = []

    def measured(self, part: Part, values: FloatArray) -> FloatArray:
        """Return what the sensors say of a part of the observation, or of a sensor of the model."""
        if part.senses in ("vector", "angular"):
            values = (values.reshape(-1, 3) @ self._imu.T).ravel()
        if part.senses == "angular":
            values = values + np.resize(self._physics.gyro, values.size)
        return values + self._physics.offset[part.dof] if part.senses == "position" else values

    def received(self, values: FloatArray) -> FloatArray:
        """Return (n, m) measurements of all ticks as they were received at each tick."""
        if not self._ages:
            return values
        whole, share = np.divmod(np.array(self._ages[: len(values)])[:, None], 1.0)
        row = np.arange(len(values))[:, None] - whole.astype(int)
        one, other = (np.take_along_axis(values, np.maximum(row - k, 0), axis=0) for k in (0, 1))
        return np.asarray((1.0 - share) * one + share * other)

    @property
    def offset(self) -> FloatArray:
        """(nv,) by how much the encoder of each joint reads too much [rad or m]."""
        return self._physics.offset

    def state(self, qpos: FloatArray, qvel: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (n, nq) positions and (n, nv) velocities as a robot logs them."""
        model, qpos, qvel = self._model, qpos.copy(), qvel.copy()
        joints = scalar_joints(model)
        places, dof = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        qpos[:, places] = self.received(qpos[:, places] + self._physics.offset[dof])
        qvel[:, dof] = self.received(qvel[:, dof])
        if self._root >= 0:
            joint = int(model.body_jntadr[self._root])
            p, v = int(model.jnt_qposadr[joint]) + 3, int(model.jnt_dofadr[joint])
            qvel[:, v : v + 3] = qvel[:, v : v + 3] @ self._level.T
            qvel[:, v + 3 : v + 6] = self.received(qvel[:, v + 3 : v + 6] @ self._imu.T + self._physics.gyro)
            qpos[:, p : p + 4] = self.received(self._attitudes(qpos[:, p : p + 4]))
        return qpos, qvel

    def _attitudes(self, quaternions: FloatArray) -> FloatArray:
        """Return (n, 4) attitudes of the IMU in a world whose vertical is that of gravity."""
        if not any((*self._physics.slope, *self._physics.tilt)):
            return quaternions
        from scipy.spatial.transform import Rotation

        level, imu = Rotation.from_matrix(self._level), Rotation.from_matrix(self._imu.T)
        turned = (level * Rotation.from_quat(quaternions, scalar_first=True) * imu).as_quat(scalar_first=True)
        return np.asarray(turned * np.sign(np.sum(turned * quaternions, axis=1))[:, None])

    def observed(self, values: FloatArray) -> FloatArray:
        """Return (m,) the values of all terms that the policy sees at a tick, from the true ones."""
        now = np.concatenate([self.measured(part, values[where]) for where, part in self._parts])
        if not self._physics.sensing:
            return now
        self._seen.append(now)
        self._ages.append(self._drawn(self._physics.sensing, self._physics.sensing_jitter) / self._step)
        whole, share = divmod(self._ages[-1], 1.0)
        last = len(self._seen) - 1 - int(whole)
        late = (1.0 - share) * self._seen[max(last, 0)] + share * self._seen[max(last - 1, 0)]
        return np.where(self._measured, late, now)

    def send(self, target: FloatArray) -> None:
        """Send the target of a tick."""
        self._sent.append(target - self._shift if self._shift.size == target.size else target)
        self._late = self._drawn(self._physics.sending, self._physics.sending_jitter)

    def arrived(self, step: int) -> FloatArray:
        """Return the target that acts at a physics step of the present tick, the first of which is 0."""
        whole, share = divmod(self._late * self._decimation / self._step, 1.0)
        place = (len(self._sent) - 1) * self._decimation + step - int(whole)
        target = (1.0 - share) * self._at(place) + share * self._at(place - 1) if share else self._at(place)
        self._last = target + self._keep * (self._last - target)
        return self._last

    def arriving(self, targets: FloatArray, period: float) -> FloatArray:
        """Return (n, joints) targets of a log as they act on average, one row every ``period`` [s]: without jitter."""
        from scipy.signal import lfilter

        rows = np.arange(len(targets), dtype=np.float64)
        late = rows - (self._physics.sending + 0.5 * self._step) / period
        sent = np.stack([np.interp(late, rows, one) for one in (targets - self._shift).T], axis=1)
        if not self._physics.lag:
            return sent
        keep = exp(-period / self._physics.lag)
        return np.asarray(lfilter([1.0 - keep], [1.0, -keep], sent - sent[0], axis=0) + sent[0])

    def _at(self, step: int) -> FloatArray:
        return self._sent[step // self._decimation] if step >= 0 else self._first

    def _drawn(self, delay: float, jitter: float) -> float:
        return delay * max(0.0, 1.0 + jitter * self._random.normal()) if delay and jitter else delay
