"""Residuals of a held robot: the torque of every joint that its model does not explain, by inverse dynamics.

    r = M(q) q̈ + c(q, q̇) + friction − τ,    τ of the actuators under the targets, or as logged

Positions pass a zero-phase Butterworth filter; velocities and accelerations are their differences. The targets, which
the robot holds for a period, and a delay of theirs, are shifted and pass the same filter. Where the log has the
attitude of the base, gravity turns with it.

Units: N·m, N of a slide. Source: Gautier, Janot & Vandanjon, *IEEE Transactions on Control Systems Technology* 21
(2013) 428 (filter of inverse-dynamics identification).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.channels import Attitude, joint_channels
from s2r_mujoco.held.player import Player, wide
from s2r_mujoco.rollout import Simulator
from s2r_spec.effects import Choice
from s2r_spec.errors import TraceError
from s2r_spec.protocols import PROTOCOL
from s2r_spec.trace import Trace
from s2r_spec.trace.samples import period_of

CUTOFF = 10.0
"""Definition: frequency from which on residuals are filtered [Hz]; motions of arms and legs are below half of it."""
SLOWEST = 4.0 * CUTOFF
"""Definition: lowest rate of a log with residuals [Hz]; of a slower one the accelerations are not known."""
CUT = 1.0 / CUTOFF
"""Definition: time at either end that the filter cannot compute [s]."""


def residuals(player: Player, trace: Trace, params: Mapping[str, float], added: Choice) -> Trace:
    """Return the residual of every hinge and slide: ``joint_torque_JOINT``, and ``joint_force_JOINT`` of a slide.

    Each joint has a channel of its own, since one joint with another law says nothing against the others.

    Raises:
        TraceError: the log has no positions, neither targets nor torques, or too few samples.
    """
    from scipy.signal import butter, sosfiltfilt

    period = period_of(trace.times)
    if not period * SLOWEST <= 1.0:
        raise TraceError(f"the log has {1.0 / period:.3g} samples a second, and residuals need {SLOWEST:g}")
    ends = int(np.ceil(CUT / period))
    if len(trace) <= 3 * ends:
        raise TraceError(f"the log lasts {trace.duration:.3g} s, and residuals need {3.0 * CUT:g} s")
    sos = butter(2, CUTOFF, fs=1.0 / period, output="sos")

    def smooth(values: FloatArray) -> FloatArray:
        return np.asarray(sosfiltfilt(sos, values, axis=0))

    simulator = player.running.simulator({}, player.known(added))
    motion = _Motion(player, simulator, trace, period, smooth)
    if (name := str(trace.meta.get(PROTOCOL, ""))) in {one.name for one in player.protocols()}:
        planned, _ = player.motion(name, params)
        rows = np.round((trace.times - trace.times[0]) / player.robot.plan.step).astype(int)
        motion.on = planned.on[np.minimum(rows, len(planned.on) - 1)]
    left = motion.residual()[ends:-ends]
    channels, units, parts = {}, {}, {}
    for own, joints in joint_channels(player.robot.model).items():
        name, unit = ("joint_torque", "N*m") if own == "q" else ("joint_force", "N")
        for joint, dof in zip(joints.names, joints.dof, strict=True):
            key = re.sub(r"\W", "_", f"{name}_{joint}", flags=re.ASCII)
            channels[key], units[key], parts[key] = left[:, [dof]], unit, [joint]
    return Trace(trace.times[ends:-ends], channels, units, {"parts": parts})


class _Motion:
    """The motion of a log, and the forces that a simulator's model needs for it, and has."""

    def __init__(
        self, player: Player, simulator: Simulator, trace: Trace, period: float, smooth: Any
    ) -> None:
        self._player, self._simulator, self._trace = player, simulator, trace
        model = player.robot.model
        self.q = np.tile(model.qpos0, (len(trace), 1))
        offset = np.zeros(model.nv) if simulator.loop is None else simulator.loop.offset
        self.v = np.zeros((len(trace), model.nv))
        self.a = np.zeros((len(trace), model.nv))
        for joints, q, _ in player.states(trace):
            q = smooth(q) - offset[joints.dof]
            self.q[:, joints.qpos] = q
            self.v[:, joints.dof] = np.gradient(q, period, axis=0)
            self.a[:, joints.dof] = np.gradient(self.v[:, joints.dof], period, axis=0)
        self._smooth, self._period = smooth, period
        self.on = np.ones(len(trace), dtype=np.bool_)

    def residual(self) -> FloatArray:
        """Return (n, nv) force that the motion needs beyond that of the actuators."""
        simulator, gravity = self._simulator, self._gravity()
        model, data = simulator.model, mujoco.MjData(simulator.model)
        force = (
            self._driven()
            if "target" in self._trace.channels
            else self._smooth(self._player.forces(self._trace))
        )
        before, flags = model.opt.gravity.copy(), int(model.opt.disableflags)
        off = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
        model.opt.disableflags = flags | int(off)
        needed = np.empty_like(self.v)
        try:
            for k in range(len(self.q)):
                data.qpos[:], data.qvel[:], data.qacc[:] = self.q[k], self.v[k], self.a[k]
                model.opt.gravity[:] = gravity[k]
                if simulator.rub is not None:
                    simulator.rub(self.q[k])
                mujoco.mj_inverse(model, data)
                needed[k] = data.qfrc_inverse
        finally:
            model.opt.gravity[:], model.opt.disableflags = before, flags
        return needed - force

    def _driven(self) -> FloatArray:
        """Return (n, nv) forces of the actuators under the targets of the log."""
        simulator, player = self._simulator, self._player
        targets = player.targets(self._trace)
        targets = self._smooth(simulator.arriving(targets, self._period))
        force = np.empty_like(self.v)
        for k, target in enumerate(targets):
            force[k] = simulator.actuated(self.q[k], self.v[k], target) if self.on[k] else 0.0
        return force if self.on.all() else self._smooth(force)

    def _gravity(self) -> FloatArray:
        """Return (n, 3) gravity in the axes in which the base is held; turned where the log has its attitude."""
        gravity = self._simulator.model.opt.gravity
        if "quaternion" not in self._trace.channels:
            return np.tile(gravity, (len(self._trace), 1))
        return np.einsum("nij,i->nj", Attitude(wide(self._trace, "quaternion")).matrix, gravity)
