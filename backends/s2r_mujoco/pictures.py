"""Pictures of a motion: tiles, or a short video, drawn off-screen by MuJoCo from positions of a model alone."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.channels import joint_channels
from s2r_mujoco.robot import Robot
from s2r_mujoco.start import floor_height
from s2r_spec.errors import UsageError, one_of, require
from s2r_spec.trace import Trace

Image = NDArray[np.uint8]
Missing = tuple[str, ...]
"""Sentences on what a trace lacks, and on how it is drawn instead."""

WIDTH, HEIGHT = 400, 280
"""[pixels] of a frame."""
FRAMES_PER_SECOND = 25
TILES = (4, 2)
"""Columns and rows of tiles."""
STILLS, VIDEOS = (".png", ".jpg"), (".gif", ".webp")


@dataclass(frozen=True)
class View:
    """A camera from the side, which follows a point.

    Attributes:
        distance: from the point [m].
        below: height of the body above the point [m].
        body: number of the body that it follows; 0 for a camera that stays.
        shadows: whether shadows are drawn, which takes two thirds of the time.
    """

    distance: float
    below: float = 0.0
    body: int = 0
    shadows: bool = True


def draw(
    model: Any, positions: FloatArray, tiles: Sequence[int], rate: float, view: View, path: Path
) -> None:
    """Draw positions (n, nq) of a model: some samples as tiles (.png, .jpg), or all of them (.gif, .webp).

    Args:
        model: the compiled model.
        positions: (n, nq) one row a sample.
        tiles: samples to show as tiles.
        rate: samples a second.
        view: the camera.
        path: the file.

    Raises:
        UsageError: another ending, no Pillow, or neither EGL nor OSMesa on this machine.
    """
    kind = path.suffix.lower()
    if kind not in STILLS + VIDEOS:
        raise UsageError(
            f"{path.name!r}: a picture ends in {one_of(STILLS)} (tiles) or {one_of(VIDEOS)} (video)"
        )
    require("pictures need", "PIL")
    from PIL import Image as Pictures

    if kind in STILLS:
        images = list(frames(model, positions[list(tiles)], view))
        columns, rows = TILES
        sheet = np.vstack([np.hstack(images[row * columns : (row + 1) * columns]) for row in range(rows)])
        Pictures.fromarray(sheet).save(path)
        return
    every = max(1, round(rate / FRAMES_PER_SECOND))
    first, *rest = (Pictures.fromarray(image) for image in frames(model, positions[::every], view))
    first.save(path, save_all=True, append_images=rest, duration=1000 * every / rate, loop=0)


def positions_of(
    robot: Robot, trace: Trace, times: Sequence[float], beside: Trace
) -> tuple[FloatArray, Missing]:
    """Return (n, nq) positions of a robot at times of a trace, and what the trace lacks.

    Joints are from ``q`` and ``q_slide``; the attitude of the base from ``quaternion``, the Euler angles, or roll and
    pitch by ``gravity``; its place from ``x``, ``y``, ``z`` or ``height``. What is missing is as in the trace beside
    it. A trace that ended earlier keeps its last position.
    """
    model, plan = robot.model, robot.plan
    own, other = (_Sampled(one, times) for one in (trace, beside))
    positions = np.repeat(plan.home[None], len(times), axis=0)
    missing: list[str] = []

    def put(columns: Any, what: str, read: Callable[[_Sampled], FloatArray | None]) -> None:
        found, instead = read(own), read(other)
        if found is None or np.isnan(found).any():
            place = "the start pose of the model" if instead is None else "the simulated robot"
            missing.append(f"no log of {what}: drawn as in {place}")
            found = instead
        if found is not None:
            positions[:, columns] = found

    for name, joints in joint_channels(model).items():
        put(
            joints.qpos, f"the joint positions {name}", partial(_Sampled.matrix, name=name, width=len(joints))
        )
    if plan.root >= 0:
        first = int(model.jnt_qposadr[model.body_jntadr[plan.root]])
        put(slice(first + 3, first + 7), "the attitude", _attitude)
        if _attitude(own) is not None and not {"quaternion", "yaw"} & {*trace.channels}:
            missing.append("no log of the heading: drawn straight ahead")
        ground = floor_height(model)
        put(first + 2, "the height", lambda one: one.height(ground))
        put([first, first + 1], "the place on the floor", lambda one: one.columns("x", "y"))
    return positions, tuple(missing)


class _Sampled:
    """The channels of a trace at the samples nearest to some times; None for one that is not there."""

    def __init__(self, trace: Trace, times: Sequence[float]) -> None:
        own = trace.times - trace.times[0]
        self.trace = trace
        self.rows = np.abs(own[None] - np.asarray(times)[:, None]).argmin(axis=1)

    def matrix(self, name: str, width: int) -> FloatArray | None:
        """Return (n, width) a channel."""
        if name not in self.trace.channels:
            return None
        values = np.asarray(self.trace[name], dtype=float)[self.rows].reshape(len(self.rows), -1)
        return values if values.shape[1] == width else None

    def columns(self, *names: str) -> FloatArray | None:
        """Return (n, names) several channels."""
        if any(name not in self.trace.channels for name in names):
            return None
        return np.column_stack([self.trace[name][self.rows] for name in names]).astype(float)

    def height(self, ground: float) -> FloatArray | None:
        """Return (n,) the height of the base in the world."""
        for name, zero in (("z", 0.0), ("height", ground)):
            if (found := self.columns(name)) is not None:
                return found[:, 0] + zero
        return None


def _attitude(one: _Sampled) -> FloatArray | None:
    """Return (n, 4) quaternions, w first."""
    if (quaternion := one.matrix("quaternion", 4)) is not None:
        return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    angles = one.columns("roll", "pitch")
    if angles is None and (down := one.matrix("gravity", 3)) is not None:
        angles = np.column_stack(
            [np.arctan2(-down[:, 1], -down[:, 2]), np.arcsin(np.clip(down[:, 0], -1.0, 1.0))]
        )
    if angles is None:
        return None
    yaw = one.columns("yaw")
    turns = np.column_stack([angles, np.zeros(len(angles)) if yaw is None else yaw[:, 0]])
    quaternion = np.empty((len(turns), 4))
    for row, euler in zip(quaternion, turns, strict=True):
        mujoco.mju_euler2Quat(row, euler[::-1], "zyx")
    return quaternion


def frames(model: Any, positions: FloatArray, view: View) -> Iterator[Image]:
    """Yield (height, width, 3) images of a model at these positions."""
    data = mujoco.MjData(model)
    camera, picture = mujoco.MjvCamera(), mujoco.MjvOption()
    camera.azimuth, camera.elevation, camera.distance = 90.0, -12.0, view.distance
    shown = (model.geom_group < 3) & (model.geom_bodyid > 0)
    if not shown.any():  # the meshes for pictures are missing: draw the shapes for collisions
        picture.geomgroup[:] = 1
    with _screen() as context:
        scene = mujoco.MjvScene(model, maxgeom=max(200, 2 * model.ngeom))
        area = mujoco.MjrRect(0, 0, WIDTH, HEIGHT)
        for row in positions:
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            camera.lookat[:] = data.xpos[view.body] - (0.0, 0.0, view.below)
            everything = mujoco.mjtCatBit.mjCAT_ALL
            mujoco.mjv_updateScene(model, data, picture, None, camera, everything, scene)
            scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = view.shadows
            renderer = context(model)
            image = np.empty((HEIGHT, WIDTH, 3), dtype=np.uint8)
            mujoco.mjr_render(area, scene, renderer)
            mujoco.mjr_readPixels(image, None, area, renderer)
            yield image[::-1]


@contextmanager
def _screen() -> Iterator[Any]:
    """Open an off-screen OpenGL context; yield a function from a model to MuJoCo's renderer of it."""
    opened = _open_screen()
    renderers: list[Any] = []

    def renderer(model: Any) -> Any:
        if not renderers:
            renderers.append(mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100))
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, renderers[0])
        return renderers[0]

    try:
        yield renderer
    finally:
        for made in renderers:
            made.free()
        opened.free()


def _open_screen() -> Any:
    """Return a current context of the first library that works; ``MUJOCO_GL`` has no influence."""
    for library in ("egl", "osmesa"):
        os.environ["PYOPENGL_PLATFORM"] = library
        try:
            context = import_module(f"mujoco.{library}").GLContext(WIDTH, HEIGHT)
            context.make_current()
        except Exception:  # whatever a missing driver makes PyOpenGL raise, such as an AttributeError
            continue
        return context
    raise UsageError(
        "pictures need off-screen OpenGL, and neither EGL nor OSMesa works on this machine; "
        "try: apt install libegl1 libgl1-mesa-dri (or libosmesa6)"
    )
