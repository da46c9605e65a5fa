"""Open a sealed set: once, and only against frozen answers."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.blind.protocol.freeze import MANIFEST, check
from benchmarks.blind.protocol.hashes import of_label, read_json, write_json
from s2r_spec.errors import UsageError

OPENED = "opened.json"


def unseal(public: Path, keys: Path, answers: Path) -> dict[str, Any]:
    """Check manifest and commitments, and return id → label; also kept as ``opened.json`` beside the answers.

    Raises:
        UsageError: the set was opened before, or a file was changed after it was sealed or frozen.
    """
    opened = answers / OPENED
    if opened.exists():
        raise UsageError(f"{opened} exists: this set was opened before; a set can be opened only once")
    manifest = check(public, answers)
    labels = {}
    for name, commitment in manifest["commitments"].items():
        key = read_json(keys / f"{name}.json")
        if of_label(key["label"], manifest["data"][name], str(key["salt"])) != commitment:
            raise UsageError(f"{keys / name}.json is not the label that {public / name}.commit commits to")
        labels[name] = key["label"]
    write_json(
        opened,
        {
            "schema": "s2r/blind-opened/1",
            "opened": datetime.now(UTC).isoformat(timespec="seconds"),
            "frozen": manifest["frozen"],
            "manifest": MANIFEST,
            "labels": labels,
        },
    )
    return labels
