"""Causes outside the catalogue of a robot file, on a Go1 of code of its own: the right answer is *none of these*.

None is a number that the catalogue changes, for all legs at once or for a kind of joint. Each was made large enough to
be seen in the logs by :mod:`.isolability`, on machines of other seeds than those of any study, and before any diagnosis
of such a machine.
"""

from __future__ import annotations

import mujoco
import numpy as np

from benchmarks.robots.go1 import STEP, Unmodelled

BAND = 10.0
"""Definition: stiffness of an elastic band across each knee, slack at the keyframe [N·m/rad]."""
WIND, GUSTS, CALM = 10.0, 10.0, 0.3
"""Definition: mean of a wind from the right, and standard deviation and time constant of its gusts [N, N, s]."""
CUFF, BELOW = 0.25, 0.1
"""Definition: mass of a cuff on each shank, and its distance below the knee [kg, m]."""
RIPPLE, POLES = 1.5, 20
"""Definition: amplitude of the cogging of each joint [N·m], and its periods in a turn."""


def _knees(model: mujoco.MjModel) -> list[int]:
    return [one for one in range(model.njnt) if "calf" in model.joint(one).name]


def _band(model: mujoco.MjModel) -> None:
    for joint in _knees(model):
        place = model.jnt_qposadr[joint]
        model.jnt_stiffness[joint] = BAND
        model.qpos_spring[place] = model.key_qpos[0][place]


def _wind(data: mujoco.MjData, rng: np.random.Generator) -> None:
    """Push the trunk: an Ornstein–Uhlenbeck process along y of the world."""
    keep, trunk = np.exp(-STEP / CALM), 1
    gust = keep * (data.xfrc_applied[trunk, 1] - WIND) + GUSTS * np.sqrt(1.0 - keep**2) * rng.normal()
    data.xfrc_applied[trunk, 1] = WIND + gust


def _cuffs(model: mujoco.MjModel) -> None:
    for joint in _knees(model):
        body = model.jnt_bodyid[joint]
        shank, away = model.body_mass[body], np.array([0.0, 0.0, -BELOW]) - model.body_ipos[body]
        model.body_mass[body] = shank + CUFF
        model.body_ipos[body] += CUFF / (shank + CUFF) * away
        # The shank's principal axes lie along its length, nearly; a point on it adds to both across.
        model.body_inertia[body, :2] += shank * CUFF / (shank + CUFF) * (away @ away)


def _cogging(data: mujoco.MjData, rng: np.random.Generator) -> None:
    data.qfrc_applied[6:] += RIPPLE * np.sin(POLES * data.qpos[7:])


UNMODELLED = (
    Unmodelled("elastic bands across the knees", _band),
    Unmodelled("gusts of wind from the right", force=_wind),
    Unmodelled("cuffs on the shanks", _cuffs),
    Unmodelled("cogging of the motors", force=_cogging),
)
