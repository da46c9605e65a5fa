"""The catalogue of effects of a robot file, from its model: what a maker's model usually leaves out.

A size that belongs to joints has one parameter for each kind of joint (:mod:`.kinds`). Where a robot has many kinds,
one parameter stands for all, in parts of each joint's own scale. Priors are judgements without a source: half of the
typical sizes that ``docs/how-to/policies.md`` lists.

Units: SI; in a robot with many kinds of joints, parts of a scale.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import radians
from typing import Any

import numpy as np

from s2r_mujoco.arrays import FloatArray, IntArray
from s2r_mujoco.effects.kinds import Kind, scales_of
from s2r_mujoco.effects.physics import root_body
from s2r_mujoco.plan import Plan
from s2r_spec.backend import EffectParameter
from s2r_spec.effects import Change, ModelEffect, adds, scales

FRICTION, DAMPING, ARMATURE = 0.05, 0.05, 0.3
"""Prior: typical dry friction, and viscous friction at a turn or a metre a second, in parts of a joint's torque; and
typical rotor inertia, in parts of a joint's inertia."""
SPREAD, FARTHEST = 0.3, 0.8
"""Prior: spread of the friction of equal joints, and its growth from the middle of the range to an end, as parts of the
common one; definition: end of the range of the spread. Judgements, as those of ``policies.md``."""
ROTOR = 2000.0
"""Prior: acceleration that its largest torque gives to a rotor, seen behind the gear, for a model without rotors
[rad/s²]; joints of published models of A1, G1, UR5e and Panda have 900 to 9000."""
SAG = 0.2
"""Prior: part of their torque that motors lose while all give theirs at a turn or a metre a second; that of 2.3 kW of
motors at a battery of 22 V with 50 mΩ."""
LARGEST = 5.0
"""Definition: end of a range, in typical sizes."""
RARE = ("supply_sag",)
"""Prior: effects that are in a catalogue only if the user's file names them; a judgement without a source."""


@dataclass(frozen=True)
class _Joints:
    """One effect of joints: its field of :class:`.Physics`, and (nv,) the typical size of each degree of freedom."""

    name: str
    physics: str
    field: str
    unit: str
    typical: FloatArray


def catalogue(
    model: Any, plan: Plan, pose: FloatArray, kinds: Sequence[Kind], acts: bool, held: bool
) -> tuple[ModelEffect, ...]:
    """Return the catalogue of a compiled model, with the effects of :data:`RARE`.

    Args:
        model: the compiled model.
        plan: the plan of its rollouts.
        pose: (nq,) start pose.
        kinds: kinds of its joints.
        acts: whether a Python function controls it.
        held: whether it has no controller, and its base is fixed: then each joint shows its own friction.
    """
    driven = [kind for kind in kinds if kind.actuators.size]
    found = [*_of_joints(model, plan, pose, kinds, held), *_of_motors(model, plan, driven)]
    found += [] if held else [*_of_supply(model, plan, pose, driven), *_of_body(model, plan)]
    found += _of_messages(plan.step, sees=not (acts or held))
    if not acts:
        found += _of_sensing(kinds, plan)
    return tuple(found)


def _of_joints(
    model: Any, plan: Plan, pose: FloatArray, kinds: Sequence[Kind], held: bool
) -> Iterator[ModelEffect]:
    inertia, torque = scales_of(model, plan, pose)
    rotors = np.where(
        model.dof_armature > 0.0, ARMATURE * inertia, np.maximum(ARMATURE * inertia, torque / ROTOR)
    )
    turn = np.ones(model.nv)
    for kind in kinds:
        turn[kind.dof] = 1.0 if kind.slides else 2.0 * np.pi
    rows = (
        _Joints("dry_friction", "Joints rub with a force that does not depend on speed.", "friction", "N*m",
                FRICTION * torque),
        _Joints("viscous_friction", "Joints rub in proportion to their speed.", "damping", "N*m*s/rad",
                DAMPING * torque / turn),
        _Joints("armature", "Rotors behind the gears add to the inertia of the joints.", "armature", "kg*m^2",
                rotors),
    )  # fmt: skip
    linear = {"N*m": "N", "N*m*s/rad": "N*s/m", "kg*m^2": "kg"}
    for row in rows:
        parameters = []
        for kind in kinds:
            size, unit, change = _size(kind, row.typical, linear[row.unit] if kind.slides else row.unit)
            parameters.append(
                (kind.name, unit, 0.0, LARGEST * size, 0.0, f"half-normal, {size / 2.0:.3g} {unit}".strip(),
                 change(row.field))
            )  # fmt: skip
        effect = ModelEffect.of(row.name, "joints", row.physics, *parameters)
        yield _as_found(effect, model, kinds) if held and row.field == "friction" else effect


