"""The text of a deploy file that says something else; comments and the order of keys stay.

Which number of the file stands for which number of a :class:`.Deployment` is read off its reader: each number is
changed by itself, and the file is read again. So there is one way for all formats, orders of joints, and keys that win
over others. Then the new text is read, and refused if it does not say what it should.
"""

from __future__ import annotations

from collections.abc import Mapping
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


def changed_text(path: Path, wanted: Mapping[str, FloatArray]) -> str:
    """Return the text of a deploy file with other lists.

    Args:
        path: of the file, with ``#key`` if this chooses a policy.
        wanted: name of a list (:data:`FIELDS`) → its numbers in policy order. Other lists stay.

    Raises:
        UnplacedError: the file cannot say it by other numbers in the same places.
    """
    file, key = split(path)
    text = file.read_bytes().decode("utf-8-sig")
    values = parse(text, file.name)
    before = of_values(values, file, key)
    start = _flat(before)
    target = np.concatenate([np.asarray(wanted.get(name, getattr(before, name))) for name in FIELDS])
    left, moved = target - start, []
    for number in numbers(text, file.name):
        slope = _slope(values, number, file, key, start)
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
    rest = replace(after, **{name: getattr(before, name) for name in FIELDS})
    if rest != before or not np.allclose(_flat(after), target, rtol=WRITTEN, atol=WRITTEN):
        raise UnplacedError("it does not state these numbers itself")
    return text


def _flat(deployment: Deployment) -> FloatArray:
    return np.concatenate([np.asarray(getattr(deployment, name), dtype=np.float64) for name in FIELDS])


def _slope(values: Any, number: Number, file: Path, key: str, start: FloatArray) -> FloatArray:
    """Return by how much each number of the lists grows with a number of the file; 0 for one that must stay."""
    try:
        _put(values, number, number.value + NUDGE)
        end = _flat(of_values(values, file, key))
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
