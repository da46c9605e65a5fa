"""A model whose base is fixed in the air: without the free joints of bodies with joints, and with nothing to touch."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco

_SIZES = {
    int(mujoco.mjtJoint.mjJNT_FREE): (7, 6),
    int(mujoco.mjtJoint.mjJNT_BALL): (4, 3),
    int(mujoco.mjtJoint.mjJNT_HINGE): (1, 1),
    int(mujoco.mjtJoint.mjJNT_SLIDE): (1, 1),
}
"""Definition: type of a joint → its numbers of positions and of velocities."""


def hold_bases(spec: Any) -> None:
    """Fix every free body that carries other joints, at the pose of the file; what is fixed then touches nothing."""
    free = int(mujoco.mjtJoint.mjJNT_FREE)
    kept_positions: list[int] = []
    kept_velocities: list[int] = []
    removed = []
    place, dof = 0, 0
    for body, joint in _joints(spec.worldbody):
        positions, velocities = _SIZES[int(joint.type)]
        if int(joint.type) == free and any(True for _ in _joints(body, below=True)):
            removed.append(joint)
        else:
            kept_positions += range(place, place + positions)
            kept_velocities += range(dof, dof + velocities)
        place, dof = place + positions, dof + velocities
    if not removed:
        return
    for joint in removed:
        spec.delete(joint)
    for key in spec.keys:
        key.qpos = _part(key.qpos, kept_positions)
        key.qvel = _part(key.qvel, kept_velocities)
    # MuJoCo lets a part collide with its parent where the parent is fixed.
    for geom in _fixed_geoms(spec.worldbody):
        geom.contype, geom.conaffinity = 0, 0


def _joints(body: Any, below: bool = False) -> Iterator[tuple[Any, Any]]:
    """Yield (body, joint) of a body and of all bodies under it, in the order of the compiled model."""
    if not below:
        yield from ((body, joint) for joint in body.joints)
    for child in body.bodies:
        yield from _joints(child)


def _fixed_geoms(body: Any) -> Iterator[Any]:
    """Yield the geoms of a fixed body and of all that are fixed to it."""
    yield from body.geoms
    for child in body.bodies:
        if not child.joints:
            yield from _fixed_geoms(child)


def _part(values: Any, kept: list[int]) -> list[float]:
    numbers = [float(x) for x in values]
    return [numbers[i] for i in kept] if numbers else []
