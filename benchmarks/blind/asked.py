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

import argparse
import json
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

sys.path.insert(0, str(Path(__file__).parents[1]))
from machine import describe

from s2r_spec.backend import load_backend
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.ask import real_rollouts
from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.evidence import ALLOWED, LARGE
from s2r_spec.diagnose.prepare import bench_of, split
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.spec import load_spec

FloatArray = NDArray[np.float64]
RESULTS = Path(__file__).parent / "results"
ROOT = Path(__file__).parents[2]
SETS = {"emps": ("specs/emps_tracking.stl", "emps"), "a1": ("specs/a1_velocity.stl", "sim")}
"""Set → its spec and its simulator."""
ERRORS = (0.03, 0.05, 0.08, 0.13, 0.2, 0.35)
"""Standard deviation of what no effect explains of a mean coordinate, in parts of typical sizes."""
FORM = 0.1
"""The same, in parts of the coordinate itself."""
ROUNDS = 4
"""Of Newton's method, each but the first by half of its step."""
WEIGHTS = (0.0, 0.15, 0.3, 0.5, 1.0)
SHOWN = 0.1
"""Coordinates below this are not printed."""
UNLISTED = 1e-3
"""Probability of a set that an answer does not list."""


@dataclass(frozen=True)
class Curve:
    """What one line of the catalogue does to the mean coordinates: (g,) its own, rising, and (g, p) theirs."""

    line: Line
    at: FloatArray
    change: FloatArray

    def __call__(self, x: float) -> FloatArray:
        x = float(np.clip(x, self.at[0], self.at[-1]))
        return np.array([np.interp(x, self.at, column) for column in self.change.T])

    def slope(self, x: float) -> FloatArray:
        low, high = np.clip((x - 0.1, x + 0.1), self.at[0], self.at[-1])
        return (self(high) - self(low)) / (high - low)


@dataclass(frozen=True)
class Catalogue:
    """The bank, as far as the equations see it."""

    names: tuple[str, ...]
    nominal: FloatArray
    curves: tuple[Curve, ...]
    variants: FloatArray

    @classmethod
    def of(cls, bank: banks.Bank) -> Catalogue:
        asked = [k for k, f in enumerate(bank.features.names()) if f.statistic == "equation"]
        columns = 1 + np.array(asked)
        curves = []
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # where every rollout fell there is no mean
            for line, change in zip(bank.lines, bank.changes, strict=True):
                if line.base:
                    continue  # what it does hangs on how much there is of its effect: no curve of its own
                mean = np.nanmean(change[..., columns], axis=1)
                at = np.array([line.coordinate(value) for value in line.values])
                there = np.isfinite(mean).all(axis=1)
                at, mean = np.append(at[there], 0.0), np.vstack([mean[there], np.zeros(len(columns))])
                order = np.argsort(at)
                curves.append(Curve(line, at[order], mean[order]))
        return cls(
            tuple(bank.features.names()[k].block for k in asked),
            np.nanmean(bank.nominal[..., columns], axis=(0, 1)),
            tuple(curves),
            np.nanmean(bank.variants[..., columns], axis=1),
        )

    @property
    def effects(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(curve.line.effect for curve in self.curves))

    def expected(self, values: dict[str, dict[str, float]]) -> FloatArray:
        """Return (p,) what the bank says of effects with these values, one beside the other."""
        total = np.zeros(len(self.names))
        for curve in self.curves:
            value = values.get(curve.line.effect, {}).get(curve.line.parameter, curve.line.nominal)
            if value != curve.line.nominal:
                total = total + curve(curve.line.coordinate(value))
        return total

    def log_evidence(self, seen: FloatArray, members: tuple[str, ...], error: float) -> float:
        """Return that of (p,) mean coordinates for these effects, by Laplace's method, others a little."""
        mine = [curve for curve in self.curves if curve.line.effect in members]
        little = [ALLOWED * curve.slope(0.0) for curve in self.curves if curve.line.effect not in members]
        rows = np.array([*little, *self.variants]).reshape(-1, len(seen))
        spread = rows.T @ rows + np.diag(error**2 + (FORM * seen) ** 2)
        weigh = np.linalg.inv(spread)

        def at(x: FloatArray) -> tuple[FloatArray, FloatArray]:
            there = np.array([curve(c) for curve, c in zip(mine, x, strict=True)]).reshape(-1, len(seen))
            slopes = np.array([curve.slope(c) for curve, c in zip(mine, x, strict=True)])
            return there.sum(axis=0), slopes.reshape(-1, len(seen))

        x = np.zeros(len(mine))
        for again in range(ROUNDS):
            there, own = at(x)
            inner = own @ weigh @ own.T + np.eye(len(mine)) / LARGE**2
            aim = np.linalg.solve(inner, own @ weigh @ (seen - there + x @ own))
            x = (x + aim) / 2 if again else aim
            x = np.clip(x, [curve.at[0] for curve in mine], [curve.at[-1] for curve in mine])
        there, own = at(x)
        rest = seen - there
        inner = np.eye(len(mine)) + LARGE**2 * own @ weigh @ own.T
        volume = np.linalg.slogdet(inner)[1] + np.linalg.slogdet(spread)[1]
        return float(-0.5 * (rest @ weigh @ rest + x @ x / LARGE**2 + volume))


