"""Freeze answers: one JSON file for each case, and a manifest of answers, data, commitments and code."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import s2r_spec
from benchmarks.blind.protocol.hashes import of_folder, read_json, write_json
from benchmarks.blind.protocol.seal import cases
from s2r_spec.base.files import save
from s2r_spec.errors import UsageError

MANIFEST = "manifest.json"
BEGUN = "code.sha256"
"""Name of a file beside the answers: it holds the hash of the code that began them."""

Diagnose = Callable[[Path], Mapping[str, Any]]
"""A function from the folder of a case to its answer."""


def freeze(
    public: Path,
    answers: Path,
    diagnose: Diagnose,
    progress: Callable[[str, int, int], None] | None = None,
    simulator: str = "",
) -> str:
    """Diagnose every case and write the manifest; return its hash. Existing answers are kept.

    The hash of the code is written before the first answer, so that a resumed run uses the same code.

    Args:
        public: folder with one folder of rollouts for each case.
        answers: folder of the answers.
        diagnose: returns the answer of a case.
        progress: called after each case with its name, the number of finished cases, and the number of all cases.
        simulator: hash of the simulator's source, since its residuals are part of a diagnosis.

    Raises:
        UsageError: the answers are frozen already, a case is not sealed, or other code began the answers.
    """
    manifest = answers / MANIFEST
    if manifest.exists():
        raise UsageError(f"{manifest} exists: these answers are frozen; a new version needs a new set")
    ids = cases(public)
    for name in ids:
        if not (public / f"{name}.commit").exists():
            raise UsageError(
                f"{public / name} is not sealed; run python -m benchmarks.blind.protocol seal first"
            )
    answers.mkdir(parents=True, exist_ok=True)
    code = _begun(answers, simulator)
    for number, name in enumerate(ids):
        path = answers / f"{name}.json"
        if not path.exists():
            write_json(path, diagnose(public / name))
        if progress is not None:
            progress(name, number + 1, len(ids))
    if code_hash(simulator) != code:
        raise UsageError(
            f"s2r's source changed while it answered; start over in a new folder, not in {answers}"
        )
    write_json(
        manifest,
        {
            "schema": "s2r/blind-manifest/1",
            "frozen": datetime.now(UTC).isoformat(timespec="seconds"),
            "code": code,
            "answers": {name: _digest(answers / f"{name}.json") for name in ids},
            "data": {name: of_folder(public / name) for name in ids},
            "commitments": {name: (public / f"{name}.commit").read_text().strip() for name in ids},
        },
    )
    return _digest(manifest)


def _begun(answers: Path, simulator: str) -> str:
    """Return the hash of the code that answers, and write it to the folder of the answers.

    Raises:
        UsageError: other code began the answers, or there are answers without the hash of their code.
    """
    note, code = answers / BEGUN, code_hash(simulator)
    if not note.exists():
        if any(answers.glob("*.json")):
            raise UsageError(
                f"{answers} holds answers, but no {BEGUN} with the hash of their code; use another folder"
            )
        save(note, code + "\n")
    elif note.read_text().strip() != code:
        raise UsageError(
            f"the answers in {answers} come from another version of the code ({note}); continue with that version, "
            f"or begin again in another folder"
        )
    return code


def check(public: Path, answers: Path) -> dict[str, Any]:
    """Return the manifest, after a check of answers, data and commitments against it.

    Raises:
        UsageError: something has changed since the answers were frozen; the message names it.
    """
    manifest = read_json(answers / MANIFEST)
    ids = cases(public)
    if sorted(manifest["answers"]) != ids:
        raise UsageError(f"{public} does not hold the cases that were frozen in {answers / MANIFEST}")
    for name in ids:
        if _digest(answers / f"{name}.json") != manifest["answers"][name]:
            raise UsageError(f"{answers / name}.json is not the answer that was frozen")
        if of_folder(public / name) != manifest["data"][name]:
            raise UsageError(f"{public / name} is not the data that was frozen")
        if (public / f"{name}.commit").read_text().strip() != manifest["commitments"][name]:
            raise UsageError(f"{public / name}.commit is not the commitment that was frozen")
    return manifest


def code_hash(simulator: str = "") -> str:
    """Return one hash of s2r's own source and the hash of the simulator's source."""
    root = Path(s2r_spec.__file__).parent
    digest = hashlib.sha256(simulator.encode())
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root).as_posix()}\0".encode() + path.read_bytes())
    return digest.hexdigest()


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror or error}") from None
