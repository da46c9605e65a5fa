"""Hashes of a commitment: of a folder, and of a label with its salt."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from s2r_spec.base.files import save
from s2r_spec.errors import UsageError


def of_folder(folder: Path) -> str:
    """Return the SHA-256 of a folder's files: names and bytes, in the order of the names."""
    digest = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(folder).as_posix()}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()


def of_label(label: Mapping[str, Any], data: str, salt: str) -> str:
    """Return the SHA-256 of a label together with its data's hash and a salt, as canonical JSON."""
    text = json.dumps(
        {"label": label, "data": data, "salt": salt}, sort_keys=True, separators=(",", ":"), allow_nan=False
    )
    return hashlib.sha256(text.encode()).hexdigest()


def read_json(path: Path) -> dict[str, Any]:
    """Read one JSON object.

    Raises:
        UsageError: the file is missing, or is not a JSON object.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror or error}") from None
    except ValueError as error:
        raise UsageError(f"{path} is not JSON: {error}") from None
    if not isinstance(found, dict):
        raise UsageError(f"{path} holds no JSON object")
    return found


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write one JSON object, either completely or not at all.

    Raises:
        UsageError: it cannot be written.
    """
    save(path, json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n")
