"""The tables of sealed sets in docs/explanation/diagnosis.md, from the scores in results/; a test holds it to them.

    python benchmarks/blind/table.py            # prints them, of all sets
    python benchmarks/blind/table.py --write    # puts them in the page's place, of the sets that are shown there

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
from s2r_spec.diagnose.bank import catalogue_of

RESULTS = Path(__file__).parent / "results"
PAGE = Path(__file__).parents[2] / "docs" / "explanation" / "diagnosis.md"
SETS = {
    "emps1": "of the axis, first",
    "emps2": "second",
    "emps3": "third",
    "emps4": "fourth",
    "emps5": "fifth",
    "emps6": "sixth",
    "emps7": "of the axis, seventh",
    "emps8": "eighth",
    "emps9": "ninth",
    "emps10": "tenth",
    "emps11": "eleventh",
    "emps12": "twelfth",
    "emps13": "thirteenth",
    "emps14": "fourteenth",
    "emps15": "of the axis, fifteenth",
    "emps16": "of the axis, sixteenth",
    "emps17": "of the axis, seventeenth",
    "emps": "eighteenth",
    "a1first": "of the A1, first",
    "a1second": "second",
    "a1third": "of the A1, third",
    "a1fourth": "fourth",
    "a1fifth": "fifth",
    "a1sixth": "of the A1, sixth",
    "a1seventh": "seventh",
    "a1eighth": "eighth",
    "a1ninth": "ninth",
    "a1tenth": "of the A1, tenth",
    "a1eleventh": "of the A1, eleventh",
    "a1twelfth": "of the A1, twelfth",
    "a1thirteenth": "of the A1, thirteenth",
    "a1fourteenth": "fourteenth",
    "a1fifteenth": "fifteenth",
    "a1": "sixteenth",
    "arm1": "of the arm, first",
    "arm2": "second",
    "arm3": "third",
    "arm4": "of the arm, fourth",
    "arm5": "of the arm, fifth",
    "arm": "sixth",
    "quad1": "of the quadrotor, first",
    "quad2": "of the quadrotor, second",
    "quad3": "of the quadrotor, third",
    "quad": "fourth",
}
SHOWN = (
    "emps17",
    "emps",
    "a1thirteenth",
    "a1fourteenth",
    "a1fifteenth",
    "a1",
    "arm5",
    "arm",
    "quad3",
    "quad",
)
"""Those on the page."""
RATES = {
    "single effects: it is the likeliest set": "top-1, single effects",
    "single effects: it is one of the two likeliest answers": "top-2, single effects",
    "single effects: it is the likeliest effect": "most probable member, single",
    "single effects: it is in the set answered (of mean size {})": "in the answered set, single",
    "exact pair is the likeliest set of effects": "exact pair first",
    "one of the pair is the likeliest effect": "one of the pair first",
    "known causes called *none of these*": "known effects called unknown",
    "unknown causes with a material gap that were seen as such": "unknown with a material gap detected",
    "machines with nothing wrong that were called something else": "null called anything else",
    "answers of 0.9 and more that were right": "right where sure",
    "true value in its 90 % interval": "true value in its 90 % interval",
    "single effects that move ρ or are isolable at their size: the likeliest set": (
        "that moves ρ or is isolable at its size: first answer right, single"
    ),
    "and the likeliest effect": "that moves ρ or is isolable at its size: likeliest effects right, single",
}
"""Row → rate; sets from before a rate was asked for have none."""


LATEST = ("emps17", "emps", "a1", "arm5", "arm", "quad3", "quad")
"""Sets of which is said how often probabilities come true."""
EDGES = (0.0, 0.4, 0.6, 0.8, 0.9, 1.0)
SIZES = (0.0, 0.2, 0.35, 0.5, float("inf"))
"""Between which an A1's smallest effect is counted together, in units of its typical size."""
UNASKED = frozenset({"ground_friction", "roughness", "torque_speed_line"})
"""Effects of the A1 for which its equations of motion cannot ask: nothing but the closed loop shows them."""


def first(case: dict[str, Any]) -> tuple[frozenset[str], float]:
    """Return the likeliest answer of a case, and its probability."""
    found = [(frozenset([name]), float(p)) for name, p in case["posterior"].items()]
    found += [(frozenset(pair["effects"]), float(pair["probability"])) for pair in case["pairs"]]
    return max(found, key=lambda item: item[1])


def reliability() -> str:
    """Return as Markdown how often the likeliest answer is the truth, by the probability that it was given."""
    rows = [["probability of the likeliest answer", "cases", "mean probability", "right"], ["---"] * 4]
    cases = [
        case
        for name in LATEST
        for case in json.loads((RESULTS / f"{name}_scores.json").read_text())["cases"].values()
    ]
    said = [(*first(case), truth(case["label"])) for case in cases]
    for low, high in pairwise(EDGES):
        mine = [(found == true, p) for found, p, true in said if low <= p < high]
        mean = sum(p for _, p in mine) / max(len(mine), 1)
        right = sum(hit for hit, _ in mine)
        rows.append(
            [f"{low:g} to {high:g}", str(len(mine)), f"{mean:.2f}", f"{right / max(len(mine), 1):.2f}"]
        )
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def by_size() -> str:
    """Return as Markdown how often the likeliest set is the A1's, by the size of the smallest of its effects.

    The size of an effect is the largest coordinate of its parameters.
    """
    known = {line.name: line for line in lines(catalogue_of(load_backend("sim")))}
    found = json.loads((RESULTS / "a1_scores.json").read_text())["cases"].values()
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

    rows = [["smallest effect, of its typical size", "single effects", "pairs"], ["---"] * 3]
    for low, high in pairwise(SIZES):
        rows.append(row(f"{low:g} {'and more' if high == SIZES[-1] else f'to {high:g}'}", low, high, False))
    rows.append(row(f"any: {', '.join(sorted(UNASKED))}, alone or with another", SIZES[0], SIZES[-1], True))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


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


def table(names: Sequence[str] = tuple(SETS)) -> str:
    """Return the table of these sets as Markdown."""
    kept = [json.loads((RESULTS / f"{name}_scores.json").read_text()) for name in names]
    scores: list[dict[str, Any]] = [one["scores"] for one in kept]
    cases = [list(one["cases"].values()) for one in kept]
    sizes = "; ".join(f"{s['set size, single (mean)']:.2f}" for s in scores)
    rows = [
        ["sealed set", *(SETS[name] for name in names)],
        ["---"] * (len(names) + 1),
        ["file in `benchmarks/blind/results/`", *(f"`{name}_scores.json`" for name in names)],
        ["cases", *(str(s["cases"]) for s in scores)],
        ["single effects: the answer is it", *(answered(some) for some in cases)],
        *([words.format(sizes), *(_of(s.get(key)) for s in scores)] for words, key in RATES.items()),
        [
            "held-out gap above its floor that the patch closed, single effects",
            *(closed(some, "after") for some in cases),
        ],
        ["the same, tuned", *(closed(some, "tuned") for some in cases)],
    ]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def main() -> None:
    """Print, and write if asked."""
    write = "--write" in sys.argv
    for made in (table(SHOWN if write else tuple(SETS)), reliability(), by_size()):
        print(made, end="\n\n")
        if write:
            text = PAGE.read_text(encoding="utf-8")
            begin = text.index(made.splitlines()[0].split(" | ")[0])
            PAGE.write_text(text[:begin] + made + text[text.index("\n\n", begin) :], encoding="utf-8")


if __name__ == "__main__":
    main()
