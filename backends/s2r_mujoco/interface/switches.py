"""Mistakes that code around a policy may have, each as a loop of its own: the plan with one thing changed.

Only what the files make possible is here: an order of joints that another convention of the field has, an exchange of
terms that are equally wide, a factor that libraries of the field use. A mistake is a *rival model* of the loop: it has
no size, and it is there or not.

Sources of the orders: Isaac Lab lists joints breadth first, so by their kind; MuJoCo and Isaac Gym depth first, so leg
by leg; the vendors' controllers begin with the right legs. Factors: the observation scales of legged_gym.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import mujoco
import numpy as np

from s2r_mujoco.arrays import FloatArray, IntArray
from s2r_mujoco.deploy.record import Term
from s2r_mujoco.effects.kinds import kind_name
from s2r_mujoco.interface.text import loop_text
from s2r_mujoco.joints import Joints
from s2r_mujoco.observation import Memory, Part, Parts
from s2r_mujoco.plan import Plan
from s2r_mujoco.robot import Robot
from s2r_spec.backend import LoopMistake

FACTORS = {0.05: "", 0.25: "", 0.5: "", 2.0: "", 4.0: "", 20.0: "", np.pi / 180.0: "turned into radians twice",
           180.0 / np.pi: "in degrees instead of radians"}  # fmt: skip
"""Definition: factors of the field → what one means; degrees only for angles."""
LATEST = 2
"""Budget: ticks by which a term may be late."""
SIDES = (("left", "right"), ("l", "r"), ("fl", "fr"), ("rl", "rr"), ("hl", "hr"), ("bl", "br"), ("lf", "rf"),
         ("lh", "rh"), ("lr", "rr"))  # fmt: skip
"""Definition: words of names for the left, and for the right."""
ENDS = (("front", "rear"), ("front", "hind"), ("f", "r"), ("f", "h"), ("fl", "rl"), ("fr", "rr"), ("fl", "hl"),
        ("fr", "hr"), ("lf", "lh"), ("rf", "rh"))  # fmt: skip
"""Definition: words of names for the front, and for the rear."""


@dataclass(frozen=True)
class Switch:
    """A mistake of the loop.

    Attributes:
        quantity: the term of the observation, "target", "action" or "loop".
        words: what is wrong, in words after the quantity.
        equation: what holds instead.
        plan: the loop with the mistake.
    """

    quantity: str
    words: str
    equation: str
    plan: Plan

    @property
    def mistake(self) -> LoopMistake:
        """The mistake with the keys of a robot file that state it."""
        return LoopMistake(self.quantity, self.words, self.equation, loop_text(self.plan))


def switches(robot: Robot, plan: Plan | None = None) -> list[Switch]:
    """Return the mistakes that the files of a robot make possible, beside those of a plan.

    There are none without a trained policy, and where a term is a function of the user's.
    """
    if robot.policy is None or not robot.parts:
        return []
    plan = robot.plan if plan is None else plan
    memory = Memory(np.zeros(3), np.zeros(len(plan.law.moved)))
    parts = Parts(plan, robot.model, mujoco.MjData(robot.model), memory).of(plan.terms, {})
    found = [one for k, part in enumerate(parts) for one in _of_term(_Place(plan, k, part))]
    found += [*_exchanged(plan, parts), *_orders_of_all(plan, parts), *_of_action(plan), *_of_history(plan)]
    return found


def delayed(robot: Robot) -> list[Plan]:
    """Return the loops in which all that is measured is late by some ticks: a delay, and no mistake."""
    known = [part.senses == "known" for part in robot.parts or ()]
    found = []
    for ticks in range(1, LATEST + 1):
        late = {
            k: replace(term, late=term.late + ticks)
            for k, (term, own) in enumerate(zip(robot.plan.terms, known, strict=True))
            if not own
        }
        found.append(_with(robot.plan, late))
    return found


def _with(plan: Plan, terms: dict[int, Term]) -> Plan:
    return replace(plan, terms=tuple(terms.get(k, term) for k, term in enumerate(plan.terms)))


@dataclass(frozen=True)
class _Place:
    """A term at its place in a plan."""

    plan: Plan
    number: int
    part: Part

    @property
    def term(self) -> Term:
        return self.plan.terms[self.number]

    @property
    def name(self) -> str:
        return self.part.name

    @property
    def has_joints(self) -> bool:
        """Whether it has a component for each joint of the policy."""
        of_joints = self.term.name.startswith("joint_") or self.term.name == "last_action"
        return of_joints and self.part.width == len(self.plan.joints)

    def switch(self, words: str, equation: str, **values: Any) -> Switch:
        changed = _with(self.plan, {self.number: replace(self.term, **values)})
        return Switch(self.name, words, f"{self.name}{equation}", changed)


def _of_term(place: _Place) -> Iterator[Switch]:
    yield from _scales(place)
    yield from _frames(place)
    if place.part.senses != "known" or place.term.name == "last_action":
        for ticks in range(1, LATEST + 1):
            words, late = f"is {ticks} tick{'s' * (ticks > 1)} late", place.term.late + ticks
            yield place.switch(words, f"[k] = files[k − {ticks}]", late=late)
    if place.term.name == "phase":
        for factor in (0.5, 2.0):
            frequency = factor * place.term.frequency
            yield place.switch(
                f"runs {factor:g} times as fast", f": f = {factor:g} · files", frequency=frequency
            )
        parts = (place.term.parts or ("sin", "cos"))[::-1]
        yield place.switch("has sine and cosine exchanged", ": sin ↔ cos", parts=parts)
    if place.term.name == "joint_pos_rel":
        yield place.switch("has no default pose subtracted", " = files + default", name="joint_pos")
    if place.term.name == "joint_pos":
        yield place.switch("has the default pose subtracted", " = files − default", name="joint_pos_rel")
    if place.has_joints:
        for words, order in orders(place.plan.joints):
            yield place.switch(words, "[i] = files[order[i]]", order=_ordered(place.term, order).order)


def _scales(place: _Place) -> Iterator[Switch]:
    """Yield other scales and signs of a term; none of one that is always zero."""
    scale = np.broadcast_to(np.array(place.term.scale or (1.0,)), place.part.width)
    if not scale.all():
        return

    def scaled(factor: FloatArray | float, words: str, equation: str) -> Switch:
        return place.switch(words, equation, scale=tuple((scale * factor).tolist()))

    angles = place.part.senses in ("angular", "position") or place.name.startswith("joint_")
    yield scaled(0.0, "is always zero", " = 0")
    for factor, words in FACTORS.items():
        if not words or angles:
            meaning = f": {words}" if words else ""
            yield scaled(factor, f"is {factor:.3g} times as large{meaning}", f" = {factor:.4g} · files")
    if not np.allclose(scale, 1.0):
        yield scaled(1.0 / scale, "has no scale", " = files / scale")
        yield scaled(scale, "is scaled twice", " = scale · files")
    for signs, words in _signs(place.plan, place.part):
        yield scaled(signs, words, " = ±files")


def _frames(place: _Place) -> Iterator[Switch]:
    vector = place.part.senses in ("vector", "angular") and place.term.name != "projected_gravity"
    if vector and place.term.frame == "body" and place.plan.root >= 0:
        yield place.switch("is in axes of the world", " = R files", frame="world")


def _ordered(term: Term, order: IntArray) -> Term:
    before = np.array(term.order or range(order.size))
    return replace(term, order=tuple(before[order].tolist()))


def _signs(plan: Plan, part: Part) -> Iterator[tuple[FloatArray, str]]:
    """Yield (width,) signs with words: all, or those of one kind of joint, or of one axis."""
    yield -np.ones(part.width), "has the wrong sign"
    groups: dict[str, list[int]] = {}
    if part.width == len(plan.joints) and part.term.name.startswith("joint_"):
        groups = _by_kind(plan)
    elif part.width == 3 and part.senses != "known":
        groups = {axis: [i] for i, axis in enumerate("xyz")}
    for name, own in groups.items() if len(groups) > 1 else ():
        signs = np.ones(part.width)
        signs[own] = -1.0
        yield signs, f"has the wrong sign in {name}"


def _by_kind(plan: Plan) -> dict[str, list[int]]:
    """Return kind of joint → places of its joints in the policy."""
    groups: dict[str, list[int]] = {}
    for i, joint in enumerate(plan.joints.names):
        groups.setdefault(kind_name(joint), []).append(i)
    return groups


def orders(joints: Joints) -> Iterator[tuple[str, IntArray]]:
    """Yield (n,) orders of joints by other conventions, with words; each once, and none that changes nothing."""
    names, n = joints.names, len(joints)
    seen = {tuple(range(n))}
    kinds = [kind_name(name) for name in names]
    rank = {kind: number for number, kind in enumerate(dict.fromkeys(kinds))}
    by_kind = np.array(sorted(range(n), key=lambda i: (rank[kinds[i]], i)))
    limbs = [_limb(name) for name in names]
    first = {limb: number for number, limb in enumerate(dict.fromkeys(limbs))}
    by_limb = np.array(sorted(range(n), key=lambda i: (first[limbs[i]], i)))
    by_motor = np.argsort(joints.actuators)
    found = [("has left and right exchanged", _paired(names, SIDES))]
    found += [("has front and rear exchanged", _paired(names, ENDS))]
    for words, order in (("by motors", by_motor), ("by kind of joint", by_kind), ("limb by limb", by_limb)):
        found += [
            (f"is ordered {words}", order),
            (f"is read as if it were ordered {words}", np.argsort(order)),
        ]
    for words, order in found:
        if tuple(order.tolist()) not in seen:
            seen.add(tuple(order.tolist()))
            yield words, order


def _words(name: str) -> list[str]:
    return name.replace("-", "_").replace(".", "_").lower().split("_")


def _limb(name: str) -> tuple[str, ...]:
    """Return the words of a name that say where on a robot a joint is."""
    kind = kind_name(name).split("_")
    return tuple(word for word in _words(name) if word not in kind)


def _paired(names: Sequence[str], pairs: Sequence[tuple[str, str]]) -> IntArray:
    """Return (n,) each joint's partner, whose name has one word of a pair exchanged; itself where it has none."""
    place = {tuple(_words(name)): i for i, name in enumerate(names)}
    partners = {(a, b) for one, other in pairs for a, b in ((one, other), (other, one))}
    order = np.arange(len(names))
    for i, name in enumerate(names):
        words = _words(name)
        others = [
            (*words[:k], b, *words[k + 1 :]) for k, word in enumerate(words) for a, b in partners if a == word
        ]
        order[i] = next((place[other] for other in others if other in place), i)
    return order if (order[order] == np.arange(order.size)).all() else np.arange(order.size)


