"""The plant's MuJoCo model, built from the robot's constants: primitives only, no meshes."""

from __future__ import annotations

from math import radians, tan
from typing import Any

import mujoco

from s2r_sim.plant import terrain
from s2r_sim.plant.physics import Physics
from s2r_sim.robot.constants import LEGS, Inertia, Leg, Robot

FLOOR = "floor"
GROUNDS = tuple(f"{leg.name}_ground" for leg in LEGS)
"""On uneven terrain every foot has a plane of its own, which follows the terrain at that foot."""

_AXES = {"hip": (1.0, 0.0, 0.0), "thigh": (0.0, 1.0, 0.0), "calf": (0.0, 1.0, 0.0)}
_REDUCE_TO_NET_FORCE = 3  # `reduce="netforce"` of MuJoCo's contact sensor; it has no enum in Python
_TRUNK_BIT = 1 << len(LEGS)
_ALL_BITS = 2 * _TRUNK_BIT - 1
KNEE_RADIUS = 0.02
"""Definition: radius of the balls at the knees [m]. Source: half a thigh's width in the vendor's URDF, and a cover."""


def build(robot: Robot, physics: Physics, knees: bool = False) -> Any:
    """Return the ``MjModel``: nq 19, nv 18, nu 12, and per foot the net contact force in world axes.

    Only the four ball feet and the trunk box collide, and only with the ground. With ``knees`` the knees collide,
    too, so that the folded legs of a lying robot do not sink into the ground.
    """
    spec = specify(robot, physics)
    if knees:
        _add_knees(spec, robot, physics)
    model = spec.compile()
    model.dof_damping[6:] = physics.damping
    if physics.roughness:
        # By default MuJoCo would ignore the new position of a plane that began at the origin.
        planes = [model.geom(name).id for name in GROUNDS]
        model.geom_sameframe[planes] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    return model


def specify(robot: Robot, physics: Physics) -> Any:
    """Return the ``MjSpec`` of the model, to which pictures can add limbs, textures and lights."""
    robot = robot.loaded(physics.payloads, physics.com_shift)
    spec = mujoco.MjSpec()
    spec.modelname = "a1"
    spec.compiler.degree = False
    _set_options(spec.option, physics)
    planes = {FLOOR: _TRUNK_BIT if physics.roughness else _ALL_BITS}
    if physics.roughness:
        planes |= {name: 1 << bit for bit, name in enumerate(GROUNDS)}
    for name, bits in planes.items():
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=[0, 0, 0.05],
            quat=terrain.plane_attitude(tan(radians(physics.slope)), 0.0),
            contype=0,
            conaffinity=bits,
            **_surface(physics),
        )
    base = spec.worldbody.add_body(name="base", **_inertial(robot.base))
    base.add_freejoint()
    base.add_geom(
        name="trunk",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[side / 2 for side in robot.trunk_box],
        contype=_TRUNK_BIT,
        conaffinity=0,
        **_surface(physics),
    )
    for bit, leg in enumerate(LEGS):
        _add_leg(spec, base, leg, 1 << bit, robot, physics)
    return spec


def _set_options(option: Any, physics: Physics) -> None:
    option.timestep = physics.timestep
    option.iterations = physics.iterations
    option.impratio = physics.impratio
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    # A diverged state must stay visible, and end as a fall; by default MuJoCo would restart it.
    # One robot is one island: the search for more islands takes a fifteenth of a step.
    option.disableflags = mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_ISLAND


def _surface(physics: Physics) -> dict[str, Any]:
    """Return the properties of all geoms. A larger ``sink`` gives a softer contact, with its onset over a depth."""
    yielding = min(physics.sink / 0.02, 1.0)
    return {
        "mass": 0.0,
        "condim": 4,
        "friction": [physics.friction, physics.torsion, 1e-4],
        "solref": [0.008 + 1.1 * physics.sink, 1.0],
        "solimp": [0.9 - 0.4 * yielding, 0.95 - 0.05 * yielding, 0.001 + physics.sink, 0.5, 2.0],
    }


def _inertial(inertia: Inertia) -> dict[str, Any]:
    i = inertia
    return {
        "explicitinertial": True,
        "mass": i.mass,
        "ipos": list(i.com),
        "fullinertia": [i.xx, i.yy, i.zz, i.xy, i.xz, i.yz],
    }


def _add_leg(spec: Any, base: Any, leg: Leg, bit: int, robot: Robot, physics: Physics) -> None:
    body = base
    for (part, inertia, placement), limit in zip(robot.links(leg), robot.limits, strict=True):
        body = body.add_body(name=f"{leg.name}_{part}", pos=list(placement), **_inertial(inertia))
        joint = f"{leg.name}_{part}_joint"
        body.add_joint(
            name=joint,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=list(_AXES[part]),
            range=list(limit),
            limited=True,
            armature=physics.armature,
            frictionloss=physics.dry_friction,
        )
        # its force is ctrl − kp q − kd q̇, with kp and kd written at every control tick
        spec.add_actuator(
            name=joint.removesuffix("_joint"),
            target=joint,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            forcelimited=True,
            forcerange=[-robot.torque_limit, robot.torque_limit],
        )
    foot = f"{leg.name}_foot"
    body.add_geom(
        name=foot,
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        pos=list(robot.foot_offset),
        size=[robot.foot_radius, 0, 0],
        contype=bit,
        conaffinity=0,
        **_surface(physics),
    )
    spec.add_sensor(
        name=f"{foot}_force",
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_GEOM,
        objname=f"{leg.name}_ground" if physics.roughness else FLOOR,
        reftype=mujoco.mjtObj.mjOBJ_GEOM,
        refname=foot,
        intprm=[1 << mujoco.mjtConDataField.mjCONDATA_FORCE.value, _REDUCE_TO_NET_FORCE, 1],
    )


def _add_knees(spec: Any, robot: Robot, physics: Physics) -> None:
    """Add a ball at the end of every thigh; it collides with the same plane as the trunk."""
    for leg in LEGS:
        spec.body(f"{leg.name}_thigh").add_geom(
            name=f"{leg.name}_knee",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            pos=[0.0, 0.0, -robot.thigh_length],
            size=[KNEE_RADIUS, 0, 0],
            contype=_TRUNK_BIT,
            conaffinity=0,
            **_surface(physics),
        )
