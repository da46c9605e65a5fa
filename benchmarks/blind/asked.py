"""What the equations of motion alone say of opened cases, without the rest of the diagnosis.

    python benchmarks/blind/asked.py a1 FOLDER       # FOLDER: of `check.py freeze`, after `open`

Every rollout that a diagnosis would see is regressed on what each effect would have explained in it
(``s2r_spec/diagnose/equations.py``); here only the mean of these coordinates over a case's rollouts is looked at.
Printed for each case: what is there, and what the equations ask for; then, over all known cases, the root mean square
error of each coordinate, once what the bank says of the true effects is taken off it; how often the truth is what the
equations alone speak for (``s2r_spec/diagnose/told.py``); what would become of the frozen answers' log score if they
were heard by so much more than they were; and which part of the true sizes the answers have, and which the
equations. This is for development: the labels are open.

Writes results/<set>_asked.json.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

sys.path.insert(0, str(Path(__file__).parent))
from opened import Opened, bench, rollouts

from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.asked import Asked
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.diagnose.told import log_evidence

FloatArray = NDArray[np.float64]
WEIGHTS = (0.0, 0.3, 0.7, 1.0)
"""By how much more than in the frozen answers the equations are heard."""
UNLISTED = 1e-3
"""Probability of a set that an answer does not list."""
PENALTY = 2.5
"""Log odds against each effect in a set: there are twenty singles, and two hundred pairs."""
SHOWN = 0.1
"""Coordinates below this are not printed."""


def expected(asked: Asked, values: dict[str, dict[str, float]]) -> FloatArray:
    """Return (p,) what the bank says of effects with these values, one beside the other."""
    total = np.zeros(len(asked.names))
    for curve in asked.curves:
        value = values.get(curve.line.effect, {}).get(curve.line.parameter, curve.line.nominal)
        if value != curve.line.nominal:
            total = total + curve(curve.line.coordinate(value))
    return total


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


def likeliest(asked: Asked, mean: FloatArray) -> tuple[tuple[str, ...], str]:
    """Return the likeliest set of at most two effects, and the likeliest effect, with PENALTY for every effect."""
    effects = tuple(dict.fromkeys(curve.line.effect for curve in asked.curves))
    sets = [(), *((name,) for name in effects), *combinations(effects, 2)]
    logs = log_evidence(asked, mean, sets) - PENALTY * np.array([len(members) for members in sets])
    among = {name: logsumexp([v for s, v in zip(sets, logs, strict=True) if name in s]) for name in effects}
    return sets[int(np.argmax(logs))], max(among, key=lambda name: among[name])


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
    seen = opened.over(coordinates, scores)

    effects = tuple(dict.fromkeys(curve.line.effect for curve in asked.curves))
    rests, alone, logs = [], [], {weight: [] for weight in WEIGHTS}
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
        true = tuple(label["effects"])
        members, first = likeliest(asked, mean)
        alone.append((label["kind"], set(members) == set(true), first in true))
        listed = candidates(scores[name], effects)
        place, speaks = list(listed).index(tuple(sorted(true))), log_evidence(asked, mean, list(listed))
        for weight in WEIGHTS:
            both = np.log(np.maximum([*listed.values()], 1e-9)) + weight * speaks
            logs[weight].append(float(both[place] - logsumexp(both)))
    errors = dict(zip(asked.names, np.sqrt(np.mean(np.square(rests), axis=0)).round(3).tolist(), strict=True))
    answered, equations = np.median(parts, axis=0).round(2).tolist()
    print(
        f"of the true size of {len(parts)} named parameters the answer has {answered}, the equations {equations} "
        f"(medians)"
    )
    hits = {
        kind: {"of": len(of), "set": sum(s for _, s, _ in of), "effect": sum(e for *_, e in of)}
        for kind in dict.fromkeys(kind for kind, *_ in alone)
        if (of := [row for row in alone if row[0] == kind])
    }
    print(f"root mean square error over {len(rests)} known cases: {errors}")
    print(f"spoken for by the equations alone, the set and an effect of it: {hits}")
    heard = {f"{weight:+g}": round(float(np.mean(values)), 3) for weight, values in logs.items()}
    print(f"mean log probability of the truth, with the equations heard by so much more: {heard}")
    found = {
        "cases": told,
        "errors": errors,
        "known": len(rests),
        "part of the true size": {"of": len(parts), "answer": answered, "equations": equations},
        "alone": hits,
        "log score if heard more": heard,
    }
    opened.write("asked", found)


if __name__ == "__main__":
    main()
