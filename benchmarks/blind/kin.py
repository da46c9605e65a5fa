"""How often what looks like one effect of a kind was the other, on opened sets.

    python benchmarks/blind/kin.py

Of every sealed case with a single true effect that has another of its kind: which of the two its answer finds likelier,
and how sure it is of that. From the committed answers of before such effects shared their probability.
"""

from __future__ import annotations

import json
from pathlib import Path

RESULTS = Path(__file__).parent / "results"
KINDS = (("delay", "current_lag"), ("mass", "motor_gain"), ("command_delay", "rotor_lag"))
SETS = ("emps8", "emps9", "emps10", "emps11", "emps12", "emps13", "quad1")
CLEAR = 0.8
"""Part of the two effects' probability that the likelier one has where the evidence is clear."""


def main() -> None:
    other = {a: b for pair in KINDS for a, b in (pair, pair[::-1])}
    rows = []
    for name in SETS:
        for case in json.loads((RESULTS / f"{name}_scores.json").read_text())["cases"].values():
            true = list(case["label"]["effects"])
            if case["label"]["kind"] == "single" and true[0] in other:
                own, its = (case["posterior"].get(effect, 0.0) for effect in (true[0], other[true[0]]))
                rows.append((true[0], own > its, max(own, its) > CLEAR * (own + its)))
    for kind in KINDS:
        mine = [right for effect, right, _ in rows if effect in kind]
        print(f"{' and '.join(kind)}: the true one is the likelier in {sum(mine)} of {len(mine)}")
    clear = [right for _, right, sure in rows if sure]
    print(f"together {sum(right for _, right, _ in rows)} of {len(rows)}, ", end="")
    print(f"where one has {CLEAR:.0%} and more of their probability {sum(clear)} of {len(clear)}")


if __name__ == "__main__":
    main()
