"""The table of all sealed sets in HISTORY.md, from the scores in results/.

    python benchmarks/blind/table.py            # prints it
    python benchmarks/blind/table.py --write    # puts it in its place; a test holds the page to it

Answers and closed gaps are counted from the cases, so that old sets are scored as new ones.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"
HISTORY = Path(__file__).parent / "HISTORY.md"
SETS = {
    "the axis": (*(f"emps{n}" for n in range(1, 22)), "emps"),
    "the A1": (
        *(
            f"a1{n}"
            for n in ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth")
        ),
        *(
            f"a1{n}"
            for n in ("tenth", "eleventh", "twelfth", "thirteenth", "fourteenth", "fifteenth", "sixteenth")
        ),
        "a1seventeenth",
        "a1eighteenth",
        "a1nineteenth",
        "a1twentieth",
        "a1",
    ),
    "the arm": (*(f"arm{n}" for n in range(1, 9)), "arm"),
    "the quadrotor": (*(f"quad{n}" for n in range(1, 8)), "quad"),
    "the car": ("car1", "car2", "car"),
    "the balancing robot": ("segway1", "segway2", "segway"),
}
"""Machine → names of its sealed sets in results/, in the order in which they were opened."""
RATES = {
    "single effects: ranked first": "top-1, single effects",
    "among the first two answers": "top-2, single effects",
    "most probable effect": "most probable member, single",
    "in the set of the answer": "in the answered set, single",
    "visible single effects: ranked first": "that moves ρ or is isolable at its size: first answer right, single",
    "visible, most probable effect": "that moves ρ or is isolable at its size: likeliest effects right, single",
    "pairs: ranked first": "exact pair first",
    "most probable effect is one of the pair": "one of the pair first",
    "unknown causes with a material gap: detected": "unknown with a material gap detected",
    "known causes: called *none of these*": "known effects called unknown",
    "nothing wrong: called something else": "null called anything else",
    "answers of 0.9 and more: right": "right where sure",
    "true values of named single effects: in the 90 % interval": "true value in its 90 % interval",
}
"""Row → rate in the scores; older sets lack some of them."""


def answered(cases: list[dict[str, Any]]) -> str:
    """Return of how many single effects the answer is the effect, and no other word."""
    single = [case for case in cases if case["label"]["kind"] == "single"]
    hits = sum(set(case["answer"]) == set(case["label"]["effects"]) for case in single)
    return f"{hits} of {len(single)}"


def closed(cases: list[dict[str, Any]], which: str) -> str:
    """Return the part of material held-out gaps above their floor that is closed: nothing, where nothing is named."""
    single = [case for case in cases if case["label"]["kind"] == "single" and case["how_far"]]
    far = [(case["answer"], case["how_far"]) for case in single if case["how_far"]["material"]]
    if which == "tuned" and not all(f.get("tuned") for _, f in far):
        return ""
    above = sum(f["before"]["mean"] - f["floor"] for _, f in far)
    left = [
        (f[which] if f.get(which) and (answer or which == "tuned") else f["before"], f) for answer, f in far
    ]
    return f"{100 * sum(f['before']['mean'] - after['mean'] for after, f in left) / above:.0f} %"


def _of(rate: dict[str, Any] | None) -> str:
    return "" if rate is None else f"{rate['hits']} of {rate['of']}"


def _rows(name: str) -> dict[str, str]:
    """Return what is said of a sealed set, by row."""
    kept = json.loads((RESULTS / f"{name}_scores.json").read_text())
    scores, cases = kept["scores"], list(kept["cases"].values())
    return {
        "cases": str(scores["cases"]),
        **{words: _of(scores.get(key)) for words, key in RATES.items()},
        "single effects: the answer is exactly right": answered(cases),
        "single effects: material held-out gap closed": closed(cases, "after"),
        "the same, tuned": closed(cases, "tuned"),
    }


def markdown(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of cells, the first of them the head, as a table in Markdown."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (rows[0], ["---"] * len(rows[0]), *rows[1:]))


def history() -> str:
    """Return all sealed sets of all machines, one under the other, as Markdown."""
    said = [
        (f"{machine}, {number} (`{name}`)", _rows(name))
        for machine, names in SETS.items()
        for number, name in enumerate(names, 1)
    ]
    return markdown([["set", *said[0][1]], *([who, *one.values()] for who, one in said)])


def put(page: Path, made: str) -> None:
    """Write a table over that of the page whose head begins with the same cell."""
    text = page.read_text(encoding="utf-8")
    begin = text.index(made.splitlines()[0].split(" | ")[0] + " | ")
    page.write_text(text[:begin] + made + text[text.index("\n\n", begin) :], encoding="utf-8")


def main() -> None:
    """Print the table, and write it if asked."""
    made = history()
    print(made)
    if "--write" in sys.argv:
        put(HISTORY, made)


if __name__ == "__main__":
    main()