def _exchanged(plan: Plan, parts: Sequence[Part]) -> Iterator[Switch]:
    """Yield the exchange of two terms of one width and one history."""
    for i, k in combinations(range(len(parts)), 2):
        one, other = parts[i], parts[k]
        if one.width == other.width and one.term.history == other.term.history:
            changed = _with(plan, {i: plan.terms[k], k: plan.terms[i]})
            words = f"and {other.name} are exchanged"
            yield Switch(one.name, words, f"{one.name} = {other.name} and {other.name} = {one.name}", changed)


def _orders_of_all(plan: Plan, parts: Sequence[Part]) -> Iterator[Switch]:
    """Yield other orders of all measured joints, and of these with the targets."""
    measured = [
        k for k, part in enumerate(parts)
        if part.term.name.startswith("joint_") and part.width == len(plan.joints)
    ]  # fmt: skip
    for words, order in orders(plan.joints):
        changed = _with(plan, {k: _ordered(plan.terms[k], order) for k in measured})
        if len(measured) > 1:
            yield Switch("each measured joint term", words, "q[i] = files[order[i]], and q̇", changed)
        back = replace(changed, law=replace(plan.law, order=np.argsort(order)))
        yield Switch("every joint term, and the target,", words, "all of order[i]", back)


def _of_action(plan: Plan) -> Iterator[Switch]:
    law, n = plan.law, len(plan.joints)

    def changed(words: str, equation: str, **values: Any) -> Switch:
        return Switch("target", words, equation, replace(plan, law=replace(law, **values)))

    for factor in (0.25, 0.5, 2.0, 4.0):
        equation = f"target = offset + {factor:g} · scale · action"
        yield changed(f"has {factor:g} times the scale of the action", equation, scale=factor * law.scale)
    if not np.allclose(law.scale, 1.0):
        yield changed("has no scale of the action", "target = offset + action", scale=np.ones_like(law.scale))
    if law.offset.any():
        yield changed("has no default pose", "target = scale · action", offset=np.zeros_like(law.offset))
    if len(law.moved) != n:
        return
    for words, order in orders(plan.joints):
        yield changed(words, "target[i] = files[order[i]]", order=order)
        # The action alone in another order: each joint keeps its own offset and scale.
        back = np.argsort(order)
        yield changed(
            f"{words}, before the offset", "target = offset + scale · action[order]", order=order,
            offset=law.offset[back], scale=law.scale[back],
        )  # fmt: skip
    groups = _by_kind(plan)
    for name, own in {"": list(range(n)), **(groups if len(groups) > 1 else {})}.items():
        signs = np.ones(n)
        signs[own] = -1.0
        words = "has the wrong sign of the action" + f" in {name}" * bool(name)
        yield changed(words, "target = offset − scale · action", scale=signs * law.scale)


def _of_history(plan: Plan) -> Iterator[Switch]:
    if all(term.history == 1 for term in plan.terms):
        return
    turned = {k: replace(term, newest_first=not term.newest_first) for k, term in enumerate(plan.terms)}
    yield Switch("history", "is in the other order of time", "newest ↔ oldest", _with(plan, turned))
    if len({term.history for term in plan.terms}) == 1:
        other = "term" if plan.history_by == "time" else "time"
        yield Switch(
            "history", f"is ordered by {other}", f"history by {other}", replace(plan, history_by=other)
        )
