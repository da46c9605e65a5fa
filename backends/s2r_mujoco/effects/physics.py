"""What the effects of a catalogue change: numbers of a compiled model, of the gains, and of the loop.

Units: SI, angles in rad. Shapes: nv degrees of freedom, nu actuators.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Self

import mujoco
import numpy as np

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.joints import actuator_of
from s2r_mujoco.plan import Plan


@dataclass(frozen=True, eq=False)
class Edit:
    """Some of :attr:`Physics.amounts`, with their nominal values, and what writes them into a description."""

    at: slice
    nominal: FloatArray
    write: Callable[[Any, FloatArray], None]


@dataclass(frozen=True, eq=False)
class Physics:
    """Numbers that effects change; as :meth:`of` returns them, they change nothing.

    Attributes:
        friction, damping, armature: (nv,) added to each degree of freedom [N·m, N·m·s/rad, kg·m²; N, N·s/m, kg].
        strength, limit, stiffness, derivative: (nu,) factors of an actuator's force, limit, and gains kp and kd.
        position: (nv,) part by which the added friction grows from the middle of a joint's range to its upper end.
        offset: (nv,) added to the measured position of a joint [rad or m].
        mass, centre: added to the root body [kg], and (3,) shift of its centre of mass [m].
        ground: factor of all coefficients of friction.
        slope: (2,) angles by which gravity leans forward and to the left [rad].
        tilt: (2,) roll and pitch of the IMU on its body [rad].
        gyro: (3,) bias of the measured angular velocity [rad/s].
        sensing, sending: delay of what the policy sees, and of its targets [s].
        sensing_jitter, sending_jitter: standard deviations of both, as shares of them.
        lag: time constant of the targets [s].
        substeps: physics steps in place of one.
        softness: factor of the time constants of contacts.
        sag: share of their force that all actuators lose at a power of 1 W.
        amounts: numbers of the user's own effects, which ``edits`` write into the model's description.
    """

    friction: FloatArray
    damping: FloatArray
    armature: FloatArray
    strength: FloatArray
    limit: FloatArray
    stiffness: FloatArray
    derivative: FloatArray
    position: FloatArray
    offset: FloatArray
    mass: float = 0.0
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ground: float = 1.0
    slope: tuple[float, float] = (0.0, 0.0)
    tilt: tuple[float, float] = (0.0, 0.0)
    gyro: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sensing: float = 0.0
    sensing_jitter: float = 0.0
    sending: float = 0.0
    sending_jitter: float = 0.0
    lag: float = 0.0
    substeps: int = 1
    softness: float = 1.0
    sag: float = 0.0
    amounts: FloatArray = field(default_factory=lambda: np.zeros(0))
    edits: tuple[Edit, ...] = ()

    @classmethod
    def of(cls, model: Any) -> Self:
        """Return the numbers that change nothing."""
        none, same = np.zeros(model.nv), np.ones(model.nu)
        return cls(none, none, none, same, same, same, same, none, none)

    def plan(self, plan: Plan) -> Plan:
        """Return the plan with these gains, and with more physics steps in a control period."""
        actuators, limit = plan.joints.actuators, plan.law.torque_limit
        law = replace(
            plan.law,
            stiffness=plan.law.stiffness * self.stiffness[actuators],
            damping=plan.law.damping * self.derivative[actuators],
            torque_limit=limit * np.where(np.isfinite(limit), self.limit[actuators], 1.0),
        )
        return replace(plan, law=law, decimation=plan.decimation * self.substeps)

    def change(self, model: Any, plan: Plan) -> None:
        """Change a compiled model whose actuators have the gains of :meth:`plan`."""
        model.dof_frictionloss += self.friction
        model.dof_damping += self.damping
        model.dof_armature += self.armature
        self._change_actuators(model, plan)
        if self.mass or any(self.centre):
            self._load(model, root_body(model, plan))
        model.geom_friction[:] *= self.ground
        model.pair_friction[:] *= self.ground
        model.opt.timestep /= self.substeps
        for times in (model.geom_solref[:, 0], model.pair_solref[:, 0]):
            times[times > 0.0] *= self.softness
        model.opt.gravity[:] = leaning(model.opt.gravity, *self.slope)
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def edit(self, spec: Any) -> None:
        """Write the user's own effects into a model's description, before it is compiled."""
        for one in self.edits:
            if not np.array_equal(self.amounts[one.at], one.nominal):
                one.write(spec, self.amounts[one.at])

    def sagging(self, model: Any) -> Callable[[Any], None] | None:
        """Return what weakens a changed model by the power in its data; None where it stays as strong.

        A battery with the open voltage U and the inner resistance R has the voltage U − R I under a current I, and a
        motor's force is in proportion to it. With the power P = U I of all motors that drive, to first order:

            force / force of a full supply = 1 − r Σ_i max(F_i v_i, 0),   r = R / U²
        """
        if not self.sag:
            return None
        gain, bias = model.actuator_gainprm, model.actuator_biasprm
        whole = gain[:, :3].copy(), bias[:, :3].copy()

        def weaken(data: Any) -> None:
            power = np.maximum(data.actuator_force * data.actuator_velocity, 0.0).sum()
            left = max(1.0 - self.sag * power, 0.0)
            gain[:, :3], bias[:, :3] = left * whole[0], left * whole[1]

        return weaken

    def rubbing(self, model: Any) -> Callable[[FloatArray], None] | None:
        """Return what sets the friction of a changed model at (nq,) positions; None where it is the same at all."""
        grows = np.flatnonzero(self.friction * self.position)
        if not grows.size:
            return None
        joints = model.dof_jntid[grows]
        middle, half = model.jnt_range[joints].mean(axis=1), np.ptp(model.jnt_range[joints], axis=1) / 2.0
        rate, places = self.friction[grows] * self.position[grows] / half, model.jnt_qposadr[joints]
        same, friction = model.dof_frictionloss[grows].copy(), model.dof_frictionloss

        def rub(qpos: FloatArray) -> None:
            away = np.clip(qpos[places] - middle, -half, half)
            friction[grows] = np.maximum(same + rate * away, 0.0)

        return rub

    def _change_actuators(self, model: Any, plan: Plan) -> None:
        if plan.law.pd == "model":  # the gains of the model's own servos
            model.actuator_biasprm[:, 1] *= self.stiffness
            position = model.actuator_biasprm[:, 1] != 0.0
            model.actuator_gainprm[:, 0] *= np.where(position, self.stiffness, self.derivative)
            model.actuator_biasprm[:, 2] *= self.derivative
        model.actuator_gainprm[:, :3] *= self.strength[:, None]
        model.actuator_biasprm[:, :3] *= self.strength[:, None]
        model.actuator_forcerange[:] *= self.limit[:, None]
        plain = model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE
        model.actuator_ctrlrange[plain] *= self.limit[plain, None]
        for joint, actuator in actuator_of(model).items():
            if model.jnt_actfrclimited[joint]:
                model.jnt_actfrcrange[joint] *= self.limit[actuator]

    def _load(self, model: Any, body: int) -> None:
        """Add a mass with the inertia of the body's own shape, and shift its centre."""
        before = float(model.body_mass[body])
        model.body_mass[body] = before + self.mass
        model.body_inertia[body] *= (before + self.mass) / before
        model.body_ipos[body] += self.centre


VARIANTS: dict[str, dict[str, Any]] = {
    "half the time step": {"substeps": 2},
    "softer contacts": {"softness": 1.5},
}
"""Prior: simulators of the same physics, none better than the model itself; a judgement without a source."""


def root_body(model: Any, plan: Plan) -> int:
    """Return the body with the free joint, or of a fixed base the first that moves."""
    if plan.root >= 0:
        return plan.root
    moving = np.flatnonzero(model.body_weldid != 0)
    return int(moving[0]) if moving.size else 0


def leaning(gravity: FloatArray, forward: float, left: float) -> FloatArray:
    """Return (3,) gravity on a slope that falls forward and to the left by these angles [rad]."""
    rotation = rotated(-left, forward)
    return np.asarray(rotation.T @ gravity)


def rotated(roll: float, pitch: float) -> FloatArray:
    """Return (3, 3) the rotation by roll and pitch [rad]: its columns are the turned axes."""
    c, s, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    return np.asarray(about_y @ about_x)
