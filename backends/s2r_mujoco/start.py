"""The state at t = 0: a keyframe, the default pose on the floor, or the model's own, and its noise."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from s2r_mujoco import joints as joint_order
from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.description import StartTable
from s2r_mujoco.plan import Plan
from s2r_spec.errors import UsageError

_DESCENTS, _TOUCHING = 30, 1e-4
"""Budget: steps by which a start pose descends to the floor; tolerance: distance at which it stands on it [m]."""
_FAR = 100.0
"""Budget: distance between a geom and the floor up to which MuJoCo computes it [m]."""


def start_pose(model: Any, plan: Plan, start: StartTable, source: str) -> FloatArray:
    """Return (nq,) the positions at t = 0, without noise.

    Raises:
        UsageError: a joint does not exist, or there is neither a keyframe nor a default pose.
    """
    wanted = start.joint_pos
    if wanted == "keyframe" and plan.key < 0:
        raise UsageError(f'{source}: start.joint_pos = "keyframe", but `keyframe` names none')
    if plan.key >= 0 and wanted in (None, "keyframe"):
        pose = np.array(model.key_qpos[plan.key])
    else:
        pose = np.array(model.qpos0)
        if wanted != "model":
            pose[plan.joints.qpos] = plan.pose
            pose[plan.held.joints.qpos] = plan.held.pose
        if isinstance(wanted, dict):
            joints = joint_order.named(
                model, joint_order.by_names(model, tuple(wanted), f"{source}: start.joint_pos")
            )
            pose[joints.qpos] = list(wanted.values())
            joint_order.refuse_unfit(
                joints, pose[joints.qpos], f"{source}: start.joint_pos", "angles are in rad"
            )
        if plan.root >= 0 and wanted != "model" and start.height is None:
            _put_down(model, pose, plan.root)
    if start.height is not None and plan.root >= 0:
        pose[_height(model, plan.root)] = start.height
    return pose


def _height(model: Any, root: int) -> int:
    return int(model.jnt_qposadr[model.body_jntadr[root]]) + 2


def floors(model: Any) -> list[int]:
    """Return the fixed geoms that are planes; without one, those that collide, such as a height field or a box."""
    fixed = [g for g in range(model.ngeom) if model.body_weldid[model.geom_bodyid[g]] == 0]
    planes = [g for g in fixed if _is_plane(model, g)]
    return planes or [g for g in fixed if model.geom_contype[g] or model.geom_conaffinity[g]]


def _is_plane(model: Any, geom: int) -> bool:
    return bool(model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE)


def floor_height(model: Any) -> float:
    """Return the height of the first floor above z = 0: a plane, the top of a box, or 0 of another shape [m]."""
    first = next(iter(floors(model)), -1)
    if first < 0:
        return 0.0
    if _is_plane(model, first):
        return float(model.geom_pos[first, 2])
    if model.geom_type[first] == mujoco.mjtGeom.mjGEOM_BOX:
        return float(model.geom_pos[first, 2] + model.geom_size[first, 2])
    return 0.0


def _put_down(model: Any, pose: FloatArray, root: int) -> None:
    """Move a robot up or down until its lowest colliding geom stands on the floor; ``root`` is its body."""
    ground, height = floors(model), _height(model, root)
    if ground and _is_plane(model, ground[0]):
        pose[height] -= _clearance(model, pose, ground[:1], root)
        return
    for _ in range(_DESCENTS if ground else 0):
        # The distance to another shape is at most the vertical one.
        above = _clearance(model, pose, ground, root)
        pose[height] -= above
        if abs(above) < _TOUCHING:
            return


def _clearance(model: Any, pose: FloatArray, ground: list[int], root: int) -> float:
    """Return the least distance between a colliding geom of the robot and a floor [m], negative in it."""
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_kinematics(model, data)
    own = [
        g for g in range(model.ngeom)
        if model.body_rootid[model.geom_bodyid[g]] == root and (model.geom_contype[g] or model.geom_conaffinity[g])
    ]  # fmt: skip
    distances = [mujoco.mj_geomDistance(model, data, floor, g, _FAR, None) for floor in ground for g in own]
    return float(min(distances, default=0.0))


def draw(model: Any, plan: Plan, start: StartTable, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return the noise of the start, (nq,) and (nv,), from the seed alone.

    All numbers are drawn in one fixed order, so that a deviation of zero changes no other number.
    """
    generator, noise = np.random.default_rng(seed), start.noise
    moving = joint_order.named(model, joint_order.scalar_joints(model))
    position, velocity = np.zeros(model.nq), np.zeros(model.nv)
    position[moving.qpos] = noise.joint_pos * generator.standard_normal(len(moving))
    velocity[moving.dof] = noise.joint_vel * generator.standard_normal(len(moving))
    base = generator.standard_normal(6)
    if plan.root >= 0:
        first = int(model.jnt_dofadr[model.body_jntadr[plan.root]])
        velocity[first : first + 3] = noise.base_lin_vel * base[:3]
        velocity[first + 3 : first + 6] = noise.base_ang_vel * base[3:]
    return position, velocity
