"""Mistakes of a loop in the user's own files: keys of a robot file that state them, and scales that undo them.

Both are read off the keys of a whole loop (:func:`.loop_text`): that of the files, and that of each mistake, which has
those before it. A factor f of a term, or of the action, is undone in the file from which the robot's code takes the
scale: scale' = scale / f. A loop without the scale, or with it twice, shows that the code does not use the file so.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import tomlkit

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.interface.text import loop_text
from s2r_mujoco.robot import Robot
from s2r_spec.backend import LoopMistake

Keys = Mapping[str, Any]
"""Keys of a robot file that state a loop."""


def changed_keys(robot: Robot, mistakes: Sequence[LoopMistake]) -> dict[str, Any]:
    """Return the changes of a robot file with the loop of the last mistake; see :func:`.robot_text.changed_text`."""
    if not mistakes:
        return {}
    before, document = tomllib.loads(loop_text(robot.plan)), tomlkit.parse(mistakes[-1].keys)
    after, terms = document.unwrap(), _changed_terms(before, document.unwrap())
    observation: Any = document["observation"]
    if robot.description.terms:  # the others stay as the user wrote them
        found: dict[str, Any] = {f"observation.{k}": observation[k] for k in terms}
    else:
        found = {"observation": observation} if terms else {}
    if after["history_by"] != before["history_by"]:
        found["history_by"] = after["history_by"]
    names = [name for name in after["action"] if after["action"][name] != before["action"].get(name)]
    return found | {f"action.{name}": after["action"][name] for name in names}


@dataclass(frozen=True)
class Undone:
    """What other scales in a deploy file undo.

    Attributes:
        terms: number of a term of the deploy file → (width,) its new scale.
        action: (k,) the new scale of the action; None where it stays.
        able: the mistakes that are undone.
        never: those that only other code undoes.
    """

    terms: Mapping[int, FloatArray]
    action: FloatArray | None
    able: tuple[LoopMistake, ...]
    never: tuple[LoopMistake, ...]


def undone(robot: Robot, mistakes: Sequence[LoopMistake]) -> Undone:
    """Return the scales of the robot's deploy file with which its loop lacks the mistakes, as far as there are some."""
    able: list[LoopMistake] = []
    terms: dict[int, FloatArray] = {}
    action, before = None, tomllib.loads(loop_text(robot.plan)) if mistakes else {}
    for one in mistakes:
        after = tomllib.loads(one.keys)
        changed = _changed_terms(before, after)
        if len(changed) == 1 and _rest(before, changed) == _rest(after, changed):
            (k,) = changed
            factor = _factor_of_term(robot, k, before["observation"][k], after["observation"][k])
            if factor is not None:
                terms[k] = terms.get(k, _scale(robot, k, robot.deployment.terms[k].scale)) / factor
                able.append(one)
        elif not changed and _rest(before, ()) == _rest(after, ()):
            factor = _factor_of_action(robot, before["action"], after["action"])
            if factor is not None:
                action = (robot.deployment.action_scale if action is None else action) / factor
                able.append(one)
        before = after
    return Undone(terms, action, tuple(able), tuple(one for one in mistakes if one not in able))


def _changed_terms(before: Keys, after: Keys) -> list[int]:
    pairs = zip(before["observation"], after["observation"], strict=True)
    return [k for k, (one, other) in enumerate(pairs) if one != other]


def _rest(loop: Keys, changed: Sequence[int]) -> tuple[Any, ...]:
    """Return a loop without what a factor of a term, or of the action, changes; limits before a scale follow it."""
    terms = [
        {key: value for key, value in term.items() if not (k in changed and key in ("scale", "clip"))}
        for k, term in enumerate(loop["observation"])
    ]
    action = {key: value for key, value in loop["action"].items() if key != "scale" or changed}
    return terms, loop["history_by"], action


def _factor_of_term(robot: Robot, number: int, before: Keys, after: Keys) -> FloatArray | None:
    if robot.description.terms or not robot.deployment.terms:
        return None  # the deploy file does not state the observation
    return _factor(*(_scale(robot, number, one.get("scale", ())) for one in (before, after)))


def _scale(robot: Robot, number: int, stated: Sequence[float]) -> FloatArray:
    """Return (width,) the scale of a term; a file states none, one number, or one a component."""
    assert robot.parts is not None
    return np.broadcast_to(np.array(stated or (1.0,)), robot.parts[number].width)


def _factor_of_action(robot: Robot, before: Keys, after: Keys) -> FloatArray | None:
    if len(robot.deployment.action_scale) != len(after["scale"]):
        return None
    return _factor(np.array(before["scale"]), np.array(after["scale"]))


def _factor(before: FloatArray, after: FloatArray) -> FloatArray | None:
    """Return the factor that another scale divided by it undoes; None where the code is wrong, not the number."""
    has_scale = not np.allclose(before, 1.0)
    if not (before.all() and after.all()):
        return None
    if has_scale and (np.allclose(after, 1.0) or np.allclose(after, before**2)):
        return None
    return after / before
