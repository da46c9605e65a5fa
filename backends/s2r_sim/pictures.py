"""Pictures of a trace: tiles of the gait, or a short video.

A picture needs the trace's pose and joint angles alone, so that any trace of an
A1 with these channels can be drawn.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from s2r_mujoco import pictures
from s2r_mujoco.pictures import View
from s2r_sim.controller.gains import RATE
from s2r_sim.plant import mujoco_model
from s2r_sim.robot import rotation
from s2r_sim.robot.constants import LEGS
from s2r_sim.settings import Settings
from s2r_spec.trace import Trace


def draw(settings: Settings, trace: Trace, path: Path) -> None:
    """Draw a trace: the tiles of its last gait period (.png, .jpg), or all of it (.gif, .webp).

    Raises:
        UsageError: see :func:`s2r_mujoco.pictures.draw`.
    """
    # Drawn on the mean plane: the model has no surface between the planes under the feet.
    spec = mujoco_model.specify(settings.robot, replace(settings.physics, roughness=0.0))
    _furnish(spec, settings)
    model = spec.compile()
    last = len(trace) - 1
    tiles = [min(k, last) for k in _gait_samples(settings, trace)]
    positions = np.array([_pose(trace, k) for k in range(len(trace))])
    pictures.draw(model, positions, tiles, RATE, View(1.0, 0.13, int(model.body("base").id)), path)


def _gait_samples(settings: Settings, trace: Trace) -> range:
    columns, rows = pictures.TILES
    step = max(1, round(settings.gains.period * RATE) // (columns * rows))
    first = max(0, len(trace) - step * columns * rows)
    return range(first, first + step * columns * rows, step)


def _pose(trace: Trace, k: int) -> list[float]:
    roll, pitch, yaw = (float(_true(trace, name)[k]) for name in ("roll", "pitch", "yaw"))
    x, y, z, w = rotation.quaternion(roll, pitch, yaw)
    return [*(trace[name][k] for name in ("x", "y", "z")), w, x, y, z, *_true(trace, "q")[k]]


def _true(trace: Trace, name: str) -> NDArray[np.float64]:
    """Return the true values of a channel if the trace has them, else the measured ones."""
    return trace[name if f"{name}_true" not in trace.channels else f"{name}_true"]


def _furnish(spec: Any, settings: Settings) -> None:
    robot = settings.robot
    spec.visual.global_.offwidth, spec.visual.global_.offheight = pictures.WIDTH, pictures.HEIGHT
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
