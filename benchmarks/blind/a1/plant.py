"""The rigid bodies under all forces, stepped from one control tick to the next."""

from __future__ import annotations

from math import acos, asin, atan2, cos, sin, tan
from typing import NamedTuple

import mujoco
import numba
import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.a1 import model
from benchmarks.blind.a1.forces import act
from benchmarks.blind.a1.robot import A1, BASE_HEIGHT, LEGS
from benchmarks.blind.a1.world import GRID, QUEUE, STEP, STEPS, Record, fresh

FloatArray = NDArray[np.float64]

FALL_HEIGHT, FALL_TILT = 0.16, 0.7
"""[m], [rad] beyond which the robot has fallen; the lab's rule, the same as in simulation."""

FLAT = np.zeros(GRID)


class Saved(NamedTuple):
    """Everything that decides the future of a plant."""

    qpos: FloatArray
    qvel: FloatArray
    state: Record


class Plant:
    """One robot in one world.

    Attributes:
        world: (1,) record; may be replaced between rollouts.
        state: (1,) record, beside the rigid bodies' own state.
        ground: the patch of uneven ground.
    """

    def __init__(self, build: model.Build, world: Record) -> None:
        self.world = world
        self.ground = FLAT
        self._model = model.compiled(build, float(world["slope"][0]))
        self._data = mujoco.MjData(self._model)
        shanks = [self._model.body(f"{leg.name}_calf").id for leg in LEGS]
        data = self._data
        # Live views of MuJoCo's own memory.
        self._bodies = (
            data.qpos, data.qvel, data.site_xpos, data.cvel, data.subtree_com[1], data.xipos, np.array(shanks)
        )  # fmt: skip
        self._forces = (data.qfrc_applied, data.xfrc_applied)
        self.state = fresh()

    def stand(self) -> None:
        """Put the robot at rest above the ground, as if it had just been switched on."""
        knee = acos((BASE_HEIGHT - A1.foot_radius) / (A1.thigh_length + A1.calf_length))
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:7] = (0.0, 0.0, BASE_HEIGHT, 1.0, 0.0, 0.0, 0.0)
        self._data.qpos[7:] = np.tile([0.0, knee, -2.0 * knee], 4)
        self.state = fresh()
        self.state["angle"] = self._data.qpos[7:]
        mujoco.mj_step1(self._model, self._data)
        self.state["slosh"] = self._data.xipos[1, :2]

    def save(self) -> Saved:
        """Return everything that decides the future."""
        return Saved(self._data.qpos.copy(), self._data.qvel.copy(), self.state.copy())

    def restore(self, saved: Saved) -> None:
        """Continue from a saved plant, and from nothing else."""
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:], self._data.qvel[:] = saved.qpos, saved.qvel
        self.state = saved.state.copy()
        mujoco.mj_step1(self._model, self._data)

    def begin(self) -> None:
        """Take the place where the robot is now for that of the command."""
        self.state["origin"] = self._data.qpos[0]

    def send(self, motors: FloatArray, delay: float) -> None:
        """Give the drives a motor law, (5, 12), that reaches them after a delay [s]."""
        _queue(self.state, motors, delay)

    def run(self, elapsed: float, shove: FloatArray | None = None) -> None:
        """Run the physics for one control tick, ``elapsed`` [s] after the command.

        ``shove`` is a (6,) generalised force on the trunk.
        """
        data, step2, step1 = self._data, mujoco.mj_step2, mujoco.mj_step1
        data.qfrc_applied[:6] = 0.0 if shove is None else shove
        for step in range(STEPS):
            act(self.world, self.state, elapsed + step * STEP, self._bodies, self.ground, self._forces)
            step2(self._model, data)
            step1(self._model, data)

    def look(self, truth: FloatArray, rotors: FloatArray, feet: FloatArray) -> None:
        """Write (36,) the true state, (24,) what ideal encoders read, and (8, 3) place and speed of the feet.

        Positions, velocities and attitude are those in the world, in which the ground is tilted.
        """
        _observe(self.world, self.state, self._bodies, truth, rotors, feet)

    @property
    def ground_force(self) -> FloatArray:
        """(4, 3) of the ground on the feet [N] in the last physics step, in the axes of the flat ground."""
        return self.state["ground_force"][0]

    def has_fallen(self, truth: FloatArray) -> bool:
        """Return whether the trunk is too low or tilts too much, or the numbers have run away."""
        height = truth[2] - tan(float(self.world["slope"][0])) * truth[0]
        upright = cos(truth[3]) * cos(truth[4])
        return not (height >= FALL_HEIGHT and upright >= cos(FALL_TILT))


@numba.njit(cache=True)
def _queue(state, motors, delay):  # type: ignore[no-untyped-def]
    s = state[0]
    place = s.sent % QUEUE
    for row in range(5):
        for joint in range(12):
            s.queue[place, row, joint] = motors[row, joint]
    s.due[place] = s.clock + delay
    s.sent += 1


@numba.njit(cache=True)
def _observe(world, state, bodies, truth, rotors, feet):  # type: ignore[no-untyped-def]
    qpos, qvel, sites, twists, centre, _, shanks = bodies
    lean = world[0].slope
    for joint in range(12):
        rotors[joint] = state[0].angle[joint] + world[0].encoder_offset[joint]
        rotors[12 + joint] = state[0].speed[joint]
    c, s = cos(lean), sin(lean)
    half_c, half_s = cos(lean / 2), -sin(lean / 2)
    w, x, y, z = qpos[3], qpos[4], qpos[5], qpos[6]
    # The product of the lean about -y with the attitude.
    w, x, y, z = (
        half_c * w - half_s * y,
        half_c * x + half_s * z,
        half_c * y + half_s * w,
        half_c * z - half_s * x,
    )
    truth[0], truth[1], truth[2] = c * qpos[0] - s * qpos[2], qpos[1], s * qpos[0] + c * qpos[2]
    truth[3] = atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    truth[4] = asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x))))
    truth[5] = atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    truth[6], truth[7], truth[8] = c * qvel[0] - s * qvel[2], qvel[1], s * qvel[0] + c * qvel[2]
    truth[9:12] = qvel[3:6]
    truth[12:24] = qpos[7:19]
    truth[24:36] = qvel[6:18]
    for foot in range(4):
        px, py, pz = sites[foot]
        wx, wy, wz, ux, uy, uz = twists[shanks[foot]]
        rx, ry, rz = px - centre[0], py - centre[1], pz - centre[2]
        vx, vy, vz = ux + wy * rz - wz * ry, uy + wz * rx - wx * rz, uz + wx * ry - wy * rx
        feet[foot, 0], feet[foot, 1], feet[foot, 2] = c * px - s * pz, py, s * px + c * pz
        feet[4 + foot, 0], feet[4 + foot, 1], feet[4 + foot, 2] = c * vx - s * vz, vy, s * vx + c * vz
