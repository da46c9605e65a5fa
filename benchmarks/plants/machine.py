"""One particular machine: how it differs from the data sheet, and its effects.

Both plants read the same record, each by laws of its own. Effects have the names, the units and the meaning of the
simulator's catalogue.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.random import Generator

from benchmarks.plants.robot import A1, CATALOGUE, LEGS, Inertia, fuse

EFFECTS: dict[str, tuple[str, ...]] = {
    "motor_strength": ("factor",),
    "latency": ("delay",),
    "dry_friction": ("torque",),
    "viscous_friction": ("coefficient",),
    "armature": ("inertia",),
    "payload": ("mass",),
    "com_offset": ("x", "y", "z"),
    "torque_constant": ("factor",),
    "encoder_offset": ("hip", "thigh", "calf"),
    "soft_ground": ("sink",),
    "ground_friction": ("factor",),
    "foot_drag": ("coefficient",),
    "slope": ("angle",),
    "attitude_bias": ("roll", "pitch"),
    "velocity_bias": ("forward", "left"),
    "velocity_scale": ("factor",),
}
"""Definition: the effects that both plants have, and the parameters of which a case has one."""

NOMINAL = {
    f"{name}.{parameter.name}": parameter.nominal
    for name in EFFECTS
    for parameter in CATALOGUE[name].parameters
}
"""Definition: the value of every parameter of these effects that does nothing."""

MASS, RUBBER, GROUND, JOINT, NOISE = 0.015, 0.3, 0.05, 0.2, 0.5
"""Definitions: half-widths of uniform spreads of healthy machines, as shares of the nominal figure.

Of the mass of each link, the stiffness of rubber, the friction of the ground and of each joint, and of all noise.
"""
DAY_GROUND, DAY_JOINT = 0.02, 0.03
"""Definitions: standard deviations from run to run of the friction of ground and joints, as shares."""

Link = tuple[str, Inertia, tuple[float, float, float]]
"""A link of a leg: its name, its inertia, and where its joint sits in the parent [m]."""


@dataclass(frozen=True)
class Machine:
    """One robot on one ground. The default is the data sheet.

    Attributes:
        effects: "payload.mass" → value, in the catalogue's units; what is not there is nominal.
        masses: (13,) factors on mass and inertia: the trunk, then hip, thigh and calf of each leg.
        rubber: factor on the stiffness of the feet.
        ground: factor on the friction coefficient of the ground.
        joints: (12,) factors on the friction of the joints.
        noise: factor on all noise of sensors.
    """

    effects: Mapping[str, float] = field(default_factory=dict)
    masses: tuple[float, ...] = (1.0,) * 13
    rubber: float = 1.0
    ground: float = 1.0
    joints: tuple[float, ...] = (1.0,) * 12
    noise: float = 1.0

    def __post_init__(self) -> None:
        if unknown := sorted(set(self.effects) - set(NOMINAL)):
            raise ValueError(f"the plants have no effect {unknown[0]!r}; they have {', '.join(NOMINAL)}")

    def __getitem__(self, name: str) -> float:
        """Return the value of an effect's parameter, such as "payload.mass"."""
        return self.effects.get(name, NOMINAL[name])

    def of_today(self, rng: Generator) -> Machine:
        """Return the same machine as it is in one run."""
        ground, joint = 1.0 + DAY_GROUND * rng.normal(), 1.0 + DAY_JOINT * rng.normal()
        return replace(
            self, ground=self.ground * ground, joints=tuple(share * joint for share in self.joints)
        )

    def friction(self, nominal: float, added: float) -> np.ndarray:
        """Return (12,) a friction of the joints: a nominal one, and an effect's with the mean ``added``."""
        share = np.array(self.joints)
        return nominal * share + added * share / share.mean()


def healthy(rng: Generator) -> Machine:
    """Return a machine with nothing wrong."""

    def near(width: float, count: int) -> tuple[float, ...]:
        return tuple((1.0 + width * rng.uniform(-1.0, 1.0, count)).tolist())

    return Machine(
        {}, near(MASS, 13), near(RUBBER, 1)[0], near(GROUND, 1)[0], near(JOINT, 12), near(NOISE, 1)[0]
    )


def bodies(machine: Machine, load: Inertia) -> tuple[Inertia, list[list[Link]]]:
    """Return the trunk with its load, and the links of each leg.

    Args:
        machine: masses, and where the trunk's centre of mass lies.
        load: a payload in base axes; its mass may be 0.
    """
    shift = machine["com_offset.x"], machine["com_offset.y"], machine["com_offset.z"]
    factors = iter(machine.masses)
    origin = (0.0, 0.0, 0.0)
    trunk = fuse([(_scaled(A1.loaded((), shift).base, next(factors)), origin), (load, origin)])
    legs = [
        [(name, _scaled(inertia, next(factors)), at) for name, inertia, at in A1.links(leg)] for leg in LEGS
    ]
    return trunk, legs


def _scaled(inertia: Inertia, by: float) -> Inertia:
    i = inertia
    return Inertia(by * i.mass, i.com, by * i.xx, by * i.yy, by * i.zz, by * i.xy, by * i.xz, by * i.yz)
