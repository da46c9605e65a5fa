"""Read the metadata that exporters of mjlab and whole_body_tracking write into an ONNX file.

A list is text with commas between its items, rounded to three decimals. Names of terms are those of the training's
configuration: ``joint_pos`` is relative to the default pose there. Neither scales nor limits of terms, nor the control
period, are in the metadata. Source: mjlab/rl/exporter_utils.py of mjlab and unitree_rl_mjlab,
whole_body_tracking/utils/exporter.py.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from s2r_mujoco.deploy.record import MOST_HISTORY, Deployment, Term
from s2r_mujoco.deploy.section import Section, is_number, shown

KEYS = ("joint_names", "default_joint_pos", "observation_names", "action_scale")
"""Definition: keys of which one, beside ``joint_names``, tells these exporters' metadata."""
OTHER_NAMES = {
    "joint_pos": "joint_pos_rel",
    "joint_vel": "joint_vel_rel",
    "actions": "last_action",
    "action": "last_action",
    "prev_actions": "last_action",
    "velocity_command": "velocity_commands",
}
"""Definition: the exporters' names of terms → names here."""
COMMANDS = {"command", "commands", "generated_commands"}
"""Definition: names of the term that has the command; ``command_names`` says which one."""
VELOCITIES = {"twist", "base_velocity"}
"""Definition: names of the command of a velocity; ``motion`` is a motion to track, which has no meaning here."""
_WORDS = {"joint_names", "observation_names", "command_names"}
_NUMBERS = {
    "default_joint_pos",
    "joint_stiffness",
    "joint_damping",
    "action_scale",
    "observation_history_lengths",
}
MOST_LETTERS = 200_000
"""Budget: letters of one entry of the metadata; 100 joints have about 3,000."""


def of_metadata(metadata: Mapping[str, str], source: str) -> Deployment | None:
    """Return what the metadata of an ONNX file says; None where it is no deployment's.

    Raises:
        UsageError: a list has another length than ``joint_names``, or a number is none.
    """
    if "joint_names" not in metadata or not any(key in metadata for key in KEYS[1:]):
        return None
    lists = _WORDS | _NUMBERS
    values = {key: _items(key, text, source) if key in lists else text for key, text in metadata.items()}
    file = Section({key: value for key, value in values.items() if value not in ("", [])}, source)
    joints = file.texts("joint_names")
    count, per = len(joints), "one a joint by joint_names"
    default = file.numbers("default_joint_pos", count, per) if file.has("default_joint_pos") else ()
    scale = file.spread("action_scale", count, per) if file.has("action_scale") else ()
    return Deployment(
        source=source,
        format="onnx",
        joints=joints,
        joint_pos=default,
        stiffness=file.gains("joint_stiffness", count, per) if file.has("joint_stiffness") else (),
        damping=file.gains("joint_damping", count, per) if file.has("joint_damping") else (),
        terms=_terms(file),
        action_scale=scale,
        action_offset=default if scale else (),
        unused=file.unused(),
    )


def _items(key: str, text: str, source: str) -> Any:
    """Return the items of a list, or one number; some exporters write JSON instead of commas."""
    if len(text) > MOST_LETTERS:
        Section({}, source).fail(key, f"has {len(text):,} letters; a list of the metadata has fewer")
    if text.lstrip().startswith(("[", "{")):
        try:
            return json.loads(text, parse_constant=lambda word: word)
        except (ValueError, RecursionError):
            Section({}, source).fail(key, f"is neither a list with commas nor JSON: {shown(text)}")
    parts = [part.strip() for part in text.split(",")]
    items = [_number(part, key, source) if key not in _WORDS else part for part in parts if part]
    return items[0] if key == "action_scale" and len(items) == 1 else items


def _number(part: str, key: str, source: str) -> float:
    try:
        number = float(part)
    except ValueError:
        number = float("nan")
    if not abs(number) < float("inf"):
        Section({}, source).fail(key, f"must be numbers with commas between them, not {shown(part)}")
    return number


def _terms(file: Section) -> tuple[Term, ...]:
    if not file.has("observation_names"):
        return ()
    names = file.texts("observation_names")
    commands = set(file.texts("command_names")) if file.has("command_names") else set()
    histories = _histories(file, names)
    terms = []
    for name, history in zip(names, histories, strict=True):
        own = OTHER_NAMES.get(name, name)
        if name in COMMANDS and (not commands or commands & VELOCITIES):
            own = "velocity_commands"
        terms.append(Term(own, history=history, source=f"{file.place('observation_names')}: {name}"))
    return tuple(terms)


def _histories(file: Section, names: tuple[str, ...]) -> tuple[int, ...]:
    key = "observation_history_lengths"
    if not file.has(key):
        return (1,) * len(names)
    lengths = file.get(key)
    if isinstance(lengths, Mapping):  # name → length
        lengths = [lengths.get(name, 1) for name in names]
    if not isinstance(lengths, list) or len(lengths) != len(names):
        file.fail(
            key, f"must have {len(names)} numbers, one a term by observation_names, not {shown(lengths)}"
        )
    if not all(is_number(one) and one == int(one) and 0 <= one <= MOST_HISTORY for one in lengths):
        file.fail(key, f"must be whole numbers from 0 to {MOST_HISTORY}, not {shown(lengths)}")
    return tuple(max(int(one), 1) for one in lengths)
