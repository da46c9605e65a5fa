"""First experiment of the second diagnosis: does a bare joint fit measure every effect from trot and protocols?

python -m benchmarks.protocol_fit [--twins 40] [--practice 40] [--write]

Data of a twin of the independent generator (``benchmarks/blind/a1``): two trots at each of three commands and two runs of
each protocol. Unknown: θ (K,), every parameter of the catalogue in typical sizes, all of them at once. Model, for every
block p of data (a protocol, or the trot at one command):

    y_p = F_p(θ) + e_p,    e_p ~ N(0, s_p² n_p/N · diag(u_p²)),    θ_k ~ N(0, 0.6²)

y_p (n_p,) are features: means over 20 ms of a protocol's channels, or the features of ``s2r_spec.diagnose`` for a trot.
u_p (n_p,) is the unit of a feature: its scatter, a tenth of the effects' signatures, and what another time step or contact
model changes (the simulator's variants). s_p ≥ 1 is the model's discrepancy in a block, estimated from the rest of the
fit. N = 200 is the effective number of independent features in a block. F_p is the nominal simulator with the effects θ.

Estimator: Gauss–Newton with secants at a stated size, computed once (the bank), and F_p simulated at every iterate.

It prints the error of the estimate for each parameter over all twins, background included: rms, bias, slope of the
estimate on the truth, and correlation. And the rest of the fit, |y_p − F_p(θ̂)|²/n_p, of the twins against the 95 %
quantile of practice machines, which are the simulator itself with random effects.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.a1.cases import twin_of
from benchmarks.blind.a1.effects import KNOWN
from benchmarks.blind.a1.protocols import Bench
from benchmarks.blind.a1.rollout import Runner
from s2r_sim.backend import SimBackend
from s2r_spec.diagnose.axes import Line, lines
from s2r_spec.diagnose.features import Features, with_residuals
from s2r_spec.trace import Trace

RESULT = Path(__file__).parent / "results" / "protocol_fit.json"
SIM = SimBackend()
TROTS = {"trot -0.2": -0.2, "trot 0.05": 0.05, "trot 0.3": 0.3}
PROTOCOLS = tuple(protocol.name for protocol in SIM.protocols())
BLOCKS = (*TROTS, *PROTOCOLS)
LINES: dict[str, Line] = {line.name: line for line in lines(SIM.effects())}
NAMES = tuple(LINES)
PRIOR, EFFECTIVE, FORM, STEP = 0.6, 200.0, 0.1, 0.3
"""Prior standard deviation of θ, effective numbers of a block, form error of a signature, secant in typical sizes."""
FAR = {"torque_speed_line": 1.75, "ground_friction": 2.0, "shear_creep": 1.0}
"""Secants of effects with a threshold, below which they do nothing."""
BIN = 10
"""Samples of a mean over 20 ms."""
FLOORS = {
    "q": 0.01, "dq": 0.15, "tau": 0.15, "lag": 0.1, "z": 0.004, "x": 0.004, "y": 0.004, "roll": 0.004, "pitch": 0.004,
    "vx": 0.02, "vy": 0.02, "vz": 0.02, "foot_force": 2.0,
}  # fmt: skip
"""Differences that another author's laws may make, in each channel's unit; twice as much on the ground for torques."""


@dataclass(frozen=True)
class Block:
    """The bank of one block: base (n,), secants (K, n), units (n,), and which features are finite in all of them."""

    base: np.ndarray
    secants: np.ndarray
    unit: np.ndarray
    kept: np.ndarray


def binned(trace: Trace, name: str) -> np.ndarray:
    """Return (n,) means over 20 ms of a protocol's channels, in units of their floors."""
    ground = not name.startswith("air")
    channels = [
        "q",
        "dq",
        "tau",
        *(["z", "x", "y", "roll", "pitch", "vx", "vy", "vz", "foot_force"] if ground else []),
    ]
    values = {channel: trace[channel] for channel in channels} | {"lag": trace["tau"] - trace["tau_cmd"]}
    parts = []
    for channel, samples in values.items():
        whole = len(samples) // BIN * BIN
        means = samples[:whole].reshape(whole // BIN, BIN, -1).mean(axis=1)
        parts.append(
            (means / (FLOORS[channel] * (2.0 if ground and channel in ("tau", "lag") else 1.0))).ravel()
        )
    return np.concatenate(parts)


@cache
def features() -> Features:
    nominal = [
        with_residuals(SIM.rollout({"vd": vd}, k), SIM, {"vd": vd}) for vd in TROTS.values() for k in range(3)
    ]
    return Features.of_nominal(nominal, 1.5)


def simulated(
    values: Mapping[str, Mapping[str, float]], block: str, seeds: range, nominal: SimBackend = SIM
) -> np.ndarray | None:
    """Return (n,) mean features of the simulator with effects; None if it falls."""
    backend = nominal.with_effects(values) if values else nominal
    found = []
    for seed in seeds:
        if block in TROTS:
            test = {"vd": TROTS[block]}
            trace = backend.rollout(test, 1000 + seed)
            if trace.failure:
                return None
            found.append(features().vector(with_residuals(trace, SIM, test)))
        else:
            trace = backend.run(block, {}, 1000 + seed)
            if trace.failure:
                return None
            found.append(binned(trace, block))
    return np.mean(found, axis=0)


def effects(theta: np.ndarray) -> tuple[dict[str, dict[str, float]], np.ndarray]:
    """Return the effects of θ; and what of θ is left because a delay is a whole number of physics steps."""
    values: dict[str, dict[str, float]] = {}
    left = np.zeros(len(NAMES))
    for k, line in enumerate(LINES.values()):
        value = line.value(float(theta[k]))
        if line.name == "latency.delay":
            whole = round(max(value, 0.0) * 1000) / 1000
            left[k] = theta[k] - line.coordinate(whole)
            value = whole
        if abs(value - line.nominal) > 1e-12:
            values.setdefault(line.effect, {})[line.parameter] = value
    return values, left


def secant(line: Line) -> float:
    size = FAR.get(line.effect, STEP)
    up = line.values[-1] > line.nominal and line.effect not in (
        "motor_strength",
        "torque_constant",
        "ground_friction",
    )
    value = line.value(size if up else -size)
    if line.effect == "latency":
        value = 0.002
    return line.coordinate(value)


def column(job: tuple[str, str]) -> tuple[str, str, np.ndarray | None, float]:
    """Return the features of a block at a secant of one parameter, and the processor time."""
    block, name = job
    began = time.process_time()
    values, _ = effects(np.array([secant(LINES[name]) if name == one else 0.0 for one in NAMES]))
    return block, name, simulated(values, block, range(2)), time.process_time() - began


def bank(pool: Any) -> tuple[dict[str, Block], dict[str, float]]:
    cost = dict.fromkeys(BLOCKS, 0.0)
    columns: dict[tuple[str, str], np.ndarray | None] = {}
    for block, name, found, seconds in pool.map(column, [(b, n) for b in BLOCKS for n in NAMES], chunksize=4):
        columns[block, name] = found
        cost[block] += seconds
    made = {}
    for block in BLOCKS:
        runs = np.array([simulated({}, block, range(k, k + 1)) for k in range(8)])
        base, scatter = runs[:2].mean(axis=0), runs.std(axis=0, ddof=1)
        moved = np.array(
            [np.zeros_like(base) if columns[block, n] is None else columns[block, n] - base for n in NAMES]
        )
        secants = moved / np.array([secant(LINES[n]) for n in NAMES])[:, None]
        kept = np.isfinite(secants).all(axis=0) & np.isfinite(scatter)
        signature = np.sqrt(np.nanmean(moved**2, axis=0))
        others = [simulated({}, block, range(2), variant) for variant in SIM.variants().values()]
        form = np.sum([np.nan_to_num(other - base) ** 2 for other in others if other is not None], axis=0)
        floor = 0.0 if block in TROTS else 1.0  # protocols are in units of FLOORS
        unit = np.sqrt(scatter**2 / 2 + (FORM * signature) ** 2 + form + floor + 1e-12)
        made[block] = Block(base, secants, unit, kept)
    return made, cost


@dataclass(frozen=True)
class Fitted:
    theta: np.ndarray
    rest: dict[str, float]
    seconds: float


def fit(data: Mapping[str, np.ndarray], blocks: Mapping[str, Block], iterations: int = 4) -> Fitted:
    """Return the joint estimate from all blocks of data."""
    began = time.process_time()
    jacobians = {p: blocks[p].secants[:, blocks[p].kept] / blocks[p].unit[blocks[p].kept] for p in data}
    low = np.array([line.coordinate(line.low) for line in LINES.values()])
    high = np.array([line.coordinate(line.high) for line in LINES.values()])
    theta, best = np.zeros(len(NAMES)), None
    for _ in range(iterations):
        values, left = effects(theta)
        rest, residuals, fell = {}, {}, False
        for p in data:
            model = simulated(values, p, range(2 if p in TROTS else 1))
            if model is None:
                fell = True
                break
            block = blocks[p]
            residual = ((data[p] - model)[block.kept]) / block.unit[block.kept]
            residual = np.clip(np.nan_to_num(residual), -60, 60) - left @ jacobians[p]
            residuals[p] = residual
            rest[p] = float(residual @ residual) / residual.size
        # The discrepancy s_p² at its likeliest is the rest; the profile of the likelihood is then a logarithm.
        cost = float(theta @ theta) / PRIOR**2 + EFFECTIVE * sum(
            np.log(max(one, 1.0)) + min(one, 1.0) for one in rest.values()
        )
        if best is None or (not fell and cost < best[0]):
            best = (cost, theta, rest)
            weight = {p: EFFECTIVE / max(rest[p], 1.0) / jacobians[p].shape[1] for p in data}
            information = (
                sum(weight[p] * jacobians[p] @ jacobians[p].T for p in data) + np.eye(len(NAMES)) / PRIOR**2
            )
            gradient = sum(weight[p] * jacobians[p] @ residuals[p] for p in data) - theta / PRIOR**2
            theta = theta + np.linalg.solve(information, gradient)
        else:
            theta = best[1] + 0.5 * (theta - best[1])
        theta = np.clip(theta, np.maximum(low, -2.5), np.minimum(high, 2.5))
    assert best is not None
    return Fitted(best[1], best[2], time.process_time() - began)


def truth(values: Mapping[str, Mapping[str, float]]) -> np.ndarray:
    found = np.zeros(len(NAMES))
    for k, line in enumerate(LINES.values()):
        value = values.get(line.effect, {}).get(line.parameter)
        found[k] = 0.0 if value is None else line.coordinate(value)
    return found


def made_twin(number: int, seed: int) -> tuple[Any, list[str], dict[str, Mapping[str, float]]]:
    """Return a generator's twin, its causes, and every value, the background's too."""
    rng = np.random.default_rng([seed, number])
    count = (1, 2, 1, 0)[number % 4]
    causes = [str(name) for name in rng.choice(sorted(KNOWN), count, replace=False)]
    size = {}
    for name in causes:
        kind = KNOWN[name]
        most = max(kind.low, (1.0, 1.0, 0.8)[count] * kind.high)
        size[name] = float(np.exp(rng.uniform(np.log(kind.low), np.log(most))))
    own = int(rng.integers(2**62))
    twin, values = twin_of([KNOWN[name] for name in causes], size, own)
    # twin_of draws the background from the same stream: draw it once more to know it.
    stream = np.random.default_rng([own, 7])
    from benchmarks.blind.a1.model import made

    made(stream)
    background: dict[str, Mapping[str, float]] = {}
    for kind in KNOWN.values():
        amount, draws = 0.05 * kind.high * abs(stream.normal()), np.random.default_rng(stream.integers(2**62))
        if amount and kind.name not in size:
            background[kind.name] = kind.values(draws, amount)
    return twin, causes, {**background, **values}


def of_twin(job: tuple[int, int, dict[str, Block], bool]) -> dict[str, Any] | None:
    number, seed, blocks, apart = job
    twin, causes, values = made_twin(number, seed)
    runner, bench, data = Runner(twin), Bench(twin), {}
    for block in BLOCKS:
        found = []
        for k in range(2):
            rng = np.random.default_rng([seed, number, k, BLOCKS.index(block)])
            trace = runner.run(TROTS[block], rng) if block in TROTS else bench.run(block, rng)
            if trace.failure:
                continue
            in_units = with_residuals(trace, SIM, {"vd": TROTS[block]}) if block in TROTS else trace
            found.append(features().vector(in_units) if block in TROTS else binned(in_units, block))
        if found:
            data[block] = np.mean(found, axis=0)
    return _row(number, causes, truth(values), data, blocks, apart)


def of_practice(job: tuple[int, int, dict[str, Block]]) -> dict[str, Any] | None:
    """Fit the simulator itself, with the generator's mix of causes and background in typical sizes."""
    number, seed, blocks = job
    rng = np.random.default_rng([seed, number, 1])
    theta = 0.05 * rng.normal(size=len(NAMES))
    causes = [str(name) for name in rng.choice(NAMES, (1, 2, 1, 0)[number % 4], replace=False)]
    for name in causes:
        theta[NAMES.index(name)] = rng.uniform(0.25, 1.0) * (1 if secant(LINES[name]) > 0 else -1)
    for k, line in enumerate(LINES.values()):
        one_sided = line.low == line.nominal or line.high == line.nominal
        theta[k] = abs(theta[k]) * np.sign(secant(line)) if one_sided else theta[k]
    values, left = effects(theta)
    theta = theta - left
    data = {}
    for block in BLOCKS:
        seeds = int(rng.integers(10**6))
        found = simulated(values, block, range(seeds, seeds + 2))
        if found is not None:
            data[block] = found
    return _row(number, causes, theta, data, blocks, False)


def _row(
    number: int, causes: list[str], true: np.ndarray, data: Any, blocks: Any, apart: bool
) -> dict[str, Any] | None:
    if len(data) < 4:
        return None
    rows = {"both": data}
    if apart:
        rows["trot"] = {p: y for p, y in data.items() if p in TROTS}
        rows["protocols"] = {p: y for p, y in data.items() if p not in TROTS}
    fits = {which: fit(part, blocks) for which, part in rows.items() if part}
    return {
        "number": number,
        "causes": causes,
        "truth": true.tolist(),
        "fits": {which: one.theta.tolist() for which, one in fits.items()},
        "rest": fits["both"].rest,
        "seconds": fits["both"].seconds,
    }


def table(rows: list[dict[str, Any]], which: str) -> dict[str, dict[str, float]]:
    """Return parameter → error of the estimates over all twins, in typical sizes."""
    used = [row for row in rows if which in row["fits"]]
    true = np.array([row["truth"] for row in used])
    found = np.array([row["fits"][which] for row in used])
    errors = {}
    for k, name in enumerate(NAMES):
        t, e = true[:, k], found[:, k]
        spread = t.std() > 0 and e.std() > 0
        errors[name] = {
            "rms": float(np.sqrt(np.mean((e - t) ** 2))),
            "bias": float(np.mean(e - t)),
            "slope": float(t @ e / (t @ t)) if t.any() else float("nan"),
            "correlation": float(np.corrcoef(t, e)[0, 1]) if spread else float("nan"),
            "zero": float(np.sqrt(np.mean(t**2))),
        }
    return errors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--twins", type=int, default=40)
    parser.add_argument("--practice", type=int, default=40)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=46)
    parser.add_argument("--apart", action="store_true", help="also fit trots alone, and protocols alone")
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"
    with ProcessPoolExecutor(given.workers) as pool:
        blocks, cost = bank(pool)
        print(
            "bank, processor seconds for each block:", {p: round(s, 1) for p, s in cost.items()}, flush=True
        )
        jobs = [(k, given.seed, blocks, given.apart) for k in range(given.twins)]
        twins = []
        for row in pool.map(of_twin, jobs):
            twins += [row] if row else []
            print(len(twins), row and row["causes"], row and row["rest"], flush=True)
        print(f"{len(twins)} of {given.twins} twins stayed upright in at least four blocks", flush=True)
        practice = [
            row
            for row in pool.map(of_practice, [(k, given.seed, blocks) for k in range(given.practice)])
            if row
        ]
    result: dict[str, Any] = {"bank_seconds": cost, "twins": twins, "practice": practice}
    for which in ("trot", "protocols", "both") if given.apart else ("both",):
        errors = table(twins, which)
        result[f"errors, {which}"] = errors
        print(f"\n{which}: median rms {np.median([one['rms'] for one in errors.values()]):.3f} of typical")
        for name, one in sorted(errors.items(), key=lambda item: -item[1]["rms"]):
            print("  ", f"{name:28}", "  ".join(f"{key} {value:+.3f}" for key, value in one.items()))
    if practice:
        for p in BLOCKS:
            quantile = float(np.quantile([row["rest"].get(p, 0.0) for row in practice], 0.95))
            alarms = sum(row["rest"].get(p, 0.0) > quantile for row in twins)
            print(f"rest of {p}: practice 95 % {quantile:.2f}, {alarms} of {len(twins)} twins beyond it")
        own = table(practice, "both")
        print(f"practice machines, both: median rms {np.median([one['rms'] for one in own.values()]):.3f}")
    print(
        "seconds of processor a fit, median:", round(float(np.median([row["seconds"] for row in twins])), 1)
    )
    if given.write:
        RESULT.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
