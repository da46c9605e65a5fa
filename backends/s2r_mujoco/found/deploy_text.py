"""The text of a deploy file that says something else; comments and the order of keys stay.

Which number of the file stands for which number of a :class:`.Deployment` is read off its reader: each number is
changed by itself, and the file is read again. So there is one way for all formats, orders of joints, and keys that win
over others. Then the new text is read, and refused if it does not say what it should.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.deploy import of_values, split
from s2r_mujoco.deploy.record import Deployment
from s2r_mujoco.deploy.yaml import Number, numbers, parse
from s2r_spec.errors import UsageError

FIELDS = ("joint_pos", "stiffness", "damping", "action_scale", "action_offset")
"""Definition: lists of a deployment that a file may be made to say."""
NUDGE = 0.125
"""Definition: by how much each number is changed to see what it stands for, in its own unit."""
SAME, WRITTEN = 1e-9, 1e-5
"""Tolerance: difference of steps that should be equal, and of numbers that are written with six digits."""


class UnplacedError(Exception):
    """No other numbers in the same places make the file say it; the message is the reason."""


def changed_text(path: Path, wanted: Mapping[str, FloatArray], scales: Mapping[int, FloatArray]) -> str:
    """Return the text of a deploy file with other lists, and other scales of terms.

    Args:
        path: of the file, with ``#key`` if this chooses a policy.
        wanted: name of a list (:data:`FIELDS`) → its numbers in policy order. Other lists stay.
        scales: number of a term of the observation → (width,) its scale. Other terms stay.

    Raises:
        UnplacedError: the file cannot say it by other numbers in the same places.
    """
    file, key = split(path)
    text = file.read_bytes().decode("utf-8-sig")
    values = parse(text, file.name)
    before = of_values(values, file, key)
    start = _flat(before, scales)
    lists = [np.asarray(wanted.get(name, getattr(before, name))) for name in FIELDS]
    target = np.concatenate([*lists, *scales.values()])
    left, moved = target - start, []
    for number in numbers(text, file.name):
        slope = _slope(values, number, lambda: _flat(of_values(values, file, key), scales), start)
        at = slope != 0.0
        if not left[at].any():
            continue
        steps = left[at] / slope[at]
        if not np.allclose(steps, steps[0], rtol=SAME, atol=SAME):
            raise UnplacedError(f"line {number.line} has one number for several joints, which now differ")
        left = left - steps[0] * slope
        moved.append((number, number.value + float(steps[0])))
    for number, value in reversed(moved):
        text = text[: number.start] + f"{value:.6g}" + text[number.stop :]
    after = of_values(parse(text, file.name), file, key)
    if _with_lists_of(before, after, scales) != before or not np.allclose(
        _flat(after, scales), target, rtol=WRITTEN, atol=WRITTEN
    ):
        raise UnplacedError("it does not state these numbers itself")
    return text


def _flat(deployment: Deployment, scales: Mapping[int, FloatArray]) -> FloatArray:
    """Return all numbers of the lists, and the scales of these terms, a number for each component."""
    lists = [np.asarray(getattr(deployment, name), dtype=np.float64) for name in FIELDS]
    stated = ((np.array(deployment.terms[k].scale or (1.0,)), own) for k, own in scales.items())
    return np.concatenate([*lists, *(np.broadcast_to(one, own.shape) for one, own in stated)])


def _with_lists_of(before: Deployment, after: Deployment, scales: Mapping[int, FloatArray]) -> Deployment:
    """Return what a file says, with the lists and the scales of what it said before."""
    terms = [
        replace(term, scale=before.terms[k].scale) if k in scales else term
        for k, term in enumerate(after.terms)
    ]
    names = [*FIELDS, *["command_scale" for k in scales if before.terms[k].name == "velocity_commands"]]
    return replace(after, terms=tuple(terms), **{name: getattr(before, name) for name in names})


def _slope(values: Any, number: Number, read: Callable[[], FloatArray], start: FloatArray) -> FloatArray:
    """Return by how much each number of the lists grows with a number of the file; 0 for one that must stay."""
    try:
        _put(values, number, number.value + NUDGE)
        end = read()
        return (end - start) / NUDGE if end.shape == start.shape else np.zeros_like(start)
    except UsageError:  # a count or an index
        return np.zeros_like(start)
    finally:
        _put(values, number, int(number.value) if number.whole else number.value)


def _put(values: Any, number: Number, value: float) -> None:
    for *above, last in number.paths:
        table = values
        for part in above:
            table = getattr(table, "value", table)[part]
        getattr(table, "value", table)[last] = value
