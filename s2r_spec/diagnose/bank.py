"""The bank: what every effect of the catalogue does, simulated once and kept on disk."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import combinations, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Effect, HasResiduals, HasVariants
from s2r_spec.diagnose.axes import BACKGROUND, STEPS, Line, Values, lines
from s2r_spec.diagnose.axes import line as line_of
from s2r_spec.diagnose.cache import Cache, source_of
from s2r_spec.diagnose.design import grid
from s2r_spec.diagnose.equations import LITTLE, Equations, Probe
from s2r_spec.diagnose.features import Block, Features
from s2r_spec.diagnose.simulate import Bench, Job, Test, blamed, run_jobs
from s2r_spec.effects import catalogue_of
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

Progress = Callable[[str, int, int], None]
"""Called with (stage, done, of) now and then; ``of`` is 0 where nobody knows."""

VERSION = 1
NOMINAL_SEEDS = 12
EFFECT_SEEDS = 1
"""Common random numbers make one rollout enough: it is compared with the nominal one of the same seed."""
VARIANT_SEEDS = 2
STRONG = 0.5
"""Part of every regressor that instruments must hold: weak ones are worse than none."""
SAME = 0.95
"""Part of a residual of each and every machine that the same coordinates explain if they stand for no model at all."""
NOTHING = 1e-6
"""A residual is none if its mean square is less than this part of the largest machine's."""
AGREE = 0.01
"""Such coordinates that differ by no more, in parts of themselves, are the same at all tests."""
REACHED = 2.0
"""Coordinate of what shows in no nominal motion, such as a limit, if it is there: it is reached where it is far off."""
PAIR_TESTS = 3
"""Tests, spread over the space, at which pairs are simulated together, once each."""


@dataclass(frozen=True)
class Bank:
    """ρ and features of the nominal simulator and of every effect, over the test space.

    Column 0 of the last axis is ρ, the others are the features.

    Attributes:
        tests: m of them.
        nominal: (m, seeds, 1 + p).
        lines: of the catalogue.
        changes: per line (values, m, 1 + p): mean change from nominal, of the same seeds.
        pairs: lines that were simulated together, at their typical values.
        pair_tests: places in ``tests`` where that was done.
        variants: (variants, m, 1 + p): mean change when the same physics is computed otherwise.
        weights: (m, q, q) by which the q coordinates that the equations of motion ask for count at each test.
        interactions: (pairs, pair tests, 1 + p): what is left when both single changes are taken off.
    """

    features: Features
    tests: tuple[Test, ...]
    nominal: FloatArray
    lines: tuple[Line, ...]
    changes: tuple[FloatArray, ...]
    pairs: tuple[tuple[int, int], ...]
    pair_tests: tuple[int, ...]
    interactions: FloatArray
    variants: FloatArray
    weights: FloatArray


def key(bench: Bench) -> str:
    """Return the hash by which a bank is found on disk: of model, spec, catalogue and this format."""
    effects = catalogue_of(bench.backend)
    what = {
        "version": VERSION,
        "backend": bench.backend.name,
        "model": bench.backend.model_hash,
        "spec": bench.spec.hash,
        "requirement": bench.requirement,
        "duration": bench.backend.duration,
        "effects": [
            (e.name, [(p.name, p.low, p.high, p.nominal, p.prior) for p in e.parameters]) for e in effects
        ],
        "variants": sorted(bench.backend.variants()) if isinstance(bench.backend, HasVariants) else [],
        "source": _source(),
        # A model's hash says what its rollouts are; its residuals are of other source, which it may leave out.
        "residuals": source_of(type(bench.backend)) if isinstance(bench.backend, HasResiduals) else "",
    }
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()


def _source() -> str:
    """Return a hash of the modules that decide what a bank holds: features of rollouts, and ρ."""
    folder = Path(__file__).parent
    digest = hashlib.sha256()
    own = [folder / f"{name}.py" for name in ("axes", "bank", "design", "equations", "features", "simulate")]
    of_rho = [
        path for name in ("lang", "robustness") for path in sorted((folder.parent / name).rglob("*.py"))
    ]
    own.append(folder / "simulator" / "experiments.py")
    for path in (*own, *of_rho, folder.parent / "rollouts" / "compatibility.py"):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def bank(
    bench: Bench,
    executor: Callable[[], Executor] | None = None,
    progress: Progress | None = None,
    cache: Cache | None = None,
) -> Bank:
    """Return the bank of a simulator, from disk if it is there.

    Raises:
        UsageError: the backend declares no effects.
    """
    kept = (cache or Cache.usual()).kept
    return kept(f"banks/{key(bench)}.npz", load, lambda: simulate(bench, executor, progress), save)


