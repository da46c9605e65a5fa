"""The tables of docs/explanation/diagnosis.md that are not of sealed sets, from committed results.

    python -m benchmarks.diagnosis_tables            # prints them
    python -m benchmarks.diagnosis_tables --write    # puts them in the page; a test compares both

`benchmarks/blind/table.py` makes those of sealed sets.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

from benchmarks.blind.table import LATEST, PAGE, first, markdown, put
from s2r_spec.blind.score import truth
from s2r_spec.quantity import measured, quantity

FOLDER = Path(__file__).parent
SURE = 0.9
"""Level: probability from which an answer counts as confident."""


def sure_and_wrong() -> str:
    """Return the confident answers of the newest sets that were wrong."""
    rows = [["wrong answer with probability 0.9 or more", "true cause", "of its kind"]]
    for name in LATEST:
        for case in _result(f"blind/results/{name}_scores.json")["cases"].values():
            answer, probability = first(case)
            if probability >= SURE and answer != truth(case["label"]):
                label = case["label"]
                rows.append(
                    [" + ".join(sorted(answer)), " + ".join(sorted(label["effects"])), KINDS[label["kind"]]]
                )
    return markdown(rows)


KINDS = {"single": "in the catalogue", "pair": "a pair", "unknown": "not in the catalogue"}
"""Kind of a case → words."""


def could_close() -> str:
    """Return how much of a gap the true effects close, beside the named ones."""
    rows = [
        [
            "median closed part of a material gap",
            "cases",
            "true effects",
            "named effects",
            "tuned",
            "named ≈ true",
        ]
    ]
    near = "answer closes nearly as much as the true cause"
    for machine, name in (("axis, set 13", "emps13"), ("A1, set 9", "a1ninth")):
        kept = _result(f"blind/results/{name}_reach.json")
        for words, key in (("one effect", "single effects"), ("several effects", "several")):
            one = kept[f"of a material gap, {key}"]
            parts = [f"{100 * one[part]:.0f} %" for part in ("true cause", "answer", "tuned")]
            rows.append([f"{machine}, {words}", str(one["cases"]), *parts, f"{one[near]} of {one['cases']}"])
    return markdown(rows)


def several() -> str:
    """Return the answers for machines with four and five effects."""
    rows = [["effects in a machine", "largest set", "machines", "effects found", "absent effects named"]]
    rows[0] += ["median closed part of the gap", "answers ≥ 0.9, right", "exactly right"]
    kept = _result("blind/results/several.json")
    for effects in (4, 5):
        for size in (3, 6):
            one = kept[f"{effects} effects, sets up to {size}"]
            rows.append(
                [
                    str(effects),
                    str(size),
                    str(one["machines"]),
                    f"{one['of these fitted']} of {one['effects']}",
                    str(one["fitted and not there"]),
                    f"{100 * one['closed, median']:.0f} %",
                    f"{one['of these right']} of {one['answers of 0.9 and more']}",
                    str(one["all and no other"]),
                ]
            )
    return markdown(rows)


def worst_test() -> str:
    """Return how often the stated worst test is the true one."""
    rows = [
        [
            "worst test from 30 rollouts, axis",
            "effects",
            "within a tenth",
            "nine tenths of the gap",
            "in the box",
        ]
    ]
    kept = _result("results/where_worst.json")
    for words, key in (("the simulator's own code", "emps"), ("the generator's code", "emps_twin")):
        one = kept[key]["summary"]
        ours, alone = one["diagnosis"], one["process"]
        pairs = [f"{ours[what]} ({alone[what]})" for what in ("near", "enough")]
        rows.append([words, str(one["effects"]), *pairs, str(one["inside"])])
    return markdown(rows)


def twins() -> str:
    """Return what was named in the A1's four twins."""
    rows = [["twin", "effects in it", "named, with 90 % intervals", "not ruled out", "held-out gap closed"]]
    for place, one in _result("results/twins_diagnose.json")["twins"].items():
        units = {p: v["unit"] for values in one["parameters"].values() for p, v in values.items()}
        has = [
            f"{e}.{p} {quantity(x, units.get(p, ''))}" for e, v in one["has"].items() for p, x in v.items()
        ]
        others = [name for name in one["set"] if name not in one["answer"]]
        share = f"{100 * one['share']['estimate']:.0f} %"
        rows.append([f"`{place}`", "; ".join(has), "; ".join(_values(one)), ", ".join(others), share])
    return markdown(rows)


