"""The ``patched`` backend: a simulator with the effects that a diagnosis named, kept as a file.

    {"schema": "s2r/patched/1", "base": "sim", "effects": {"dry_friction": {"torque": 0.5}}}

``s2r diagnose --apply FILE`` writes it, and every command takes ``patched:FILE``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from s2r_spec.backend import Backend, HasEffects, load_backend
from s2r_spec.errors import UsageError
from s2r_spec.files import save

SCHEMA = "s2r/patched/1"


def write(path: Path, base: str, effects: Mapping[str, Mapping[str, float]]) -> None:
    """Write a patched simulator.

    Raises:
        UsageError: the file cannot be written.
    """
    text = json.dumps({"schema": SCHEMA, "base": base, "effects": effects}, indent=2)
    save(path, text + "\n")


def open_patched(path: str = "") -> Backend:
    """Return the simulator that a file describes.

    Raises:
        UsageError: the file is missing or is not one of these, or the simulator lacks an effect.
    """
    if not path:
        raise UsageError(
            "the patched backend needs a file: --sim patched:FILE, as s2r diagnose --apply wrote it"
        )
    try:
        read = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror or error}") from None
    except ValueError as error:
        raise UsageError(f"{path} is not JSON: {error}") from None
    if not (
        isinstance(read, dict) and read.get("schema") == SCHEMA and isinstance(read.get("effects"), dict)
    ):
        raise UsageError(
            f'{path} is no patched simulator: it needs "schema": "{SCHEMA}", "base" and "effects"'
        )
    backend = load_backend(str(read.get("base")))
    if not read["effects"]:
        return backend
    if not isinstance(backend, HasEffects):
        raise UsageError(f"{path}: the backend {backend.name!r} declares no effects")
    return backend.with_effects(read["effects"])