def simulate(
    bench: Bench,
    executor: Callable[[], Executor] | None = None,
    progress: Progress | None = None,
) -> Bank:
    """Simulate every line of the catalogue over the test space, with common random numbers."""
    tell = progress or (lambda stage, done, of: None)
    tests = tuple(grid(bench.spec.space))
    middle = tests[len(tests) // 2]
    tell("trying each effect", 0, 0)
    traces = [
        bench.seen(bench.run({}, test, seed), test) for seed, test in enumerate((tests[0], middle, tests[-1]))
    ]
    features = Features.of_nominal(traces, bench.backend.duration)
    bench = replace(bench, features=features)
    catalogue = catalogue_of(bench.backend)
    three = tuple({place: tests[place] for place in (len(tests) // 2, 0, len(tests) - 1)}.values())
    acts = {}
    for done, effect in enumerate(catalogue):
        tell("trying each effect", done, len(catalogue))
        acts[effect.name] = _able(bench, effect, three)
    found = lines(catalogue, acts)
    tell("evaluating the equations of motion", 0, 0)
    probes, idle = _probes(bench, found, middle, three)
    features = replace(features, probes=probes)
    # What shows in some machines only takes no part in what explains all of them.
    voids = _voids(bench, features, found, three, executor)
    voids = {name: [*g, *[0.0] * len(idle)] for name, g in voids.items()}
    features = replace(features, probes=(*probes, *idle), voids=voids)
    features = replace(features, little=_little(bench, features, found, middle))
    features = replace(features, instrumented=_instrumented(bench, features, three))
    bench = replace(bench, features=features)

    runs = _runs(tests, EFFECT_SEEDS)
    jobs = [Job({}, _runs(tests, NOMINAL_SEEDS, [place])) for place in range(len(tests))]
    jobs += [Job(line.at(value), runs) for line in found for value in line.values]
    pairs, pair_tests = _pairs(found), _pair_tests(len(tests))
    both = _runs(tests, 1, pair_tests)
    jobs += [
        Job(found[i].at(found[i].at_typical()) | found[j].at(found[j].at_typical()), both) for i, j in pairs
    ]
    others = tuple(bench.backend.variants()) if isinstance(bench.backend, HasVariants) else ()
    several = _runs(tests, VARIANT_SEEDS)
    jobs += [Job({}, several, name) for name in others]
    rows = run_jobs(bench, jobs, executor, lambda done, of: tell("simulating effects", done, of))

    m = len(tests)
    nominal = np.stack(rows[:m])
    same = nominal[:, :EFFECT_SEEDS]
    changes, at = [], m
    for line in found:
        block = np.stack(rows[at : at + len(line.values)]).reshape(len(line.values), m, EFFECT_SEEDS, -1)
        changes.append(_mean_change(block, same))
        at += len(line.values)
    interactions = np.zeros((len(pairs), len(pair_tests), nominal.shape[-1]))
    for number, (i, j) in enumerate(pairs):
        together = rows[at + number] - nominal[list(pair_tests), 0]
        alone = sum(_typical(found[k], changes[k])[list(pair_tests)] for k in (i, j))
        interactions[number] = together - alone
    at += len(pairs)
    computed = [
        _mean_change(block.reshape(m, VARIANT_SEEDS, -1)[None], nominal[:, :VARIANT_SEEDS])[0]
        for block in rows[at:]
    ]
    return Bank(
        features,
        tests,
        nominal,
        found,
        tuple(changes),
        pairs,
        pair_tests,
        interactions,
        np.array(computed).reshape(len(computed), m, nominal.shape[-1]),
        bench.weights(tests),
    )


def _runs(
    tests: Sequence[Test], seeds: int, places: Sequence[int] | None = None
) -> tuple[tuple[Test, int], ...]:
    """Return so many runs at each of these places among the tests: the first of each place's own random numbers.

    Were they the same at all tests, one draw of uneven ground would be what uneven ground does on average.
    """
    some = range(len(tests)) if places is None else places
    return tuple((tests[place], place * NOMINAL_SEEDS + seed) for place in some for seed in range(seeds))


def _able(bench: Bench, effect: Effect, tests: Sequence[Test]) -> frozenset[str]:
    """Return the parameters that change something at one of these tests while the effect's others are nominal.

    The place of a payload does nothing while its mass is nothing. Of an effect that does nothing at any of them, as a
    limit that is not reached, it is not known: all may act by themselves.
    """
    names = frozenset(p.name for p in effect.parameters)
    if len(names) == 1:
        return names
    able: set[str] = set()
    for test in tests:
        nominal = bench.measure(bench.run({}, test, 0), test)
        for parameter in effect.parameters:
            if parameter.name not in able:
                alone = line_of(effect, parameter)
                changed = bench.measure(bench.run(alone.at(alone.at_typical()), test, 0), test)
                if not np.array_equal(changed, nominal, equal_nan=True):
                    able.add(parameter.name)
    return frozenset(able) or names


def _little(bench: Bench, features: Features, found: tuple[Line, ...], test: Test) -> FloatArray:
    """Return (columns,) what a little of every effect makes of the residuals that the equations do not explain.

    By proportion from the typical value, or from the largest part of it with which the test is survived. In the
    features' scale.
    """
    if not features.probes:
        return features.little
    asked = features.asked(bench.backend)
    squares = {name: np.zeros_like(unit) for name, unit in asked.units.items()}
    for line in found:
        typical = line.coordinate(line.at_typical())
        for far in () if line.base else [part * typical for part in reversed(STEPS)]:
            values = line.at(line.value(far))
            with blamed(bench, values, test, 0):
                trace = bench.run(values, test, 0)
            left = asked.left(trace, bench.matched.to_backend(test)) if trace.failure is None else None
            if left is not None:
                for name, rms in left.items():
                    squares[name] += (BACKGROUND / far * rms) ** 2
                break
    return features.of_residuals({name: np.sqrt(s) for name, s in squares.items()})


def _probes(
    bench: Bench, found: tuple[Line, ...], middle: Test, tests: Sequence[Test]
) -> tuple[tuple[Probe, ...], tuple[Probe, ...]]:
    """Return the lines that change the residuals of a nominal motion at the middle test, and the idle ones.

    An idle one does so in a motion of the simulator that has its own effect, at one of the tests.
    """
    units = {} if bench.features is None else bench.features.residual_units()
    if not isinstance(bench.backend, HasResiduals) or not units:
        return (), ()

    def moved(values: Values, test: Test) -> Trace:
        with blamed(bench, values, test, 0):
            return bench.run(values, test, 0)

    def shows(probe: Probe, trace: Trace, test: Test) -> bool | None:
        if trace.failure is not None:
            return False
        seen = Equations(bench.backend, (probe,), units).regressors(trace, bench.matched.to_backend(test))
        return None if seen is None else bool(np.any(seen[1]))

    def probe_at(line: Line, value: float) -> Probe:
        return Probe(line.effect, line.parameter, value, line.coordinate(value))

    nominal = moved({}, middle)
    probes, idle = [], []
    for line in found:
        probe = probe_at(line, line.at_typical())
        # An effect of which the equations cannot even be asked of such a motion would silence all others.
        seen = None if line.base else shows(probe, nominal, middle)
        if seen:
            probes.append(probe)
        elif seen is False:
            sizes = sorted(line.values, key=lambda value: abs(abs(line.coordinate(value)) - REACHED))
            shown = (
                replace(one, idle=True)
                for one in map(partial(probe_at, line), sizes)
                if any(shows(one, moved(line.at(one.value), test), test) for test in tests)
            )
            idle += [*islice(shown, 1)]
    return tuple(probes), tuple(idle)


def _voids(
    bench: Bench,
    features: Features,
    found: tuple[Line, ...],
    tests: Sequence[Test],
    executor: Callable[[], Executor] | None,
) -> dict[str, list[float]]:
    """Return the residuals that a model without mass and motors explains, and g that tells how much is left of a model.

    At each test such a model has the coordinates by which the equations explain every machine, whatever its effects.
    See :mod:`s2r_spec.diagnose.equations`.
    """
    if not features.probes:
        return {}
    names, p = list(features.residual_units()), len(features.probes)
    machines = [line.at(value) for line in found for value in (line.values[0], line.values[-1])]
    jobs = [Job(values, tuple((test, k) for test in tests)) for k, values in enumerate(machines)]
    rows = np.array(run_jobs(replace(bench, features=features), jobs, executor, read=_moments))
    by_test = rows.reshape(len(jobs), len(tests), len(names), -1).transpose(2, 1, 0, 3)
    known = [[_shown(of_test) for of_test in of_name] for of_name in by_test]
    moved = [
        np.any([_regressors(each, p).sum(axis=0) > LITTLE for each in of_name], axis=0) for of_name in known
    ]
    out = {}
    for k, (name, of_name) in enumerate(zip(names, known, strict=True)):
        # Of an effect that another residual knows, too, that one says how large it is.
        elsewhere = any(np.any(moved[k] & other) for j, other in enumerate(moved) if j != k)
        nothing = [_nothing(each, p) for each in of_name if 2 * len(each) >= len(jobs)]
        there = [x for x in nothing if x is not None]
        if len(there) == len(tests) and not elsewhere:
            g = np.linalg.lstsq(np.array(there), np.ones(len(there)), rcond=AGREE)[0]
            if np.allclose(np.array(there) @ g, 1.0, atol=1.0 - SAME):
                out[name] = g.tolist()
    return out


def _shown(moments: FloatArray) -> FloatArray:
    """Return those of (machines, 1 + p + p²) that show in a residual, in parts of its mean square."""
    finite = moments[np.isfinite(moments).all(axis=1)]
    some = finite[finite[:, 0] > NOTHING * finite[:, 0].max(initial=0.0)]
    return np.asarray(some / some[:, :1])


def _regressors(moments: FloatArray, p: int) -> FloatArray:
    """Return (machines, p) mean squares of the regressors."""
    return moments[:, 1 + p :: p + 1]


def _nothing(moments: FloatArray, p: int) -> FloatArray | None:
    """Return (p,) the coordinates that explain a residual of every one of (machines, 1 + p + p²), if there are any."""
    toward, grams = moments[:, 1 : 1 + p], moments[:, 1 + p :].reshape(-1, p, p)
    x = np.linalg.lstsq(grams.sum(axis=0), toward.sum(axis=0), rcond=1e-9)[0]
    left = 1.0 - 2.0 * toward @ x + np.einsum("i,kij,j->k", x, grams, x)
    return x if len(moments) > 1 and left.max() < 1.0 - SAME else None


def _moments(bench: Bench, trace: Trace, test: Test) -> FloatArray:
    """Return (residuals · (1 + p + p²),) mean products of each nominal residual and its p regressors, or NaN."""
    assert bench.features is not None
    asked = bench.features.asked(bench.backend)
    p = len(asked.probes)
    motion = asked.motion(trace, bench.matched.to_backend(test)) if trace.failure is None else None
    if motion is None:
        return np.full(len(asked.units) * (1 + p + p * p), np.nan)
    out: list[FloatArray] = []
    for bare, taken in zip(motion.rest, motion.taken, strict=True):
        there = np.isfinite(bare)
        both = np.vstack([bare[there], taken[:, there]])
        gram = both @ both.T / both.shape[1]
        out += [gram[0], gram[1:, 1:].ravel()]
    return np.concatenate(out)


def _instrumented(bench: Bench, features: Features, tests: Sequence[Test]) -> bool:
    """Return whether nominal rollouts hold most of every regressor that there is of another one at the same test."""
    if not features.probes:
        return False
    whole = held = np.zeros(len(features.probes))
    for test in tests:
        instruments = bench.nominal_motion(features, test)
        if instruments is None:
            return False
        with blamed(bench, {}, test, 0):
            trace = bench.run({}, test, 0)
        own, theirs = features.asked(bench.backend).strength(
            trace, bench.matched.to_backend(test), instruments
        )
        whole, held = whole + own, held + theirs
    return bool(np.all((held >= STRONG * whole) | (whole < LITTLE * len(tests))))


def _mean_change(rows: FloatArray, nominal: FloatArray) -> FloatArray:
    """Return (values, m, 1 + p) mean differences of (values, m, seeds, 1 + p) from (m, seeds, 1 + p).

    Where every rollout fell before a feature could be read it is NaN.
    """
    difference = rows - nominal
    counts = np.isfinite(difference).sum(axis=2)
    total = np.where(np.isfinite(difference), difference, 0.0).sum(axis=2)
    return np.where(counts > 0, total / np.maximum(counts, 1), np.nan)


def _typical(found: Line, change: FloatArray) -> FloatArray:
    """Return (m, 1 + p): the change at the line's typical value, which is one of its values."""
    typical: FloatArray = change[int(np.argmin(np.abs(np.array(found.values) - found.at_typical())))]
    return typical


def _pairs(found: tuple[Line, ...]) -> tuple[tuple[int, int], ...]:
    """Return the pairs that are simulated together: the first lines of any two effects."""
    first: dict[str, int] = {}
    for number, one in enumerate(found):
        first.setdefault(one.effect, number)
    return tuple(combinations(first.values(), 2))


def _pair_tests(count: int) -> tuple[int, ...]:
    return tuple(sorted({int(i) for i in np.linspace(0, count - 1, min(PAIR_TESTS, count)).round()}))


def save(made: Bank, path: Path) -> None:
    """Write a bank as one NPZ file."""
    f = made.features
    text = json.dumps(
        {
            "version": VERSION,
            "duration": f.duration,
            "blocks": [asdict(b) for b in f.blocks],
            "flags": dict(f.flags),
            "products": f.products,
            "rates": f.rates,
            "probes": [asdict(p) for p in f.probes],
            "voids": dict(f.voids),
            "instrumented": f.instrumented,
            "tests": [dict(t) for t in made.tests],
            "lines": [asdict(one) for one in made.lines],
            "pairs": made.pairs,
            "pair_tests": made.pair_tests,
        }
    )
    changes = {f"change{i}": change for i, change in enumerate(made.changes)}
    np.savez(
        path,
        text=np.array(text),
        scale=f.scale,
        reference=f.reference,
        pace=f.pace,
        little=f.little,
        nominal=made.nominal,
        interactions=made.interactions,
        variants=made.variants,
        weights=made.weights,
        **changes,  # type: ignore[arg-type]
    )


def load(path: Path) -> Bank:
    """Read what :func:`save` wrote.

    Raises:
        ValueError: it is something else; other errors where it is no archive, or lacks parts.
    """
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        text = json.loads(str(arrays["text"]))
        features = Features(
            text["duration"],
            tuple(Block(**b) for b in text["blocks"]),
            arrays["scale"],
            arrays["reference"],
            text["flags"],
            tuple((a, b) for a, b in text["products"]),
            tuple((a, b) for a, b in text["rates"]),
            arrays["pace"],
            arrays["little"],
            tuple(Probe(**p) for p in text["probes"]),
            text["voids"],
            text["instrumented"],
        )
        found = tuple(Line(**(one | {"values": tuple(one["values"])})) for one in text["lines"])
        read = Bank(
            features,
            tuple(text["tests"]),
            arrays["nominal"],
            found,
            tuple(arrays[f"change{i}"] for i in range(len(found))),
            tuple((i, j) for i, j in text["pairs"]),
            tuple(text["pair_tests"]),
            arrays["interactions"],
            arrays["variants"],
            arrays["weights"],
        )
    m, p = len(read.tests), 1 + len(features.names())
    shapes = {
        "nominal": (read.nominal.shape, (m, NOMINAL_SEEDS, p)),
        "interactions": (read.interactions.shape, (len(read.pairs), len(read.pair_tests), p)),
        "variants": (read.variants.shape, (len(read.variants), m, p)),
        **{f"change{i}": (c.shape, (len(found[i].values), m, p)) for i, c in enumerate(read.changes)},
    }
    if wrong := [name for name, (is_, should) in shapes.items() if is_ != should]:
        raise ValueError(f"the bank has {wrong[0]} of another shape than its tests and features say")
    return read
