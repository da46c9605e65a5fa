"""The ``patched`` backend: a file that names a simulator and the effects to add to it.

    {"schema": "s2r/patched/1", "base": "sim", "effects": {"dry_friction": {"torque": 0.5}}}

``s2r diagnose --apply FILE`` writes the file, and every command accepts ``patched:FILE``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from s2r_spec.backend import Backend, HasEffects, load_backend
from s2r_spec.base.errors import UsageError
from s2r_spec.base.files import save

SCHEMA = "s2r/patched/1"


def write(path: Path, base: str, effects: Mapping[str, Mapping[str, float]]) -> None:
    """Write the file of a simulator ``base`` with effect → parameter → value, or raise a UsageError."""
    save(path, json.dumps({"schema": SCHEMA, "base": base, "effects": effects}, indent=2) + "\n")


def open_patched(path: str = "") -> Backend:
    """Return the simulator that a file describes; a UsageError says what is wrong with the file."""
    if not path:
        raise UsageError(
            "the patched backend needs a file: write --sim patched:FILE with a file of s2r diagnose --apply"
        )
    try:
        record = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror or error}") from None
    except ValueError as error:
        raise UsageError(f"{path} is not JSON: {error}; write it with s2r diagnose --apply") from None
    known = isinstance(record, dict) and record.get("schema") == SCHEMA
    if not known or not isinstance(record.get("effects"), dict):
        raise UsageError(
            f'{path} is not a patched simulator: the file needs "schema": "{SCHEMA}", "base" and "effects"'
        )
    backend = load_backend(str(record.get("base")))
    if not record["effects"]:
        return backend
    if not isinstance(backend, HasEffects):
        raise UsageError(
            f'{path}: "base" names {backend.name!r}, which declares no effects; name a simulator that does'
        )
    return backend.with_effects(record["effects"])
