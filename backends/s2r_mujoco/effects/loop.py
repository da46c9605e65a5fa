"""What effects do between a robot and its controller: to the observation, and to the targets.

Observation at tick k, with the delay d of that tick in control periods, d = n + f:

    o_k = (1 − f) m_{k−n} + f m_{k−n−1},   m = R_imuᵀ v + bias of vectors, q + offset of joints

Target at physics step i, with its delay in physics steps, d = n + f, and the time constant of the lag:

    u_i = (1 − f) T(i − n) + f T(i − n − 1),   y_i = y_{i−1} + (1 − exp(−Δt/τ)) (u_i − y_{i−1})

T(i) is the target of the control period of step i. A command, a phase and the last action are the controller's own:
they have no delay. With jitter j a tick has the delay d max(0, 1 + j N(0, 1)).
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
        self._imu = rotated(*physics.tilt).T
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

    def measured(self, part: Part, values: FloatArray) -> FloatArray:
        """Return what the sensors say of a part of the observation, or of a sensor of the model."""
        if part.senses in ("vector", "angular"):
            values = (values.reshape(-1, 3) @ self._imu.T).ravel()
        if part.senses == "angular":
            values = values + np.resize(self._physics.gyro, values.size)
        return values + self._physics.offset[part.dof] if part.senses == "position" else values

    def positions(self, model: Any, qpos: FloatArray) -> FloatArray:
        """Return (n, nq) positions with the offsets of the joints' encoders."""
        joints = scalar_joints(model)
        places, dof = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        shifted = qpos.copy()
        shifted[:, places] += self._physics.offset[dof]
        return shifted

    def observed(self, values: FloatArray) -> FloatArray:
        """Return (m,) the values of all terms that the policy sees at a tick, from the true ones."""
        now = np.concatenate([self.measured(part, values[where]) for where, part in self._parts])
        if not self._physics.sensing:
            return now
        self._seen.append(now)
        whole, share = divmod(
            self._drawn(self._physics.sensing, self._physics.sensing_jitter) / self._step, 1.0
        )
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

    def _at(self, step: int) -> FloatArray:
        return self._sent[step // self._decimation] if step >= 0 else self._first

    def _drawn(self, delay: float, jitter: float) -> float:
        return delay * max(0.0, 1.0 + jitter * self._random.normal()) if delay and jitter else delay
