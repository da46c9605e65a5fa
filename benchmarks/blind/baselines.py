"""What simpler ways make of the same sealed cases: which single effect they would name.

    python benchmarks/blind/baselines.py emps FOLDER     # FOLDER: of `check.py freeze`, after `open`

For the cases with one effect, and beside what the frozen answers name first:

- joint least squares: the whole catalogue fitted at once, hardly held back; the effect that moved furthest,
  in parts of its typical size (what a system identification would blame);
- single fits: each effect alone, over its range; the one that leaves least (BIC, all of one parameter);
- ρ only: the same, of ρ and nothing else;
- chance.

Writes results/<set>_baselines.json.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from opened import Opened, bench, rollouts

from s2r_spec.blind.score import Rate, ranked, truth
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.joint import joint_fit
from s2r_spec.diagnose.prepare import compare
from s2r_spec.diagnose.simulate import Bench

FREE = 3.0
"""Standard deviation of a coordinate in the joint fit, in parts of a typical effect."""


@cache
def known(name: str) -> tuple[Bench, banks.Bank]:
    """Return bench and bank, the same for all cases of a set."""
    bank = banks.bank(bench(name))
    return replace(bench(name), features=bank.features), bank


def named(case: Path, name: str) -> dict[str, str]:
    """Return what each baseline would name."""
    ours, bank = known(name)
    seen = [run for part in rollouts(ours, case) for run in part]
    compared = compare(ours, bank, seen, None, lambda *_: None)
    view = compared.view
    catalogue, surrogate = view.surrogate.catalogue, view.surrogate
    begin = surrogate.turned(view.data, view.variance)
    free = joint_fit(
        compared.simulator,
        view.data,
        view.variance,
        view.nuisances,
        begin,
        surrogate.jacobian(begin),
        FREE,
    )
    moved = np.where(catalogue.based, 0.0, np.abs(free.at))
    places = range(len(catalogue.effects))
    alone = [surrogate.scanned(view.data, view.variance, k, begin)[1] for k in places]
    gap = {tuple(sorted(test.items())): [] for test, _ in seen}
    for test, trace in seen:
        gap[tuple(sorted(test.items()))].append(ours.rho(trace, test))
    nominal = {
        key: np.mean([ours.rho(ours.run({}, dict(key), s), dict(key)) for s in range(2)]) for key in gap
    }
    away = np.array(
        [np.mean(gap[key]) - nominal[key] for key in (tuple(sorted(t.items())) for t in view.layout.tests)]
    )
    left = [np.inf] * len(catalogue.effects)
    for k, curve in enumerate(catalogue.curves):
        if not catalogue.based[k]:
            rest = away - curve.rho @ view.layout.interpolate.T
            left[catalogue.owner[k]] = min(left[catalogue.owner[k]], float((rest**2).sum(axis=1).min()))
    return {
        "joint least squares": catalogue.effects[catalogue.owner[int(moved.argmax())]],
        "single fits": catalogue.effects[int(np.argmax(alone))],
        "ρ only": catalogue.effects[int(np.argmin(left))],
        "effects": str(len(catalogue.effects)),
    }


def main() -> None:
    opened = Opened.asked_for(__doc__)
    labels = {name: case["label"] for name, case in opened.cases().items()}
    single = [name for name, label in labels.items() if label["kind"] == "single"]
    known(opened.name)
    found = opened.over(named, single)
    true = [next(iter(truth(labels[name]))) for name in single]
    rates = {
        way: Rate(sum(each[way] == right for each, right in zip(found, true, strict=True)), len(single))
        for way in ("joint least squares", "single fits", "ρ only")
    }
    frozen = [json.loads((opened.answers / f"{name}.json").read_text()) for name in single]
    first = [
        next(s for s, _ in ranked(answer) if not s & {"none", "unknown"}) == {right}
        for answer, right in zip(frozen, true, strict=True)
    ]
    rates["s2r diagnose, likeliest cause"] = Rate(sum(first), len(first))
    kept = {
        "chance": 1 / int(found[0]["effects"]),
        "rates": {way: rate.to_json() for way, rate in rates.items()},
    }
    opened.write("baselines", kept, "numpy", "scipy", "scikit-learn")
    print(f"{len(single)} cases with one effect; chance {kept['chance']:.3f}")
    for way, rate in rates.items():
        print(f"{way:30} {rate.value:.3f}  {rate.hits} of {rate.of}")


if __name__ == "__main__":
    main()
