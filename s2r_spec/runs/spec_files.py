"""The specification's files in a run's folder: how they are written, read and checked for changes.

    spec.stl          the specification, unchanged
    imports.json      name of the specification, and import → file and SHA-256; only if it imports anything
    imports/0.stl     text of the first import, …

Files of imports have numbers instead of names. A name such as ``journal.jsonl`` would break the run, and a path above
the specification's folder would lie outside it.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from s2r_spec.base.errors import one_of
from s2r_spec.lang.files import read_text
from s2r_spec.recordings.reading_rule import KEY, READING
from s2r_spec.runs.journal import Journal, Record
from s2r_spec.runs.layout import SYSTEMS
from s2r_spec.runs.lines import COUNT, TEXT, JournalError, damage, fault, is_count, is_length, is_text
from s2r_spec.runs.machine_journal import AGAIN, FALL
from s2r_spec.runs.stop_rule import STOPS, stop_of
from s2r_spec.spec import CertifySettings, Spec, load_spec, parse_spec
from s2r_spec.spec.declared import hash_of

SPEC_FILE = "spec.stl"
IMPORTS_FILE = "imports.json"
IMPORTS = "imports"
SCHEMA = "s2r.imports/1"
PILOT = "pilot"
"""Definition: field of the header of a pilot's journal, which has no settings."""

_HEADER = {
    **dict.fromkeys(("s2r", "spec", "spec_hash", "requirement", "backend"), TEXT),
    "duration": (is_length, "a number of seconds"),
    "seed": COUNT,
    "settings": (lambda value: isinstance(value, dict), "an object"),
}
_SYSTEM = {"backend": TEXT, "model_hash": TEXT}


def spec_texts(spec: Spec) -> dict[str, str]:
    """Return file → text of all files of a specification in a run's folder."""
    if not spec.imported:
        return {SPEC_FILE: spec.text}
    imports = {
        name: {"file": f"{IMPORTS}/{number}.stl", "sha256": _sha256(text)}
        for number, (name, text) in enumerate(spec.imported.items())
    }
    table = {"schema": SCHEMA, "spec": spec.name, "files": imports}
    return {
        SPEC_FILE: spec.text,
        IMPORTS_FILE: json.dumps(table, indent=2) + "\n",
        **{imports[name]["file"]: text for name, text in spec.imported.items()},
    }


def open_journal(folder: Path, header: Mapping[str, Any], spec: Spec, resume: bool) -> Journal:
    """Resume the journal of a run that has begun, or create one with the specification beside it."""
    if resume and Journal.begun(folder):
        return Journal.resume(folder, header)
    return Journal.create(folder, header, spec_texts(spec))


def load_run_spec(journal: Journal) -> Spec:
    """Return the specification of a run, read only from the run's folder.

    A file that is missing, or was changed after the run began, is a UsageError.
    """
    header, path = checked_header(journal), journal.folder / SPEC_FILE
    if (path.parent / IMPORTS_FILE).exists():
        spec = _with_imports(path, header["spec_hash"])
    else:
        spec = load_spec(path)
        if spec.hash != header["spec_hash"]:
            raise _changed_error(path)
    if header["requirement"] not in spec.requirements:
        raise JournalError(
            f"{journal.path}:1: requirement is {header['requirement']!r}, and {path} has no such requirement; "
            f"restore both from a copy, or begin a new run"
        )
    for record in journal.records():
        _check_test(spec, journal, record)
    if PILOT in header:
        return with_fall(spec, header["requirement"], float(header[PILOT]["fall"]))
    return spec


def with_fall(spec: Spec, requirement: str, fall: float) -> Spec:
    """Return a specification with ρ of a failed rollout for a requirement that declares none."""
    declared = spec.certify.get(requirement, CertifySettings())
    return replace(spec, certify={**spec.certify, requirement: declared.over(CertifySettings(fall=fall))})


