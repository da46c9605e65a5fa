"""The table of sealed sets in docs/explanation/diagnosis.md, from the scores in results/; a test holds it to them.

python benchmarks/blind/table.py            # prints it
python benchmarks/blind/table.py --write    # and puts it in the page's place
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"
PAGE = Path(__file__).parents[2] / "docs" / "explanation" / "diagnosis.md"
SETS = {
    "emps1": "of the axis, first",
    "emps2": "second",
    "emps3": "third",
    "emps4": "fourth",
    "emps": "fifth",
    "a1first": "of the A1, first",
    "a1second": "second",
    "a1": "third",
}
RATES = {
    "single effects: the answer is it": "top-1, single effects",
    "single effects: it is the likeliest effect": "most probable member, single",
    "single effects: it is in the set answered (of mean size {})": "in the answered set, single",
    "exact pair": "exact pair first",
    "one of the pair is the likeliest effect": "one of the pair first",
    "known causes called *none of these*": "known effects called unknown",
    "unknown causes with a material gap that were seen as such": "unknown with a material gap detected",
    "machines with nothing wrong that were called something else": "null called anything else",
    "answers of 0.9 and more that were right": "right where sure",
    "true value in its 90 % interval": "true value in its 90 % interval",
}
CLOSED, TUNED = "ratio of sums", "ratio of sums, a little of every other effect added"


def table() -> str:
    """Return the table as Markdown."""
    names = [name for name in SETS if (RESULTS / f"{name}_scores.json").exists()]
    scores: list[dict[str, Any]] = [
        json.loads((RESULTS / f"{name}_scores.json").read_text())["scores"] for name in names
    ]
    sizes = "; ".join(f"{s['set size, single (mean)']:.2f}" for s in scores)
    shrink = [s["shrink, single"] for s in scores]
    rows = [
        ["sealed set", *(SETS[name] for name in names)],
        ["---"] * (len(names) + 1),
        ["file in `benchmarks/blind/results/`", *(f"`{name}_scores.json`" for name in names)],
        ["cases", *(str(s["cases"]) for s in scores)],
        *(
            [words.format(sizes), *(f"{s[key]['hits']} of {s[key]['of']}" for s in scores)]
            for words, key in RATES.items()
        ),
        [
            "held-out gap above its floor that the patch closed, single effects",
            *(f"{100 * s[CLOSED]:.0f} %" for s in shrink),
        ],
        ["the same, tuned", *(f"{100 * s[TUNED]:.0f} %" if TUNED in s else "" for s in shrink)],
    ]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def main() -> None:
    """Print, and write if asked."""
    print(table())
    if "--write" in sys.argv:
        text = PAGE.read_text(encoding="utf-8")
        begin = text.index("| sealed set |")
        PAGE.write_text(text[:begin] + table() + text[text.index("\n\n", begin) :], encoding="utf-8")


if __name__ == "__main__":
    main()
