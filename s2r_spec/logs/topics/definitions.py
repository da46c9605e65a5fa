"""Definitions of the messages of ROS 2 for bags that hold none, as those recorded before Iron.

``sensor_msgs/Range`` and some others changed from one distribution to a later one. The definition is the one by which
every message of the topic can be decoded to its last byte. Import this module only with ``rosbags``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

_ROS2 = "ros2_"
"""Definition: what precedes a distribution's name in rosbags."""


def find_definitions(kind: str, messages: Iterable[bytes], distribution: str) -> tuple[Typestore | None, str]:
    """Return the definitions that fit messages, or None and why there are none, as text after the topic's name.

    Args:
        kind: type of the messages.
        messages: the messages of a topic in CDR; they are read as far as they are needed to decide.
        distribution: that of the recorder, in lower case, which decides where several fit; "" if it is unknown.
    """
    left = versions(kind)
    lacking = f"has messages of the type {kind}, whose definition the bag lacks"
    if not left:
        return None, lacking
    number = 0
    for number, message in enumerate(messages if len(left) > 1 else (), 1):
        fit = [names for names in left if _fits(names[0], kind, message)]
        if not fit:
            return None, f"{lacking}; message {number} does not fit the one of {_releases(left)}"
        left = fit
        if len(left) == 1:
            break
    recorded = [names for names in left if distribution in names]
    if number and len(left) > 1 and not recorded:
        return None, (
            f"{lacking}; those of {_releases(left)} fit. Write the right one into the bag by `ros2 bag convert` "
            f"with the recorder's ROS"
        )
    return _store((recorded or left)[0][0]), ""


def versions(kind: str) -> list[list[str]]:
    """Return the distributions that know a type, newest first, those with the same definition together."""
    names: dict[Any, list[str]] = {}
    for store in reversed(Stores):
        if store.value.startswith(_ROS2):
            definitions = get_typestore(store).fielddefs
            if kind in definitions:
                names.setdefault(_expand(definitions, kind), []).append(store.value.removeprefix(_ROS2))
    return list(names.values())


def _expand(definitions: Any, kind: str) -> tuple[Any, ...]:
    fields: list[tuple[Any, ...]] = []
    for name, (shape, content) in definitions[kind][1]:
        if shape in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            (inner, held), length = content
            held = _expand(definitions, held) if inner == Nodetype.NAME else held
            fields.append((name, shape, inner, held, length))
        else:
            fields.append((name, shape, _expand(definitions, content) if shape == Nodetype.NAME else content))
    return tuple(fields)


@cache  # it keeps the code that it generates to decode each type
def _store(distribution: str) -> Typestore:
    return get_typestore(Stores(_ROS2 + distribution))


def _fits(distribution: str, kind: str, message: bytes) -> bool:
    try:
        _store(distribution).deserialize_cdr(message, kind)
    except Exception:  # of rosbags, or of what a wrong length leads to
        return False
    return True


def _releases(versions: Sequence[Sequence[str]]) -> str:
    """Return distributions as text: ``Iron to Lyrical or Dashing to Humble``."""
    return " or ".join(
        f"{names[-1].title()} to {names[0].title()}" if len(names) > 1 else names[0].title()
        for names in versions
    )
