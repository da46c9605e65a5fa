"""The plant: the robot in MuJoCo with its motors, on its ground."""

from __future__ import annotations

from math import cos, isfinite
from typing import NamedTuple

import mujoco
import numpy as np

from s2r_sim.controller.gains import RATE
from s2r_sim.plant import mujoco_model, terrain
from s2r_sim.plant.motors import Motors, MotorState
from s2r_sim.plant.physics import FallLimits, Physics
from s2r_sim.robot import rotation
from s2r_sim.robot.constants import LEGS, FloatArray, Robot
from s2r_sim.robot.signals import MotorCommand, RobotState

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_TERRAIN_GROWS = 0.2
"""[s] before the command, in which an uneven terrain rises under the robot."""


class Saved(NamedTuple):
    """The complete state of a plant."""

    world: FloatArray
    motors: MotorState


class Plant:
    """Steps the world from one control tick to the next."""

    def __init__(self, robot: Robot, physics: Physics, knees: bool = False) -> None:
        self.model = mujoco_model.build(robot, physics, knees)
        self.data = mujoco.MjData(self.model)
        self.origin = (0.0, 0.0)
        """Point (x, y) of the terrain that lies at the world's origin [m]."""
        self._physics = physics
        self._incline = terrain.mean_height(physics, 1.0)
        self._steps = round(1.0 / (RATE * physics.timestep))
        self._motors = Motors(robot, physics, self.model, self.data)
        self._by_step = bool(self._motors.every_step or physics.drag or physics.roughness)
        base = int(self.model.body("base").id)
        names = [f"{leg.name}_foot" for leg in LEGS]
        self._feet = [int(self.model.geom(name).id) for name in names]
        grounds = mujoco_model.GROUNDS if physics.roughness else ()
        self._planes = [int(self.model.geom(name).id) for name in grounds]
        self._calves = [int(self.model.geom_bodyid[foot]) for foot in self._feet]
        # Live views of MuJoCo's memory: to take them once saves the wrapper objects of every tick.
        self._qpos, self._qvel = self.data.qpos, self.data.qvel
        self._position, self._attitude, self._q = self._qpos[:3], self._qpos[3:7], self._qpos[7:]
        self._push, self._sensors = self.data.xfrc_applied[base, :3], self.data.sensordata

    @property
    def foot_forces(self) -> FloatArray:
        """(12,) forces of the ground on the feet, world axes [N], in the last physics step."""
        return np.array(self._sensors)

    @property
    def torque(self) -> FloatArray:
        """(12,) torque that the motors report [N m], in the last physics step."""
        return self._motors.reported_torque

    @property
    def play(self) -> tuple[FloatArray, FloatArray]:
        """(12,) angle [rad] and speed of the rotors, where the encoders sit, relative to the joints."""
        return self._motors.state.play, self._motors.state.play_speed

    def truth(self) -> RobotState:
        """Return the true state."""
        return RobotState(rotation.from_mujoco(self._qpos, self._qvel))

    def place(self, position: FloatArray, rpy: FloatArray, q: FloatArray) -> None:
        """Put the robot at rest in a pose, and reset the rest of the state."""
        mujoco.mj_resetData(self.model, self.data)
        self._motors.reset()
        self._set_pose(position, rpy, q)

    def displace(self, rise: float, rpy: FloatArray, q: FloatArray) -> None:
        """Add to base height [m], (3,) attitude [rad] and (12,) joint angles [rad]; speeds stay."""
        now = self.truth()
        self._set_pose(now.position + np.array([0.0, 0.0, rise]), now.rpy + rpy, now.q + q)

    def _set_pose(self, position: FloatArray, rpy: FloatArray, q: FloatArray) -> None:
        x, y, z, w = rotation.quaternion(*rpy.tolist())
        self._position[:], self._attitude[:], self._q[:] = position, (w, x, y, z), q

    def step(self, motors: MotorCommand, elapsed: float, push: FloatArray | None = None) -> None:
        """Run the physics for one control tick.

        ``elapsed`` [s] is counted from the step of the command and negative
        before; ``push`` is the (3,) force on the base [N].
        """
        self._push[:] = 0.0 if push is None else push
        if not self._by_step:
            self._motors.act(motors, elapsed)
            mujoco.mj_step(self.model, self.data, self._steps)
            return
        for _ in range(self._steps):
            self._motors.act(motors, elapsed)
            if self._physics.roughness:
                self._follow_terrain(elapsed)
            if self._physics.drag:
                self._drag_feet()
            mujoco.mj_step(self.model, self.data)

    def _follow_terrain(self, elapsed: float) -> None:
        amplitude = min(1.0, max(0.0, 1.0 + elapsed / _TERRAIN_GROWS))
        for plane, foot in zip(self._planes, self._feet, strict=True):
            x, y, _ = self.data.geom_xpos[foot].tolist()
            height, slope_x, slope_y = terrain.surface(self._physics, x, y, amplitude, self.origin)
            self.model.geom_pos[plane] = (x, y, height)
            self.model.geom_quat[plane] = terrain.plane_attitude(slope_x, slope_y)

    def _drag_feet(self) -> None:
        model, data, physics = self.model, self.data, self._physics
        data.qfrc_applied[:] = 0.0
        velocity = np.empty(6)
        for foot, calf in zip(self._feet, self._calves, strict=True):
            at = data.geom_xpos[foot]
            if at[2] - terrain.mean_height(physics, float(at[0])) >= physics.drag_height:
                continue
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_GEOM, foot, velocity, 0)
            force = -physics.drag * velocity[3:]
            mujoco.mj_applyFT(model, data, force, np.zeros(3), at, calf, data.qfrc_applied)

    def save(self) -> Saved:
        """Return the complete state, to restore later."""
        world = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, world, _STATE)
        return Saved(world, self._motors.state)

    def restore(self, saved: Saved) -> None:
        """Continue from a saved state alone."""
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, saved.world, _STATE)
        # Terrain and drag read the positions of the feet before the first step.
        mujoco.mj_kinematics(self.model, self.data)
        self._motors.state = saved.motors

    def has_fallen(self, state: RobotState, limits: FallLimits) -> bool:
        """Return whether the base is too low or too tilted, or the physics has diverged."""
        x, _, z, roll, pitch = state.flat[:5].tolist()
        height = z - self._incline * x
        if not isfinite(height + roll + pitch):
            return True
        return height < limits.height or cos(roll) * cos(pitch) < cos(limits.tilt)
