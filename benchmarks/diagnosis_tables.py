"""Tables of the diagnoses of the A1's twins and of recordings of real machines, from committed results.

`python -m benchmarks.diagnosis_tables` prints them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from s2r_spec.quantity import measured, quantity

FOLDER = Path(__file__).parent


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
    likely = friction["pairs"][0]
    return markdown(
        [
            ["recordings of the real axis", "answer"],
            ["friction: verdict", friction["verdict"]],
            ["friction: named, with 90 % intervals", "; ".join(_values(friction))],
            [
                "friction: most probable set",
                f"{' and '.join(likely['effects'])} ({likely['probability']:.2f})",
            ],
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
    for fitted, unit in (("dry_friction", "N*m"), ("armature", "kg*m^2"), ("viscous_friction", "N*m*s/rad")):
        for joint in ("hip", "thigh", "calf"):
            effect, name = (f"{joint}_friction", "torque") if fitted == "dry_friction" else (fitted, joint)
            one = kept["parameters"][effect][name]
            answer = "not named"
            if kept["status"][effect] == "named":
                answer = measured(one["estimate"], one["low"], one["high"], unit)
            value = fit["of_kinds"][f"{fitted} [{unit}]"][joint]
            row = [
                f"{fitted} of a {joint}",
                answer,
                quantity(value, unit),
                quantity(given[effect][name], unit),
            ]
            rows.append(row)
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


TABLES = (twins, axis, go2)


def markdown(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of cells, the first of them the head, as a table in Markdown."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (rows[0], ["---"] * len(rows[0]), *rows[1:]))


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
    """Print the tables."""
    for table in TABLES:
        print(table(), end="\n\n")


if __name__ == "__main__":
    main()