def _as_found(effect: ModelEffect, model: Any, kinds: Sequence[Kind]) -> ModelEffect:
    """Return a friction with its form as logs of single joints show it: by position, and of each joint.

    A linkage or a cable presses by another force at each angle. No two joints have the same friction.
    """
    parameters, changes = list(effect.parameters), list(effect.changes)

    def add(name: str, far: float, beside: str, change: Change) -> None:
        prior = f"normal around 0, standard deviation {SPREAD:g}"
        parameters.append(EffectParameter(name, "", -far, far, 0.0, prior, beside))
        changes.append(change)

    for kind in kinds:
        if model.jnt_limited[kind.joints].all():
            add(f"{kind.name}_by_position", 1.0, kind.name, adds("position", kind.dof))
        for side, dof in zip(kind.sides, kind.dof.tolist(), strict=False):
            grown = Change("friction", lambda before, value: before * (1.0 + value), dof)
            add(f"{kind.name}_{side}", FARTHEST, kind.name, grown)
    return replace(effect, parameters=tuple(parameters), changes=tuple(changes))


def _size(kind: Kind, typical: FloatArray, unit: str) -> tuple[float, str, Any]:
    """Return the typical size of a kind, its unit, and what changes a field: by the size, or in parts of typical."""
    own = typical[kind.dof]
    if own.max() <= 2.0 * own.min():
        return float(f"{np.median(own):.2g}"), unit, lambda field: adds(field, kind.dof)
    return 1.0, "", lambda field: Change(field, lambda before, value: before + value * own, kind.dof)


def _of_motors(model: Any, plan: Plan, kinds: Sequence[Kind]) -> Iterator[ModelEffect]:
    def factors(
        field: str, low: float, high: float, prior: str, at: dict[str, IntArray]
    ) -> list[tuple[Any, ...]]:
        return [(name, "", low, high, 1.0, prior, scales(field, own)) for name, own in at.items()]

    every = {kind.name: kind.actuators for kind in kinds}
    if not every:
        return
    normal = "normal around 1, standard deviation 0.1"
    yield ModelEffect.of(
        "motor_strength", "actuation", "Motors give this part of the torque that they should.",
        *factors("strength", 0.4, 1.3, normal, every),
    )  # fmt: skip
    limited = _of_kinds(kinds, lambda own: _is_limited(model, plan, own))
    if limited:
        yield ModelEffect.of(
            "torque_limit", "actuation", "Motors reach this part of their largest torque.",
            *factors("limit", 0.0, 1.0, "1 minus half-normal, 0.25", limited),
        )  # fmt: skip
    servos = _of_kinds(kinds, lambda own: _has_gains(model, plan, own))
    if servos:
        prior = "normal around 1, standard deviation 0.15"
        for name, word, field in (("kp", "stiffness", "stiffness"), ("kd", "damping", "derivative")):
            words = f"The {word} of the joints' position control is this part of the stated one."
            yield ModelEffect.of(name, "actuation", words, *factors(field, 0.3, 1.75, prior, servos))


def _of_kinds(kinds: Sequence[Kind], able: Callable[[IntArray], Any]) -> dict[str, IntArray]:
    """Return kind → its able actuators, for kinds that have some."""
    found = {kind.name: kind.actuators[able(kind.actuators)] for kind in kinds}
    return {name: own for name, own in found.items() if own.size}


def _is_limited(model: Any, plan: Plan, actuators: IntArray) -> Any:
    joints = model.actuator_trnid[actuators, 0]
    found = model.actuator_forcelimited[actuators].astype(bool) | model.jnt_actfrclimited[joints].astype(bool)
    plain = model.actuator_biastype[actuators] == 0
    found |= plain & model.actuator_ctrllimited[actuators].astype(bool)
    limits = dict(zip(plan.joints.actuators.tolist(), plan.law.torque_limit.tolist(), strict=True))
    return found | np.array([np.isfinite(limits.get(int(one), np.inf)) for one in actuators], dtype=bool)


def _has_gains(model: Any, plan: Plan, actuators: IntArray) -> Any:
    """Return which actuators have both gains: of one with kp alone, another kp is another strength of its motor."""
    if plan.law.pd == "model":
        return (model.actuator_biasprm[actuators, 1] < 0.0) & (model.actuator_biasprm[actuators, 2] < 0.0)
    both = (plan.law.stiffness > 0.0) & (plan.law.damping > 0.0)
    return np.isin(actuators, plan.joints.actuators[both])


