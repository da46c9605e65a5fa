"""Pages that do not keep the limits yet, with the most that each may have; a page that is not listed keeps them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from tests.prose.sentences import MEAN, Measure

FILE = Path(__file__).with_name("not_done.json")


class Most(NamedTuple):
    """The most that a page may have: mean words per sentence, and sentences that are too long."""

    mean: float
    long: int


def kept() -> dict[str, Most]:
    """Return the list of pages that are not done."""
    return {name: Most(**values) for name, values in json.loads(FILE.read_text(encoding="utf-8")).items()}


def lowered(listed: Mapping[str, Most], found: Mapping[str, Measure]) -> dict[str, Most]:
    """Return the list with what has become better; a page that is done or gone leaves it, and none is added."""
    return {
        name: Most(min(most.mean, max(MEAN, _up(found[name].mean))), min(most.long, len(found[name].long)))
        for name, most in listed.items()
        if name in found and not found[name].done
    }


def worse(listed: Mapping[str, Most], found: Mapping[str, Measure]) -> list[str]:
    """Return one line for each page that does not keep its limits."""
    lines = []
    for name, page in found.items():
        most = listed.get(name, Most(MEAN, 0))
        if page.mean > most.mean or len(page.long) > most.long:
            lines.append(
                f"{name}: mean {page.mean:.1f} (at most {most.mean:g}), {len(page.long)} sentences over 25 words "
                f"(at most {most.long}); python -m tests.prose '{name}' lists them"
            )
    return lines


def write(listed: Mapping[str, Most]) -> None:
    """Write the list."""
    rows = {name: most._asdict() for name, most in sorted(listed.items())}
    lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(row)}" for name, row in rows.items())
    FILE.write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")


def _up(mean: float) -> float:
    return -(-mean * 10 // 1) / 10
