"""What a run keeps of its specification, and whether it is still that.

    spec.stl          the specification, as it was read
    imports.json      its own name, and name → file and SHA-256 of what it imports; if it imports anything
    imports/0.stl     …

Imports lie under numbers, not under their names: a file called ``journal.jsonl``, or one above the
specification's folder, would break the run or leave it. Runs of before have each import under its own name.
"""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from s2r_spec.lang.files import read_text
from s2r_spec.rollouts.attempts import AGAIN, FALL
from s2r_spec.rollouts.journal import Journal, Record
from s2r_spec.rollouts.layout import SIDES
from s2r_spec.rollouts.lines import (
    JournalError,
    fault,
    is_count,
    is_length,
    is_text,
)
from s2r_spec.spec import Spec, load_spec, parse_spec
from s2r_spec.spec.declared import hash_of

SPEC_FILE = "spec.stl"
IMPORTS_FILE = "imports.json"
IMPORTS = "imports"
SCHEMA = "s2r.imports/1"

_HEADER = {
    "s2r": (is_text, "a text"),
    "spec": (is_text, "a text"),
    "spec_hash": (is_text, "a text"),
    "requirement": (is_text, "a text"),
    "backend": (is_text, "a text"),
    "duration": (is_length, "a number of seconds"),
    "seed": (is_count, "a whole number"),
    "settings": (lambda value: isinstance(value, dict), "an object"),
}
_SETTINGS = {"mode": (is_text, "a text"), "engine": (is_text, "a text")}
_SIDE = {"backend": (is_text, "a text"), "model_hash": (is_text, "a text")}


def files_of(spec: Spec) -> dict[str, str]:
    """Return name → text of the files that a run keeps of its specification."""
    if not spec.imported:
        return {SPEC_FILE: spec.text}
    listed = {
        name: {"file": f"{IMPORTS}/{number}.stl", "sha256": _sha256(text)}
        for number, (name, text) in enumerate(spec.imported.items())
    }
    names = {"schema": SCHEMA, "spec": spec.name, "files": listed}
    return {
        SPEC_FILE: spec.text,
        IMPORTS_FILE: json.dumps(names, indent=2) + "\n",
        **{listed[name]["file"]: text for name, text in spec.imported.items()},
    }


def load_kept(journal: Journal) -> Spec:
    """Return the specification of a run, from the run's folder alone.

    Raises:
        JournalError: the journal is not of a specification, or what is kept is not what the run was begun with.
        UsageError: a file is missing, or is no specification.
    """
    header, path = checked_header(journal), journal.folder / SPEC_FILE
    if (path.parent / IMPORTS_FILE).exists():
        spec = _with_imports(path, header["spec_hash"])
    else:
        spec = load_spec(path)
        if spec.hash != header["spec_hash"]:
            raise _changed(path)
    if header["requirement"] not in spec.requirements:
        raise JournalError(f"{journal.path}:1: {path} has no requirement {header['requirement']!r}")
    for record in journal.records():
        _in_space(spec, journal, record)
    return spec


def checked_header(journal: Journal) -> dict[str, Any]:
    """Return the header of a journal, each field of the type that it must have.

    Raises:
        JournalError: a field is missing or of another type, or the run is of a measure and not of a specification.
    """
    header = journal.header
    if "measure" in header:
        raise JournalError(
            f"{journal.folder} is a run of the measure {header['measure']!r}, begun from Python with check_measure: "
            f"call it again with resume=True for its certificate"
        )
    wrong = fault(header, _HEADER) or fault(header["settings"], _SETTINGS)
    if not wrong and "side" in header:
        wrong = "" if header["side"] in SIDES else "side must be sim or real"
        if not wrong and header.get("simulated_per_real") not in (1, 2):
            wrong = "simulated_per_real must be 1 or 2"
        for side in SIDES:
            about = header.get(side)
            wrong = wrong or (fault(about, _SIDE) if isinstance(about, dict) else f"{side} must be an object")
    elif not wrong:
        wrong = fault(header, {"model_hash": (is_text, "a text")})
    sides = [about for side in SIDES if isinstance(about := header.get(side), dict)]
    for name, found in [("recorded", [header]), ("assumptions", [header, *sides])]:
        for notes in (one.get(name, []) for one in found):
            if not wrong and not (isinstance(notes, list) and all(map(is_text, notes))):
                wrong = f"{name} must be a list of texts"
    if not wrong and any(one.get("void", AGAIN) not in (AGAIN, FALL) for one in [header, *sides]):
        wrong = f"void must be {AGAIN} or {FALL}"
    if wrong:
        raise JournalError(f"{journal.path}:1: {wrong}; restore the journal from a copy, or begin a new run")
    return header


def _in_space(spec: Spec, journal: Journal, record: Record) -> None:
    """See that a rollout is of a test of the specification.

    Raises:
        JournalError: it is of other parameters, or outside of a range.
    """
    axes, more = spec.space.axes, "restore the journal from a copy, or begin a new run"
    if record.params.keys() != set(spec.space.names):
        raise JournalError(
            f"{journal.place(record)}: the parameters are {', '.join(record.params) or 'none'}, but the "
            f"specification has {', '.join(spec.space.names) or 'none'}; {more}"
        )
    for axis in axes:
        value = record.params[axis.name]
        if not axis.low <= value <= axis.high:
            raise JournalError(
                f"{journal.place(record)}: {axis.name} = {value:g} {axis.unit}".rstrip()
                + f" is outside the range [{axis.low:g}, {axis.high:g}] of the specification; {more}"
            )


def _with_imports(path: Path, expected: str) -> Spec:
    """Return a specification whose imports are stored beside it.

    Raises:
        JournalError: the list of them is damaged, or a file is not what the hash is of.
        UsageError: one of them cannot be read.
    """
    name, listed = _listed(path.parent / IMPORTS_FILE)
    text = _plain(read_text(path))
    stored = {}
    for key, (file, digest) in listed.items():
        stored[key] = _plain(read_text(path.parent / file))
        if _sha256(stored[key]) != digest:
            raise _changed(path.parent / file)
    if hash_of(text, stored.values()) != expected:
        raise _changed(path)
    return replace(parse_spec(text, name, imports=stored), name=str(path))


def _listed(path: Path) -> tuple[str, dict[str, tuple[str, str]]]:
    """Return the name that a specification goes by, and name → (file, SHA-256) of each import."""
    try:
        found = json.loads(read_text(path))
        files = {str(key): (str(one["file"]), str(one["sha256"])) for key, one in found["files"].items()}
        name = str(found["spec"])
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError):
        raise JournalError(
            f"{path}: this is not a list of imports; restore it from a copy, or begin a new run"
        ) from None
    if any(not re.fullmatch(rf"{IMPORTS}/[0-9]+\.stl", file) for file, _ in files.values()):
        raise JournalError(
            f"{path}: it lists a file that is not in {IMPORTS}/; restore it from a copy, or begin a new run"
        )
    return name, files


def _changed(path: Path) -> JournalError:
    return JournalError(
        f"{path} was changed after the run was begun: the journal has another hash; restore it from a "
        f"copy, or begin a new run"
    )


def _plain(text: str) -> str:
    """Return a text with line feeds alone, as the hash is taken of it."""
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
