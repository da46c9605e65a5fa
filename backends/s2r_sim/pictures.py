"""Pictures of a trace: tiles of the gait, or a short video, drawn off-screen by MuJoCo.

A picture needs the trace's pose and joint angles alone, so that any trace of an
A1 with these channels can be drawn.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from s2r_sim.controller.gains import RATE
from s2r_sim.plant import mujoco_model
from s2r_sim.robot import rotation
from s2r_sim.robot.constants import LEGS
from s2r_sim.settings import Settings
from s2r_spec.errors import UsageError, one_of, require
from s2r_spec.trace import Trace

Image = NDArray[np.uint8]

WIDTH, HEIGHT = 400, 280
"""[pixels] of a frame."""
FRAMES_PER_SECOND = 25
TILES = (4, 2)
"""Columns and rows of tiles, at equal intervals over one gait period."""

STILLS, VIDEOS = (".png", ".jpg"), (".gif", ".webp")


def draw(settings: Settings, trace: Trace, path: Path) -> None:
    """Draw a trace: the tiles of its last gait period (.png, .jpg), or all of it (.gif, .webp).

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
        images = list(frames(settings, trace, _gait_samples(settings, trace)))
        columns, rows = TILES
        sheet = np.vstack([np.hstack(images[row * columns : (row + 1) * columns]) for row in range(rows)])
        Pictures.fromarray(sheet).save(path)
        return
    samples = range(0, len(trace), RATE // FRAMES_PER_SECOND)
    first, *rest = (Pictures.fromarray(image) for image in frames(settings, trace, samples))
    first.save(path, save_all=True, append_images=rest, duration=1000 // FRAMES_PER_SECOND, loop=0)


def frames(settings: Settings, trace: Trace, samples: range) -> Iterator[Image]:
    """Yield (height, width, 3) images of these samples of a trace, seen from the side."""
    # Drawn on the mean plane: the model has no surface between the planes under the feet.
    spec = mujoco_model.specify(settings.robot, replace(settings.physics, roughness=0.0))
    _furnish(spec, settings)
    model = spec.compile()
    data = mujoco.MjData(model)
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = 90.0, -12.0, 1.0
    with _screen() as context:
        scene, picture = mujoco.MjvScene(model, maxgeom=200), mujoco.MjvOption()
        view = mujoco.MjrRect(0, 0, WIDTH, HEIGHT)
        for k in samples:
            _pose(data, trace, k)
            mujoco.mj_kinematics(model, data)
            camera.lookat[:] = data.qpos[0], data.qpos[1], data.qpos[2] - 0.13
            everything = mujoco.mjtCatBit.mjCAT_ALL
            mujoco.mjv_updateScene(model, data, picture, None, camera, everything, scene)
            renderer = context(model)
            image = np.empty((HEIGHT, WIDTH, 3), dtype=np.uint8)
            mujoco.mjr_render(view, scene, renderer)
            mujoco.mjr_readPixels(image, None, view, renderer)
            yield image[::-1]


def _gait_samples(settings: Settings, trace: Trace) -> range:
    columns, rows = TILES
    step = max(1, round(settings.gains.period * RATE) // (columns * rows))
    first = max(0, len(trace) - step * columns * rows)
    return range(first, first + step * columns * rows, step)


def _pose(data: Any, trace: Trace, k: int) -> None:
    k = min(k, len(trace) - 1)
    roll, pitch, yaw = (float(_true(trace, name)[k]) for name in ("roll", "pitch", "yaw"))
    x, y, z, w = rotation.quaternion(roll, pitch, yaw)
    data.qpos[:] = [*(trace[name][k] for name in ("x", "y", "z")), w, x, y, z, *_true(trace, "q")[k]]


def _true(trace: Trace, name: str) -> NDArray[np.float64]:
    """Return the true values of a channel if the trace has them, else the measured ones."""
    return trace[name if f"{name}_true" not in trace.channels else f"{name}_true"]


def _furnish(spec: Any, settings: Settings) -> None:
    robot = settings.robot
    spec.visual.global_.offwidth, spec.visual.global_.offheight = WIDTH, HEIGHT
    spec.visual.headlight.ambient[:], spec.visual.headlight.diffuse[:] = [0.45] * 3, [0.35] * 3
    lamp, texture, pattern = mujoco.mjtLightType, mujoco.mjtTexture, mujoco.mjtBuiltin
    spec.worldbody.add_light(
        pos=[0, -2, 4], dir=[0.1, 0.4, -1], diffuse=[0.5] * 3, type=lamp.mjLIGHT_DIRECTIONAL
    )
    sky = {"type": texture.mjTEXTURE_SKYBOX, "builtin": pattern.mjBUILTIN_FLAT, "width": 8, "height": 48}
    spec.add_texture(rgb1=[0.93, 0.95, 0.97], **sky)
    squares = {
        "type": texture.mjTEXTURE_2D,
        "builtin": pattern.mjBUILTIN_CHECKER,
        "width": 256,
        "height": 256,
    }
    spec.add_texture(name="squares", rgb1=[0.75, 0.77, 0.8], rgb2=[0.66, 0.68, 0.72], **squares)
    material = spec.add_material(name="squares", texrepeat=[10, 10], texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "squares"
    spec.geom(mujoco_model.FLOOR).material = "squares"
    spec.geom("trunk").rgba = [0.16, 0.38, 0.62, 1.0]
    for leg in LEGS:
        out = leg.sy * robot.thigh_y
        _limb(spec, f"{leg.name}_hip", (0.0, out, 0.0), 0.035)
        _limb(spec, f"{leg.name}_thigh", (0.0, 0.0, -robot.thigh_length), 0.02)
        _limb(spec, f"{leg.name}_calf", (0.0, 0.0, -robot.calf_length), 0.012)


def _limb(spec: Any, body: str, end: tuple[float, float, float], radius: float) -> None:
    spec.body(body).add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[0.0, 0.0, 0.0, *end],
        size=[radius, 0, 0],
        mass=0.0,
        contype=0,
        conaffinity=0,
        rgba=[0.25, 0.27, 0.31, 1.0],
    )


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
