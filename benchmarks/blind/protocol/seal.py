"""Seal labels: commit to them beside the data, and take them away.

public/<id>/         traces, rollouts.csv and spec.stl; what the diagnosis may see
public/<id>.commit   SHA-256 of label, data and salt
keys/<id>.json       label and salt: kept elsewhere until the answers are frozen
"""

from __future__ import annotations

import secrets
from pathlib import Path

from benchmarks.blind.protocol.hashes import of_folder, of_label, read_json, write_json
from s2r_spec.base.files import save
from s2r_spec.errors import UsageError


def cases(public: Path) -> list[str]:
    """Return the ids of a set, sorted.

    Raises:
        UsageError: there is no case.
    """
    found = sorted(path.name for path in public.iterdir() if path.is_dir()) if public.is_dir() else []
    if not found:
        raise UsageError(
            f"{public} holds no case: each is a folder of rollouts in the form that log:FOLDER reads"
        )
    return found


def seal(public: Path, labels: Path, keys: Path) -> int:
    """Commit to every label in ``labels`` and move it, with its salt, to ``keys``; return the number of labels.

    Raises:
        UsageError: a case has no label, a label has no case, a case is sealed already, or ``keys`` already has
            a label of that name.
    """
    ids = cases(public)
    named = sorted(path.stem for path in labels.glob("*.json"))
    if ids != named:
        odd = sorted(set(ids) ^ set(named))[0]
        raise UsageError(
            f"{odd!r} has a {'label but no data' if odd in named else 'folder but no label'}; seal a complete set"
        )
    for name in ids:
        if (public / f"{name}.commit").exists():
            raise UsageError(f"{public / name}.commit exists: the set is sealed already")
        if (keys / f"{name}.json").exists():
            raise UsageError(
                f"{keys / name}.json is the label of another set; use another folder for this set"
            )
    keys.mkdir(parents=True, exist_ok=True)
    for name in ids:
        label, salt = read_json(labels / f"{name}.json"), secrets.token_hex(32)
        commitment = of_label(label, of_folder(public / name), salt)
        write_json(keys / f"{name}.json", {"label": label, "salt": salt})
        save(public / f"{name}.commit", commitment + "\n")
    for name in ids:
        (labels / f"{name}.json").unlink()
    return len(ids)