def checked_header(journal: Journal) -> dict[str, Any]:
    """Return the header of a journal after a check of its fields; a wrong one is a JournalError."""
    header = journal.header
    if "measure" in header:
        raise JournalError(
            f"{journal.folder} is a run of the measure {header['measure']!r}, which check_measure began in Python; "
            f"call check_measure again with resume=True for its certificate"
        )
    if PILOT in header:
        wrong = fault(header, {key: rule for key, rule in _HEADER.items() if key != "settings"})
        about = header[PILOT]
        if not wrong and not (isinstance(about, dict) and isinstance(about.get("fall"), float | int)):
            wrong = f"{PILOT} must be an object with the number fall"
    else:
        wrong = fault(header, _HEADER) or fault(header["settings"], {"mode": TEXT, "engine": TEXT})
    if not wrong and "side" in header:
        wrong = "" if header["side"] in SYSTEMS else "side must be sim or real"
        if not wrong and header.get("simulated_per_real") not in (1, 2):
            wrong = "simulated_per_real must be 1 or 2"
        for side in SYSTEMS:
            about = header.get(side)
            of_side = fault(about, _SYSTEM) if isinstance(about, dict) else f"{side} must be an object"
            wrong = wrong or of_side
    elif not wrong:
        wrong = fault(header, {"model_hash": TEXT})
    systems = [about for side in SYSTEMS if isinstance(about := header.get(side), dict)]
    for name, objects in [("recorded", [header]), ("assumptions", [header, *systems])]:
        for notes in (one.get(name, []) for one in objects):
            if not wrong and not (isinstance(notes, list) and all(map(is_text, notes))):
                wrong = f"{name} must be a list of texts"
    if not wrong and any(one.get("void", AGAIN) not in (AGAIN, FALL) for one in [header, *systems]):
        wrong = f"void must be {AGAIN} or {FALL}"
    if not wrong and not all(is_count(one.get(KEY, READING)) for one in [header, *systems]):
        wrong = f"{KEY} must be a whole number"
    if not wrong and stop_of(header) not in STOPS:
        wrong = f"stop must be one of {one_of(STOPS)}"
    if wrong:
        raise damage(journal.path, 1, wrong)
    return header


def _check_test(spec: Spec, journal: Journal, record: Record) -> None:
    file, line = journal.path, journal.line(record)
    if record.params.keys() != set(spec.space.names):
        names, declared = (", ".join(each) or "none" for each in (record.params, spec.space.names))
        raise damage(file, line, f"params are {names}, but the specification has {declared}")
    for axis in spec.space.axes:
        value = record.params[axis.name]
        if not axis.low <= value <= axis.high:
            words = f"{axis.name} = {value:g} {axis.unit}".rstrip()
            outside = f"is outside the range [{axis.low:g}, {axis.high:g}] of the specification"
            raise damage(file, line, f"{words} {outside}")


def _with_imports(path: Path, expected: str) -> Spec:
    name, imports = _read_imports(path.parent / IMPORTS_FILE)
    text = _with_line_feeds(read_text(path))
    stored = {}
    for key, (file, digest) in imports.items():
        stored[key] = _with_line_feeds(read_text(path.parent / file))
        if _sha256(stored[key]) != digest:
            raise _changed_error(path.parent / file)
    if hash_of(text, stored.values()) != expected:
        raise _changed_error(path)
    return replace(parse_spec(text, name, imports=stored), name=str(path))


def _read_imports(path: Path) -> tuple[str, dict[str, tuple[str, str]]]:
    try:
        table = json.loads(read_text(path))
        files = {str(key): (str(one["file"]), str(one["sha256"])) for key, one in table["files"].items()}
        name = str(table["spec"])
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError):
        raise JournalError(
            f"{path} is not a list of imports; restore it from a copy, or begin a new run"
        ) from None
    if any(not re.fullmatch(rf"{IMPORTS}/[0-9]+\.stl", file) for file, _ in files.values()):
        raise JournalError(
            f"{path} lists a file outside {IMPORTS}/; restore {path} from a copy, or begin a new run"
        )
    return name, files


def _changed_error(path: Path) -> JournalError:
    return JournalError(
        f"{path} was changed after the run began: the journal has another hash; restore it from a copy, or begin a "
        f"new run"
    )


def _with_line_feeds(text: str) -> str:
    """Return a text with line feeds as its only line breaks, the form that is hashed."""
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
