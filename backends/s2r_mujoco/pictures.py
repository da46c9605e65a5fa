"""Pictures of a motion: tiles, or a short video, drawn off-screen by MuJoCo from positions of a model alone."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from s2r_mujoco.arrays import FloatArray
from s2r_spec.errors import UsageError, one_of, require

Image = NDArray[np.uint8]

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
    """

    distance: float
    below: float = 0.0
    body: int = 0


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
        except (
            Exception
        ):  # whatever a missing driver makes PyOpenGL raise: AttributeError, ImportError, GLError
            continue
        return context
    raise UsageError(
        "pictures need off-screen OpenGL, and neither EGL nor OSMesa works on this machine; "
        "try: apt install libegl1 libgl1-mesa-dri (or libosmesa6)"
    )
