"""What the equations of motion alone say of opened cases, without the rest of the diagnosis.

    python benchmarks/blind/asked.py a1 FOLDER       # FOLDER: of `check.py freeze`, after `open`

Every rollout that a diagnosis would see is regressed on what each effect would have explained in it
(``s2r_spec/diagnose/equations.py``); here only the mean of these coordinates over a case's rollouts is looked at.
Printed for each case: what is there, and what the equations ask for; then, over all known cases, the root mean square
error of each coordinate, once what the bank says of the true effects is taken off it; and what would become of the
frozen answers' log score if the evidence of these few numbers were heard beside them, with weights from 0 to 1. Their
error is one of six sizes, all as likely before they are seen. Last, which part of the true sizes the answers have, and
which the equations. This is for development: the labels are open.

Writes results/<set>_asked.json.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

sys.path.insert(0, str(Path(__file__).parent))
from opened import Opened, bench, rollouts

from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.asked import Asked
from s2r_spec.diagnose.evidence import LARGE
from s2r_spec.diagnose.simulate import Bench

FloatArray = NDArray[np.float64]
ERRORS = (0.03, 0.05, 0.08, 0.13, 0.2, 0.35)
"""Standard deviation of what no effect explains of a mean coordinate, in parts of typical sizes."""
WEIGHTS = (0.0, 0.15, 0.3, 0.5, 1.0)
SHOWN = 0.1
"""Coordinates below this are not printed."""
UNLISTED = 1e-3
"""Probability of a set that an answer does not list."""


def expected(asked: Asked, values: dict[str, dict[str, float]]) -> FloatArray:
    """Return (p,) what the bank says of effects with these values, one beside the other."""
    total = np.zeros(len(asked.names))
    for curve in asked.curves:
        value = values.get(curve.line.effect, {}).get(curve.line.parameter, curve.line.nominal)
        if value != curve.line.nominal:
            total = total + curve(curve.line.coordinate(value))
    return total


def log_evidence(asked: Asked, seen: FloatArray, members: tuple[str, ...], error: float) -> float:
    """Return that of (p,) mean coordinates for these effects, by Laplace's method, others a little."""
    mine = asked.lines(members)
    before, wide = np.zeros(len(mine)), np.full(len(mine), LARGE**2)
    spread = asked.spread(seen, members, error)
    weigh = np.linalg.inv(spread)
    x, rest, slopes = asked.nearest(seen, mine, weigh, before, wide)
    inner = np.eye(len(mine)) + LARGE**2 * slopes @ weigh @ slopes.T
    volume = np.linalg.slogdet(inner)[1] + np.linalg.slogdet(spread)[1]
    return float(-0.5 * (rest @ weigh @ rest + x @ x / LARGE**2 + volume))


@cache
def known(name: str) -> tuple[Bench, Asked]:
    """Return a set's bench, and what its bank says of the equations, the same for all of its cases."""
    bank = banks.bank(bench(name))
    return replace(bench(name), features=bank.features), Asked.of(bank)


def coordinates(case: Path, name: str) -> FloatArray:
    """Return (p,) means over the rollouts that a diagnosis sees, less those of the nominal simulator."""
    ours, asked = known(name)
    seen, _ = rollouts(ours, case)
    assert ours.features is not None
    rows = [
        ours.features.equations(trace, ours.backend, ours.matched.to_backend(test)) for test, trace in seen
    ]
    return np.asarray(np.nanmean(rows, axis=0) - asked.nominal)


def candidates(kept: dict[str, Any], effects: tuple[str, ...]) -> dict[tuple[str, ...], float]:
    """Return set → probability of a frozen answer: what it lists, every single effect, and the truth."""
    found = {(): kept["posterior"].get("none", UNLISTED)}
    found |= {(name,): kept["posterior"].get(name, UNLISTED) for name in effects}
    found |= {tuple(sorted(pair["effects"])): pair["probability"] for pair in kept["pairs"]}
    found.setdefault(tuple(sorted(kept["label"]["effects"])), UNLISTED)
    return found


def sizes(kept: dict[str, Any], asked: Asked, mean: FloatArray) -> list[tuple[float, float]]:
    """Return, of each true parameter that a frozen answer sizes, which part of it the answer and the equations have."""
    found = []
    for curve in asked.curves:
        effect, parameter = curve.line.effect, curve.line.parameter
        answer = kept["parameters"].get(effect, {}).get(parameter)
        true = curve.line.coordinate(
            kept["label"]["effects"].get(effect, {}).get(parameter, curve.line.nominal)
        )
        name = f"{effect}.{parameter}"
        if answer and name in asked.names and abs(true) > SHOWN:
            own = float(mean[asked.names.index(name)])
            found.append((curve.line.coordinate(answer["estimate"]) / true, own / true))
    return found


def main() -> None:
    opened = Opened.asked_for(__doc__)
    scores = opened.cases()
    _, asked = known(opened.name)
    effects = tuple(dict.fromkeys(curve.line.effect for curve in asked.curves))
    seen = opened.over(coordinates, scores)

    rests, logs = [], {weight: [] for weight in WEIGHTS}
    parts: list[tuple[float, float]] = []
    told = {}
    for name, mean in zip(scores, seen, strict=True):
        label = scores[name]["label"]
        clear = {n: round(float(x), 2) for n, x in zip(asked.names, mean, strict=True) if abs(x) > SHOWN}
        told[name] = {"kind": label["kind"], "effects": label["effects"], "asked for": clear}
        print(f"{label['kind']:8} {label['effects']}\n         asked for {clear}")
        if label["kind"] == "unknown":
            continue
        rests.append(mean - expected(asked, label["effects"]))
        parts += sizes(scores[name], asked, mean)
        sets = candidates(scores[name], effects)
        true = list(sets).index(tuple(sorted(label["effects"])))
        speaks = np.array(
            [logsumexp([log_evidence(asked, mean, s, error) for error in ERRORS]) for s in sets]
        )
        for weight in WEIGHTS:
            both = np.log([*sets.values()]) + weight * speaks
            logs[weight].append(float(both[true] - logsumexp(both)))
    errors = dict(zip(asked.names, np.sqrt(np.mean(np.square(rests), axis=0)).round(3).tolist(), strict=True))
    mixed = {f"{weight:g}": round(float(np.mean(values)), 3) for weight, values in logs.items()}
    print(f"root mean square error over {len(rests)} known cases: {errors}")
    print(f"mean log probability of the truth, with the equations heard by a weight of: {mixed}")
    answered, equations = np.median(parts, axis=0).round(2).tolist()
    print(
        f"of the true size of {len(parts)} named parameters the answer has {answered}, the equations {equations} "
        f"(medians)"
    )
    found = {
        "cases": told,
        "errors": errors,
        "known": len(rests),
        "part of the true size": {"of": len(parts), "answer": answered, "equations": equations},
        "log score by weight": mixed,
    }
    opened.write("asked", found)


if __name__ == "__main__":
    main()
