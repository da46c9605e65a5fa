"""What the equations of motion alone say of opened cases, without the rest of the diagnosis.

    python benchmarks/blind/asked.py a1 FOLDER       # FOLDER: of `check.py freeze`, after `open`

Every rollout that a diagnosis would see is regressed on what each effect would have explained in it
(``s2r_spec/diagnose/equations.py``); here only what all rollouts of a case say together is looked at.
Printed for each case: what is there, and what the equations ask for; then, over all known cases, the root mean square
error of each coordinate, once what the bank says of the true effects is taken off it; how often the truth is what the
equations alone speak for (``s2r_spec/diagnose/told.py``); what would become of the frozen answers' log score if they
were heard by so much more than they were; which part of the true sizes the answers have, and which the
equations; and what they ask for on average of effects that are not there, with instruments and without.
This is for development: the labels are open.
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
from s2r_spec.diagnose.asked import Asked, asked_columns, pooled
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
def known(name: str) -> tuple[Bench, banks.Bank, Asked]:
    """Return a set's bench, its bank, and what that says of the equations, the same for all of its cases."""
    bank = banks.bank(bench(name))
    return replace(bench(name), features=bank.features), bank, Asked.of(bank)


def coordinates(case: Path, name: str) -> FloatArray:
    """Return (p,) of all rollouts that a diagnosis sees, less those of the nominal simulator."""
    ours, bank, asked = known(name)
    seen, _ = rollouts(ours, case)
    rows = [ours.measure(trace, test) for test, trace in seen]
    weights = ours.weights([test for test, _ in seen])
    return pooled(np.array(rows)[:, asked_columns(bank)], weights) - asked.nominal


def least_squares(case: Path, name: str) -> FloatArray:
    """Return the same without instruments: means of regressions of one rollout each."""
    ours, *_ = known(name)
    assert ours.features is not None
    seen, _ = rollouts(ours, case)
    apart = []
    for place, (test, trace) in enumerate(seen):
        machine, nominal = (
            ours.features.equations(each, ours.backend, ours.matched.to_backend(test))
            for each in (trace, ours.run({}, test, place))
        )
        apart.append(machine - nominal)
    return np.asarray(np.nanmean(apart, axis=0))


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


def not_there(asked: Asked, seen: list[FloatArray], scores: dict[str, dict[str, Any]]) -> dict[str, float]:
    """Return the mean coordinate of each parameter over the known cases without its effect."""
    known_ones = [
        (mean, kept["label"]["effects"])
        for mean, kept in zip(seen, scores.values(), strict=True)
        if kept["label"]["kind"] != "unknown"
    ]
    found = {}
    for place, name in enumerate(asked.names):
        values = [mean[place] for mean, effects in known_ones if name.split(".")[0] not in effects]
        found[name] = round(float(np.mean(values)), 3) + 0.0
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
    *_, asked = known(opened.name)
    seen = opened.over(coordinates, scores)
    instrumented = known(opened.name)[1].features.instrumented
    bare = opened.over(least_squares, scores) if instrumented else []

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
    absent = {"with instruments" if instrumented else "least squares": not_there(asked, seen, scores)}
    if instrumented:
        absent["least squares"] = not_there(asked, bare, scores)
    for how, means in absent.items():
        print(f"asked for on average of effects that are not there, {how}: {means}")
    found = {
        "cases": told,
        "errors": errors,
        "known": len(rests),
        "part of the true size": {"of": len(parts), "answer": answered, "equations": equations},
        "alone": hits,
        "log score if heard more": heard,
        "of effects that are not there": absent,
    }
    opened.write("asked", found)


if __name__ == "__main__":
    main()