def axis() -> str:
    """Return what was named on the recordings of the real axis."""
    kept = _result("real/emps_diagnose.json")
    friction, pulses = kept["friction"], kept["pulses"]
    share = friction["share"]
    ends = f"95 %: {100 * share['low']:.0f} to {100 * share['high']:.0f} %"
    before, after = friction["control law leaves"]
    unexplained = re.search(
        r"\+[\d.]+ V of controller (?:between|from) [\d.]+ (?:and|to) [\d.]+ s", pulses["text"]
    )
    assert unexplained is not None
    offset = next(pair["probability"] for pair in friction["pairs"] if "offset" in pair["effects"])
    return markdown(
        [
            ["recordings of the real axis", "answer"],
            ["friction: verdict", friction["verdict"]],
            ["friction: named, with 90 % intervals", "; ".join(_values(friction))],
            ["friction: probability of these and the offset", f"{offset:.3f}"],
            ["friction: held-out gap closed", f"{100 * share['estimate']:.0f} % ({ends})"],
            ["friction: the same, tuned", f"{100 * friction['tuned_share']['estimate']:.0f} %"],
            ["friction: voltage that the control law leaves, rms", f"{before:.4f} V"],
            ["friction: the same with the named filter", f"{after:.4f} V"],
            ["pulses: verdict", pulses["verdict"]],
            ["pulses: unexplained in each move", unexplained[0]],
        ]
    )


def go2() -> str:
    """Return what was named on the recording of the real Go2, and what a least-squares fit finds."""
    kept, fit = _result("real/go2_diagnose.json"), _result("real/go2_fit.json")
    given, far = kept["given_by_its_model_file"], kept["how_far"]
    rows = [["real Go2 in the air", "`s2r diagnose`", "least-squares fit", "its model file"]]
    for effect, unit in (("dry_friction", "N*m"), ("armature", "kg*m^2"), ("viscous_friction", "N*m*s/rad")):
        for joint in ("hip", "thigh", "calf"):
            one = kept["parameters"].get(effect, {}).get(joint)
            named = "not named"
            if one is not None and effect in kept["answer"]:
                named = measured(one["estimate"], one["low"], one["high"], unit)
            fitted = quantity(fit["of_kinds"][f"{effect} [{unit}]"][joint], unit)
            rows.append([f"{effect} of a {joint}", named, fitted, quantity(given[effect][joint], unit)])
    closed, tuned = (f"{100 * far[key]['estimate']:.0f} %" for key in ("share", "tuned_share"))
    calves = [x for name, x in fit["of_each_joint"]["dry_friction [N*m]"].items() if "calf" in name]
    return markdown(
        [
            *rows,
            ["held-out gap closed", closed, f"{100 * fit['of_kinds_closes']:.0f} %", ""],
            ["the same, tuned", tuned, "", ""],
            [
                "the same, friction of each joint separately",
                "",
                f"{100 * fit['of_each_joint_closes']:.0f} %",
                "",
            ],
            [
                "dry_friction of the four calves separately",
                "",
                f"{min(calves):.2f} to {max(calves):.2f} N·m",
                "",
            ],
        ]
    )


TABLES = (sure_and_wrong, could_close, several, worst_test, twins, axis, go2)


def _values(one: dict[str, Any]) -> list[str]:
    """Return every parameter of the named effects with its interval."""
    return [
        f"{effect}.{name} {measured(v['estimate'], v['low'], v['high'], v['unit'])}"
        for effect, values in one["parameters"].items()
        if effect in one["answer"]
        for name, v in values.items()
    ]


def _result(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((FOLDER / name).read_text(encoding="utf-8"))
    return found


def main() -> None:
    """Print the tables, and write them if asked."""
    for table in TABLES:
        print(table(), end="\n\n")
        if "--write" in sys.argv:
            put(PAGE, table())


if __name__ == "__main__":
    main()
