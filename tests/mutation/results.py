"""Keeps which mutants were tried and survived, and prints them with what was judged of them."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results" / "mutation.json"
TABLE = RESULTS.with_suffix(".txt")
JUDGED = Path(__file__).with_name("judged.toml")

Row = dict[str, Any]


@dataclass(frozen=True)
class Score:
    """What became of the mutants of a module: how many there are, were tried and were killed, and who survived."""

    mutants: int
    tried: int
    killed: int
    survivors: tuple[Row, ...]


def score(mutants: int, rows: list[Row]) -> Score:
    """Return the score of a module from the rows of its mutants."""
    left = tuple(row for row in rows if row["result"] in ("survived", "unreached"))
    kept = tuple({key: row[key] for key in ("line", "operator", "was", "now", "result")} for row in left)
    return Score(mutants, len(rows), len(rows) - len(left), kept)


def scores(rows: list[Row], before: Row | None) -> Row:
    """Return the scores by module from the rows of workers.

    Args:
        rows: one with the number of mutants for each module, and one for each mutant that was tried.
        before: the scores by module that are kept, where only their survivors were tried again.
    """
    found: Row = {}
    for head in (row for row in rows if "mutants" in row):
        module = head["module"]
        own = [row for row in rows if row.get("module") == module and "result" in row]
        own.sort(key=lambda row: (row["line"], row["now"]))
        new = score(head["mutants"], own)
        if before is not None:
            old, left = before[module], new.survivors
            new = Score(old["mutants"], old["tried"], old["tried"] - len(left), left)
        if own:
            found[module] = vars(new)
    return found


def joined(old: Row | None, new: Row) -> Row:
    """Return the score of a module from two runs on different lines of it, the earlier lines first."""
    if old is None:
        return new
    left = (*old["survivors"], *new["survivors"])
    return vars(Score(new["mutants"], old["tried"] + new["tried"], old["killed"] + new["killed"], left))


def not_judged(modules: Row) -> list[Row]:
    """Return the survivors of which nothing was judged."""
    known = judged()
    return [
        row
        for module, one in modules.items()
        for row in one["survivors"]
        if (module, row["was"], row["now"]) not in known
    ]


def read() -> dict[str, Any]:
    """Return the results that are kept, by module."""
    return json.loads(RESULTS.read_text()) if RESULTS.exists() else {}


def judged() -> dict[tuple[str, str, str], str]:
    """Return (module, line, line with the fault) → why no test need catch it."""
    found = tomllib.loads(JUDGED.read_text())["judged"] if JUDGED.exists() else []
    return {(one["module"], one["was"], one["now"]): one["because"] for one in found}


def table(kept: dict[str, Any]) -> str:
    """Return the scores by folder and module, and the survivors, each with what was judged of it."""
    reasons = judged()
    lines = ["mutants   tried  killed  survived  of these judged  module"]
    survivors, whole = [], [0] * 5
    for module, one in sorted(kept["modules"].items()):
        left = one["survivors"]
        known = sum((module, row["was"], row["now"]) in reasons for row in left)
        figures = [one["mutants"], one["tried"], one["killed"], len(left), known]
        whole = [a + b for a, b in zip(whole, figures, strict=True)]
        lines.append(_line(figures, module))
        for row in left:
            why = reasons.get((module, row["was"], row["now"]), "NOT JUDGED")
            note = " (no test runs this line)" if row["result"] == "unreached" else ""
            survivors += [
                f"{module}:{row['line']}{note}",
                f"  - {row['was']}",
                f"  + {row['now']}",
                f"  {why}",
                "",
            ]
    lines += [_line(whole, "all"), "", "survivors", "", *survivors]
    return "\n".join([*kept["about"], "", *lines]).rstrip() + "\n"


def _line(figures: list[int], name: str) -> str:
    mutants, tried, killed, survived, known = figures
    return f"{mutants:7} {tried:7} {killed:7} {survived:9} {known:16}  {name}"
