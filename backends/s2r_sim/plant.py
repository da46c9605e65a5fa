"""The plant: the robot in MuJoCo with its motors."""

from __future__ import annotations

from math import cos, isfinite

import mujoco
import numpy as np
from numpy.typing import NDArray

from s2r_sim import mujoco_model, rotation
from s2r_sim.figures import Robot
from s2r_sim.gains import RATE
from s2r_sim.physics import FallLimits, MotorCommand, Physics, State

FloatArray = NDArray[np.float64]


class Plant:
    """Steps the world from one control tick to the next.

    The motor law runs inside MuJoCo at every physics step: an affine actuator
    with force = ctrl − Kp q − Kd q̇ and ctrl = τ_ff + Kp q_des + Kd q̇_des,
    integrated implicitly and clipped to the torque limit.
    """

    def __init__(self, robot: Robot, physics: Physics) -> None:
        self.model = mujoco_model.build(robot, physics)
        self.data = mujoco.MjData(self.model)
        self._steps = round(1.0 / (RATE * physics.timestep))
        self._base = int(self.model.body("base").id)
        self.model.actuator_gainprm[:, 0] = 1.0
        # Live views of MuJoCo's own memory: asking for them at every tick would cost a wrapper each.
        qpos, qvel = self.data.qpos, self.data.qvel
        self._position, self._attitude, self._q = qpos[:3], qpos[3:7], qpos[7:]
        self._twist, self._dq = qvel[:6], qvel[6:]
        self._control, self._force = self.data.ctrl, self.data.xfrc_applied[self._base, :3]
        self._actuator_force, self._sensors = self.data.actuator_force, self.data.sensordata
        self._minus_kp = self.model.actuator_biasprm[:, 1]
        self._minus_kd = self.model.actuator_biasprm[:, 2]

    @property
    def foot_forces(self) -> FloatArray:
        """(12,) ground on feet, world axes [N], in the last physics step."""
        return np.array(self._sensors)

    @property
    def torque(self) -> FloatArray:
        """(12,) delivered by the motors [N m], in the last physics step."""
        return np.array(self._actuator_force)

    def truth(self) -> State:
        """Return the true state."""
        w, x, y, z = self._attitude.tolist()
        rpy = rotation.rpy_from_wxyz(w, x, y, z)
        return State(np.concatenate((self._position, rpy, self._twist, self._q, self._dq)))

    def place(self, position: FloatArray, rpy: FloatArray, q: FloatArray) -> None:
        """Put the robot at rest in a pose, with everything else as at the start of time."""
        mujoco.mj_resetData(self.model, self.data)
        self._set_pose(position, rpy, q)

    def displace(self, rise: float, rpy: FloatArray, q: FloatArray) -> None:
        """Add to base height [m], (3,) attitude [rad] and (12,) joint angles [rad]; speeds stay."""
        now = self.truth()
        self._set_pose(now.position + np.array([0.0, 0.0, rise]), now.rpy + rpy, now.q + q)

    def _set_pose(self, position: FloatArray, rpy: FloatArray, q: FloatArray) -> None:
        x, y, z, w = rotation.quaternion(*rpy.tolist())
        self._position[:], self._attitude[:], self._q[:] = position, (w, x, y, z), q

    def step(self, motors: MotorCommand, push: FloatArray | None = None) -> None:
        """Run the physics for one control tick under this command and (3,) force on the base [N]."""
        np.negative(motors.kp, out=self._minus_kp)
        np.negative(motors.kd, out=self._minus_kd)
        np.add(motors.tau, motors.kp * motors.q + motors.kd * motors.dq, out=self._control)
        self._force[:] = 0.0 if push is None else push
        mujoco.mj_step(self.model, self.data, self._steps)

    def save(self) -> FloatArray:
        """Return everything that decides the future of the world, as one vector."""
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        saved = np.empty(mujoco.mj_stateSize(self.model, kind))
        mujoco.mj_getState(self.model, self.data, saved, kind)
        return saved

    def restore(self, saved: FloatArray) -> None:
        """Continue from a saved world, and from nothing else."""
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, saved, mujoco.mjtState.mjSTATE_INTEGRATION)


def has_fallen(state: State, limits: FallLimits) -> bool:
    """Return whether the base is too low or too tilted, or the physics has diverged."""
    roll, pitch, _ = state.rpy.tolist()
    height = float(state.position[2])
    if not (isfinite(height) and isfinite(roll) and isfinite(pitch)):
        return True
    return height < limits.height or cos(roll) * cos(pitch) < cos(limits.tilt)