@cache
def known(name: str) -> tuple[Bench, Catalogue]:
    """Return bench and catalogue of a set, the same for all of its cases."""
    path, simulator = SETS[name]
    spec = load_spec(ROOT / path)
    bench = bench_of(spec, spec.requirements[0], simulator)
    bank = banks.bank(bench)
    return replace(bench, features=bank.features), Catalogue.of(bank)


def coordinates(case: Path, name: str) -> FloatArray:
    """Return (p,) means over the rollouts that a diagnosis sees, less those of the nominal simulator."""
    bench, catalogue = known(name)
    rollouts = real_rollouts(bench, load_backend(f"log:{case}"), None, 0, None, lambda *_: None)
    seen, _ = split(rollouts, 0)
    assert bench.features is not None
    rows = [
        bench.features.equations(trace, bench.backend, bench.matched.to_backend(test)) for test, trace in seen
    ]
    return np.asarray(np.nanmean(rows, axis=0) - catalogue.nominal)


def candidates(kept: dict[str, Any], effects: tuple[str, ...]) -> dict[tuple[str, ...], float]:
    """Return set → probability of a frozen answer: what it lists, every single effect, and the truth."""
    found = {(): kept["posterior"].get("none", UNLISTED)}
    found |= {(name,): kept["posterior"].get(name, UNLISTED) for name in effects}
    found |= {tuple(sorted(pair["effects"])): pair["probability"] for pair in kept["pairs"]}
    found.setdefault(tuple(sorted(kept["label"]["effects"])), UNLISTED)
    return found


def sizes(kept: dict[str, Any], catalogue: Catalogue, mean: FloatArray) -> list[tuple[float, float]]:
    """Return, of each true parameter that a frozen answer sizes, which part of it the answer and the equations have."""
    found = []
    for curve in catalogue.curves:
        effect, parameter = curve.line.effect, curve.line.parameter
        answer = kept["parameters"].get(effect, {}).get(parameter)
        true = curve.line.coordinate(
            kept["label"]["effects"].get(effect, {}).get(parameter, curve.line.nominal)
        )
        name = f"{effect}.{parameter}"
        if answer and name in catalogue.names and abs(true) > SHOWN:
            own = float(mean[catalogue.names.index(name)])
            found.append((curve.line.coordinate(answer["estimate"]) / true, own / true))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("set", choices=tuple(SETS))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    scores = json.loads((RESULTS / f"{given.set}_scores.json").read_text())["cases"]
    names = list(scores)
    cases = [given.folder / given.set / "public" / name for name in names]
    _, catalogue = known(given.set)
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        seen = list(pool.map(coordinates, cases, [given.set] * len(cases)))

    rests, logs = [], {weight: [] for weight in WEIGHTS}
    parts: list[tuple[float, float]] = []
    told = {}
    for name, mean in zip(names, seen, strict=True):
        label = scores[name]["label"]
        clear = {n: round(float(x), 2) for n, x in zip(catalogue.names, mean, strict=True) if abs(x) > SHOWN}
        told[name] = {"kind": label["kind"], "effects": label["effects"], "asked for": clear}
        print(f"{label['kind']:8} {label['effects']}\n         asked for {clear}")
        if label["kind"] == "unknown":
            continue
        rests.append(mean - catalogue.expected(label["effects"]))
        parts += sizes(scores[name], catalogue, mean)
        sets = candidates(scores[name], catalogue.effects)
        true = list(sets).index(tuple(sorted(label["effects"])))
        speaks = np.array(
            [logsumexp([catalogue.log_evidence(mean, s, error) for error in ERRORS]) for s in sets]
        )
        for weight in WEIGHTS:
            both = np.log([*sets.values()]) + weight * speaks
            logs[weight].append(float(both[true] - logsumexp(both)))
    errors = dict(
        zip(catalogue.names, np.sqrt(np.mean(np.square(rests), axis=0)).round(3).tolist(), strict=True)
    )
    mixed = {f"{weight:g}": round(float(np.mean(values)), 3) for weight, values in logs.items()}
    print(f"root mean square error over {len(rests)} known cases: {errors}")
    print(f"mean log probability of the truth, with the equations heard by a weight of: {mixed}")
    answered, equations = np.median(parts, axis=0).round(2).tolist()
    print(
        f"of the true size of {len(parts)} named parameters the answer has {answered}, the equations {equations} "
        f"(medians)"
    )
    kept = {
        "machine": describe(),
        "cases": told,
        "errors": errors,
        "known": len(rests),
        "part of the true size": {"of": len(parts), "answer": answered, "equations": equations},
        "log score by weight": mixed,
    }
    (RESULTS / f"{given.set}_asked.json").write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
