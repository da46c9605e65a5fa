"""The tables of sealed sets in docs/explanation/diagnosis.md and HISTORY.md, from the scores in results/.

    python benchmarks/blind/table.py            # prints them
    python benchmarks/blind/table.py --write    # puts them in their places; a test holds the pages to them

Answers and closed gaps are counted from the cases, so that old sets are scored as new ones.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from s2r_spec.backend import load_backend
from s2r_spec.blind.score import truth
from s2r_spec.diagnose.axes import lines
from s2r_spec.effects import catalogue_of

RESULTS = Path(__file__).parent / "results"
PAGE = Path(__file__).parents[2] / "docs" / "explanation" / "diagnosis.md"
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
LATEST = (
    *("emps21", "a1twentieth", "arm8", "quad7", "car2", "segway2"),
    *("emps", "a1", "arm", "quad", "car", "segway"),
)
"""Sets of which is said how often probabilities come true: those of today's weights."""
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
GOALS = {
    "among the first two answers": "97 %; -",
    "in the set of the answer": "-; 99 %",
    "visible single effects: ranked first": "92 %; 97 %",
    "pairs: ranked first": "75 %; 90 %",
    "unknown causes with a material gap: detected": "90 %; 95 %",
    "known causes: called *none of these*": "5 % at most",
    "nothing wrong: called something else": "2 % at most",
    "answers of 0.9 and more: right": "99 %; -",
    "single effects: material held-out gap closed": "90 %",
}
"""Row → goal for the A1 and for the axis."""
LARGEST = "a1sixteenth"
"""The largest of the A1's sets."""
EDGES = (0.0, 0.4, 0.6, 0.8, 0.9, 1.0)
SIZES = (0.0, 0.2, 0.35, 0.5, float("inf"))
"""Between which an A1's smallest effect is counted together, in units of its typical size."""
UNASKED = frozenset({"ground_friction", "roughness", "torque_speed_line"})
"""Effects of the A1 for which its equations of motion did not ask then: nothing but the closed loop showed them."""


def first(case: dict[str, Any]) -> tuple[frozenset[str], float]:
    """Return the likeliest answer of a case, and its probability."""
    found = [(frozenset([name]), float(p)) for name, p in case["posterior"].items()]
    found += [(frozenset(pair["effects"]), float(pair["probability"])) for pair in case["pairs"]]
    return max(found, key=lambda item: item[1])


def reliability() -> str:
    """Return as Markdown how often the likeliest answer is the truth, by the probability that it was given."""
    rows = [["probability of the most probable answer", "cases", "mean probability", "right"]]
    cases = [
        case
        for name in LATEST
        for case in json.loads((RESULTS / f"{name}_scores.json").read_text())["cases"].values()
    ]
    said = [(*first(case), truth(case["label"])) for case in cases]
    for low, high in pairwise(EDGES):
        mine = [(found == true, p) for found, p, true in said if low <= p < high or p == high == EDGES[-1]]
        mean = sum(p for _, p in mine) / max(len(mine), 1)
        right = sum(hit for hit, _ in mine)
        rows.append(
            [f"{low:g} to {high:g}", str(len(mine)), f"{mean:.2f}", f"{right / max(len(mine), 1):.2f}"]
        )
    return markdown(rows)


def by_size() -> str:
    """Return as Markdown how often the likeliest set is the A1's, by the size of the smallest of its effects.

    The size of an effect is the largest coordinate of its parameters.
    """
    known = {line.name: line for line in lines(catalogue_of(load_backend("sim")))}
    found = json.loads((RESULTS / f"{LARGEST}_scores.json").read_text())["cases"].values()
    kinds = ("single", "pair")
    said = []
    for case in found:
        effects = case["label"]["effects"]
        sizes = [
            max(abs(known[f"{effect}.{name}"].coordinate(value)) for name, value in values.items())
            for effect, values in effects.items()
            if case["label"]["kind"] in kinds
        ]
        if sizes:
            right = first(case)[0] == truth(case["label"])
            said.append((case["label"]["kind"], min(sizes), bool(UNASKED & set(effects)), right))

    def row(words: str, low: float, high: float, unasked: bool) -> list[str]:
        of = [
            [
                right
                for k, size, hidden, right in said
                if k == kind and hidden is unasked and low <= size < high
            ]
            for kind in kinds
        ]
        return [words, *(f"{sum(mine)} of {len(mine)}" for mine in of)]

    rows = [["smallest effect, in parts of its typical size", "single effects", "pairs"]]
    for low, high in pairwise(SIZES):
        rows.append(row(f"{low:g} {'and more' if high == SIZES[-1] else f'to {high:g}'}", low, high, False))
    rows.append(
        row(f"any size: {', '.join(sorted(UNASKED))}, alone or with another", SIZES[0], SIZES[-1], True)
    )
    return markdown(rows)


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


def table() -> str:
    """Return the newest sealed set of every machine and the A1's largest beside what we want, as Markdown."""
    newest = {machine: names[-1] for machine, names in SETS.items()}
    before = {"the A1, set before": SETS["the A1"][-2], "the A1, largest set": LARGEST}
    said = [_rows(name) for name in (*newest.values(), *before.values())]
    head = ["newest sealed set", *newest, *before, "goal (A1; axis)"]
    return markdown(
        [head, *([row, *(one[row] for one in said), GOALS.get(row, "")] for row in said[0])],
    )


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
    """Print the tables, and write them if asked."""
    for page, made in ((PAGE, table()), (PAGE, reliability()), (PAGE, by_size()), (HISTORY, history())):
        print(made, end="\n\n")
        if "--write" in sys.argv:
            put(page, made)


if __name__ == "__main__":
    main()
