"""The rigid bodies, written out as MJCF: a trunk, twelve links, no actuators, no contacts.

MuJoCo solves the motion of the links and nothing else. Drives, gears, the
ground and the air are forces of :mod:`benchmarks.blind.a1.forces`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import Any

import mujoco
import numpy as np
from numpy.random import Generator

from benchmarks.blind.a1.robot import A1, LEGS
from benchmarks.blind.a1.world import STEP

_GRAVITY = 9.81
_AXES = {"hip": "1 0 0", "thigh": "0 1 0", "calf": "0 1 0"}
_BOX = (0.18, 0.13, 0.08)
"""[m] sides of a payload."""
_BATTERY = 2.5
"""[kg] of the trunk that can sit elsewhere than it should."""


@dataclass(frozen=True)
class Build:
    """What is different about the bodies of one particular robot.

    Attributes:
        masses: per link, hips to shanks leg by leg, then the trunk: a factor on mass and inertia.
        shifts: (13, 3) of the centres of mass [m].
        payload: [kg] a box of even density on the trunk.
        payload_at: its centre [m], base axes.
        battery: [m] by which the battery sits off, scaled to the shift of the trunk's centre of mass.
        leg_load: [kg] strapped to one shank.
        leg: which.
    """

    masses: tuple[float, ...] = (1.0,) * 13
    shifts: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0),) * 13
    payload: float = 0.0
    payload_at: tuple[float, float, float] = (0.0, 0.0, 0.08)
    battery: tuple[float, float, float] = (0.0, 0.0, 0.0)
    leg_load: float = 0.0
    leg: int = 0


def made(rng: Generator) -> Build:
    """Return a robot as it leaves the factory: links off by 1.5 %, centres of mass by 1 mm."""
    masses = 1.0 + 0.015 * np.clip(rng.normal(size=13), -2, 2)
    shifts = 0.001 * np.clip(rng.normal(size=(13, 3)), -2, 2)
    return Build(tuple(masses.tolist()), tuple((x, y, z) for x, y, z in shifts.tolist()))


def compiled(build: Build, slope: float) -> Any:
    """Return the ``MjModel``; the ground is the plane z = 0, and gravity leans by ``slope`` [rad]."""
    return mujoco.MjModel.from_xml_string(text(build, slope))


def text(build: Build, slope: float) -> str:
    """Return the MJCF."""
    links = iter(zip(build.masses, build.shifts, strict=True))
    legs = "".join(_leg(index, links, build) for index in range(len(LEGS)))
    x, z = -_GRAVITY * sin(slope), -_GRAVITY * cos(slope)
    return f"""
<mujoco model="a1 twin">
  <compiler angle="radian"/>
  <option timestep="{STEP}" integrator="Euler" gravity="{x!r} 0 {z!r}">
    <flag contact="disable" constraint="disable" eulerdamp="disable" autoreset="disable"/>
  </option>
  <worldbody>
    <body name="trunk">
      <freejoint/>
      {_inertial(A1.base, *next(links), battery=build.battery)}
      {_payload(build)}{legs}
    </body>
  </worldbody>
</mujoco>"""


def _leg(index: int, links: Any, build: Build) -> str:
    leg = LEGS[index]
    opened = ""
    for part, inertia, (x, y, z) in A1.links(leg):
        opened += f"""
      <body name="{leg.name}_{part}" pos="{x!r} {y!r} {z!r}">
        <joint name="{leg.name}_{part}" type="hinge" axis="{_AXES[part]}"/>
        {_inertial(inertia, *next(links))}"""
    foot = " ".join(map(repr, A1.foot_offset))
    strap = (
        f'<body pos="0 0 -0.1"><inertial pos="0 0 0" mass="{build.leg_load!r}" diaginertia="1e-4 1e-4 1e-4"/></body>'
        if build.leg_load and build.leg == index
        else ""
    )
    return f'{opened}<site name="{leg.name}_foot" pos="{foot}"/>{strap}</body></body></body>'


def _inertial(
    inertia: Any,
    factor: float,
    shift: tuple[float, float, float],
    battery: tuple[float, float, float] = (0, 0, 0),
) -> str:
    mass = inertia.mass * factor
    com = np.add(inertia.com, shift)
    tensor = inertia.tensor * factor
    if any(battery):
        # A part of the trunk moves: the centre follows in proportion, and the inertia grows (Steiner).
        moved = np.asarray(battery)
        away = moved * mass / _BATTERY
        com = com + moved
        reduced = _BATTERY * (1.0 - _BATTERY / mass)
        tensor = tensor + reduced * (away @ away * np.eye(3) - np.outer(away, away))
    x, y, z = com.tolist()
    t = tensor.tolist()
    return (
        f'<inertial pos="{x!r} {y!r} {z!r}" mass="{mass!r}" fullinertia="{t[0][0]!r} {t[1][1]!r} {t[2][2]!r} '
        f'{t[0][1]!r} {t[0][2]!r} {t[1][2]!r}"/>'
    )


def _payload(build: Build) -> str:
    if build.payload <= 0.0:
        return ""
    a, b, c = _BOX
    m = build.payload / 12.0
    x, y, z = build.payload_at
    return (
        f'<body pos="{x!r} {y!r} {z!r}"><inertial pos="0 0 0" mass="{build.payload!r}" '
        f'diaginertia="{m * (b * b + c * c)!r} {m * (a * a + c * c)!r} {m * (a * a + b * b)!r}"/></body>'
    )
