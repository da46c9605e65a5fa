"""Every effect of the turtlebot, diagnosed from 24 rollouts of a machine that has it, and one that has nothing.

    python -m benchmarks.diagnose.turtlebot         # a minute or two

The machines are twins of the simulator's own code: this shows that the method knows no robot, not how it does on
a machine of other code (benchmarks/blind). Each has the first parameter of one effect at 60 % of the way to an end of
its range. Prints what is answered, and keeps it in results/turtlebot_diagnose.json.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np

import s2r_spec as s2r
from benchmarks.machine import describe

RESULTS = Path(__file__).parents[1] / "results" / "turtlebot_diagnose.json"
SPEC = Path(__file__).parents[2] / "specs" / "turtlebot.stl"
ROLLOUTS, PART = 24, 0.6


def main() -> None:
    """Diagnose one machine after the other."""
    spec, nominal = s2r.load_spec(SPEC), s2r.load_backend("turtlebot")
    machines: dict[str, dict[str, dict[str, float]]] = {"nothing": {}}
    for effect in nominal.effects():
        p = effect.parameters[0]
        end = p.high if p.high != p.nominal else p.low
        machines[effect.name] = {effect.name: {p.name: p.nominal + PART * (end - p.nominal)}}
    rng, low, wide = np.random.default_rng(3), spec.space.lower, spec.space.upper - spec.space.lower
    kept = {}
    with tempfile.TemporaryDirectory() as cache:
        for name, values in machines.items():
            machine = nominal.with_effects(values)
            points = low + rng.uniform(size=(ROLLOUTS, spec.space.dim)) * wide
            tests = [dict(zip(spec.space.names, point.tolist(), strict=True)) for point in points]
            rollouts = [(test, machine.rollout(test, 700 + i)) for i, test in enumerate(tests)]
            found = s2r.diagnose(spec, nominal, rollouts, cache=Path(cache), where=False).to_json()
            which = found["which"]
            kept[name] = {"has": values, "verdict": found["verdict"], "answer": which["answer"]} | {
                key: which[key] for key in ("set", "status", "parameters")
            }
            print(f"{name:16} {values}  {found['verdict']}: {', '.join(which['answer'])}", flush=True)
    right = sum(one["answer"] == list(one["has"]) for name, one in kept.items() if name != "nothing")
    print(f"{right} of {len(kept) - 1} effects answered exactly; of nothing: {kept['nothing']['verdict']}")
    record = {"machine": describe("scipy"), "right": right, "machines": kept}
    RESULTS.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