def _of_supply(model: Any, plan: Plan, pose: FloatArray, kinds: Sequence[Kind]) -> Iterator[ModelEffect]:
    torque = scales_of(model, plan, pose)[1]
    speeds = [
        (kind.joints[np.isin(kind.joints, model.actuator_trnid[kind.actuators, 0])], kind) for kind in kinds
    ]
    rated = sum(
        torque[model.jnt_dofadr[own]].sum() * (1.0 if kind.slides else 2.0 * np.pi) for own, kind in speeds
    )
    if rated:
        size = float(f"{SAG / rated:.2g}")
        yield ModelEffect.of(
            "supply_sag", "actuation", "Motors lose this part of their torque for each watt that all of them give.",
            ("per_watt", "1/W", 0.0, LARGEST * size, 0.0, f"half-normal, {size / 2.0:.3g} 1/W", adds("sag")),
        )  # fmt: skip


def _of_body(model: Any, plan: Plan) -> Iterator[ModelEffect]:
    body = root_body(model, plan)
    mass = float(model.body_subtreemass[body])
    typical, reach = float(f"{0.1 * mass:.2g}"), float(f"{0.1 * np.cbrt(mass / 1000.0):.2g}")
    yield ModelEffect.of(
        "payload", "body", "The root body carries a mass.",
        ("mass", "kg", 0.0, LARGEST * typical, 0.0, f"half-normal, {typical / 2.0:.3g} kg", adds("mass")),
    )  # fmt: skip
    if plan.root >= 0:
        yield ModelEffect.of(
            "com_offset", "body", "The centre of mass of the root body lies elsewhere.",
            *((name, "m", -LARGEST * reach, LARGEST * reach, 0.0, f"normal, {reach / 2.0:.3g} m", adds("centre", k))
              for k, name in enumerate("xyz")),
        )  # fmt: skip
        yield ModelEffect.of(
            "slope", "ground", "The ground falls forward or to the left by this angle.",
            *((name, "deg", -10.0, 10.0, 0.0, "normal, 1.5 deg", _angle("slope", k))
              for k, name in enumerate(("forward", "left"))),
        )  # fmt: skip
        yield ModelEffect.of(
            "ground_friction", "ground", "All coefficients of friction are this part of the model's.",
            ("factor", "", 0.2, 2.5, 1.0, "log-normal, deviation 0.35", scales("ground")),
        )  # fmt: skip


def _angle(field: str, at: int) -> Change:
    """Return the change that adds an angle [deg] to a field [rad]."""
    return Change(field, lambda before, value: before + radians(value), at)


def _of_messages(step: float, sees: bool) -> Iterator[ModelEffect]:
    late = float(f"{step:.2g}")
    rows = [("sending", "action_delay", "Targets reach the motors this much later")]
    if sees:
        rows.insert(
            0, ("sensing", "observation_delay", "The policy sees the robot as it was this much earlier")
        )
    for field, name, words in rows:
        yield ModelEffect.of(
            name, "timing", f"{words}; jitter is the standard deviation of the delay, as a part of it.",
            ("time", "s", 0.0, LARGEST * late, 0.0, f"half-normal, {late / 2.0:.3g} s", adds(field)),
            ("jitter", "", 0.0, 0.5, 0.0, "half-normal, 0.15", adds(f"{field}_jitter")),
        )  # fmt: skip
    yield ModelEffect.of(
        "actuator_lag", "actuation", "Targets pass a filter of the first order with this time constant.",
        ("time", "s", 0.0, LARGEST * late, 0.0, f"half-normal, {late / 2.0:.3g} s", adds("lag")),
    )  # fmt: skip


def _of_sensing(kinds: Sequence[Kind], plan: Plan) -> Iterator[ModelEffect]:
    yield ModelEffect.of(
        "encoder_offset", "sensing", "The measured positions of joints are too large by this much.",
        *((kind.name, "m" if kind.slides else "rad", -0.15, 0.15, 0.0, f"normal, 0.02 {'m' if kind.slides else 'rad'}",
           adds("offset", kind.dof)) for kind in kinds),
    )  # fmt: skip
    if plan.root >= 0:
        yield ModelEffect.of(
            "imu_tilt", "sensing", "The IMU is mounted with this roll and pitch.",
            *((name, "deg", -6.0, 6.0, 0.0, "normal, 1 deg", _angle("tilt", k))
              for k, name in enumerate(("roll", "pitch"))),
        )  # fmt: skip
        yield ModelEffect.of(
            "gyro_bias", "sensing", "The gyroscope measures too much by this.",
            *((name, "rad/s", -0.2, 0.2, 0.0, "normal, 0.03 rad/s", adds("gyro", k)) for k, name in enumerate("xyz")),
        )  # fmt: skip
