"""Diagnose: from real rollouts and a simulator with a catalogue of effects to an answer."""

from __future__ import annotations

import hashlib
import math
import os
import pickle
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend, HasDuration, load_backend
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.ask import FEWEST, Rollouts, real_rollouts
from s2r_spec.diagnose.design import unit_box
from s2r_spec.diagnose.diagnosis import Diagnosis, Verdict, Which
from s2r_spec.diagnose.estimate import fit
from s2r_spec.diagnose.evidence import BACKGROUND, Evidence, Linear, believed, evidence, linear
from s2r_spec.diagnose.how_far import HowFar, how_far
from s2r_spec.diagnose.isolability import isolability
from s2r_spec.diagnose.joint import joint_fit
from s2r_spec.diagnose.judge import Judge, Sets, describe, train
from s2r_spec.diagnose.layout import SHOTS as NOMINAL_SHOTS
from s2r_spec.diagnose.layout import Layout
from s2r_spec.diagnose.models import Catalogue, Simulator, Surrogate, nominal_rows
from s2r_spec.diagnose.next_test import next_test
from s2r_spec.diagnose.signatures import Signatures
from s2r_spec.diagnose.simulate import Bench, Job, Test, run_jobs
from s2r_spec.diagnose.where.found import Where
from s2r_spec.diagnose.where.found import where as find_where
from s2r_spec.errors import UsageError
from s2r_spec.rollouts.match import match
from s2r_spec.rollouts.pools import kept_open
from s2r_spec.rollouts.seeds import Stream, rollout_seed
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

HELD_OUT = 0.3
"""Part of the tests that the diagnosis does not see."""
SHOTS = 3
"""Simulated rollouts per held-out test, before and after."""
SOURCES = (
    "axes", "design", "evidence", "joint", "judge", "layout", "logs", "models", "practice", "signatures",
)  # fmt: skip
"""Modules on which a judge depends."""
SURE = 0.9
FREE = 5
"""Degrees of freedom from which on replicates say how much a machine scatters."""
IMITATED = 0.1
"""An unknown cause is so much less likely once a patch has closed the held-out gap, or if there is none."""


def diagnose(
    spec: Spec,
    sim: Backend | str,
    real: Rollouts | Backend | str,
    budget: int | None = None,
    *,
    requirement: str | None = None,
    seed: int = 0,
    executor: Callable[[], Executor] | None = None,
    progress: Progress | None = None,
    cache: Path | None = None,
    folder: Path | None = None,
    where: bool = True,
) -> Diagnosis:
    """Say where a sim-to-real gap lies, which unmodelled effect causes it, and how far it shrinks.

    Args:
        spec: what is required, and over which tests.
        sim: the simulator; it must declare effects.
        real: (test in the spec's units, trace) of each real rollout, or a backend: a folder of
            recordings, or a machine, which is then asked for ``budget`` tests spread over the space.
        budget: at most so many real rollouts.
        requirement: the one to look at; the spec's first if not given.
        seed: fixes everything that is drawn.
        executor: makes a pool for the simulations; None runs them here.
        progress: is told (stage, done, of) now and then.
        cache: folder for what is simulated and learnt once; the user's cache folder if not given.
        folder: where rollouts that are asked of a machine are kept, each before the next begins; a
            second call goes on from what is there.
        where: also say where the gap lies in tests, time, formula and body.

    Raises:
        UsageError: scikit-learn is not installed, the simulator declares no effects, or the
            rollouts do not fit the spec.
    """
    if find_spec("sklearn") is None:
        raise UsageError(
            "a diagnosis needs scikit-learn, which is not installed: pip install 's2r[diagnose]'"
        )
    name = spec.requirements[0] if requirement is None else requirement
    bench = _bench(spec, name, sim)
    tell = progress or (lambda stage, done, of: None)
    bank = banks.bank(bench, executor, lambda done, of: tell("simulating effects", done, of), cache)
    bench = replace(bench, features=bank.features)
    # The bank comes first: a simulator that cannot be diagnosed costs no rollout of the machine.
    rollouts = real_rollouts(bench, real, budget, seed, folder, lambda n, of: tell("real rollouts", n, of))
    seen, held = _split(rollouts, seed)
    with kept_open(executor) as pool:
        state = _prepare(bench, bank, seen, seed, cache, pool, tell)
        return _answer(bench, state, seen, held, seed, pool, tell, where)


@dataclass(frozen=True)
class _State:
    """What one set of real rollouts gives rise to."""

    signatures: Signatures
    layout: Layout
    surrogate: Surrogate
    nuisances: FloatArray
    judge: Judge
    data: Linear
    found: Evidence
    sets: Sets
    unknown: float


def _bench(spec: Spec, requirement: str, sim: Backend | str) -> Bench:
    backend = load_backend(sim) if isinstance(sim, str) else sim
    horizon = spec.horizon(requirement)
    if isinstance(backend, HasDuration) and math.isfinite(horizon) and horizon > 0:
        backend = backend.with_duration(horizon)
    banks.catalogue_of(backend)
    return Bench(backend, spec, requirement, match(spec, requirement, backend))


def _split(
    rollouts: list[tuple[dict[str, float], Trace]], seed: int
) -> tuple[list[tuple[dict[str, float], Trace]], list[tuple[dict[str, float], Trace]]]:
    """Return the rollouts to diagnose with, and those held out: whole tests, drawn at random."""
    keys = list(dict.fromkeys(tuple(sorted(test.items())) for test, _ in rollouts))
    count = round(HELD_OUT * len(keys))
    if count < 3 or len(rollouts) < 2 * FEWEST:
        if len(keys) > 1:
            return rollouts, []
        # One test alone: rollouts of it are all there is to hold out.
        count = round(HELD_OUT * len(rollouts))
        return (rollouts[count:], rollouts[:count]) if count >= 3 else (rollouts, [])
    picked = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7,))).permutation(len(keys))[
        :count
    ]
    out = {keys[i] for i in picked}
    seen = [r for r in rollouts if tuple(sorted(r[0].items())) not in out]
    held = [r for r in rollouts if tuple(sorted(r[0].items())) in out]
    return seen, held


def _prepare(
    bench: Bench,
    bank: banks.Bank,
    seen: list[tuple[dict[str, float], Trace]],
    seed: int,
    cache: Path | None,
    executor: Callable[[], Executor] | None,
    tell: Progress,
) -> _State:
    rows = np.array([bench.measure(trace, test) for test, trace in seen])
    complete = np.array([trace.failure is None for _, trace in seen])
    usable = rows[complete] if complete.any() else rows
    available = np.isfinite(usable).mean(axis=0) > 0.5
    signatures = Signatures.of(bank, available)
    judge = _judge(bench, signatures, available, seed, cache, tell)
    tests = [test for test, _ in seen]
    layout = Layout.of(bench.spec.space, bank.tests, tests)
    tell("the simulator at the real tests", 0, 1)
    nominal = nominal_rows(bench, layout.tests, NOMINAL_SHOTS, executor)
    level = np.nanmean(nominal, axis=0)
    components = signatures.components(rows, level[layout.place][:, signatures.kept])
    layout = Layout.of(bench.spec.space, bank.tests, tests, _inflation(layout, components, signatures))
    data = layout.project @ layout.mean(components)
    variance = believed(layout.scatter, signatures.noise, data)
    catalogue = Catalogue.of(signatures.curves)
    surrogate = Surrogate(catalogue, layout.through)
    begin = surrogate.turned(data, variance)
    simulator = Simulator(bench, signatures, surrogate, layout, nominal[0], executor)
    tell("fitting the whole catalogue", 0, 1)
    fitted = joint_fit(simulator, data, variance, begin, surrogate.jacobian(begin))
    nuisances = np.einsum("qm,vmk->vqk", layout.through, signatures.numerics)
    plain = linear(
        catalogue.effects,
        catalogue.owner,
        catalogue.based,
        catalogue.side,
        fitted,
        data,
        variance,
        nuisances,
    )
    found = evidence(plain)
    p = judge.memberships(describe(data)[None])[0]
    sets = judge.sets(found, p)
    return _State(
        signatures, layout, surrogate, nuisances, judge, plain, found, sets, judge.unknown(found, p)
    )


def _inflation(layout: Layout, components: FloatArray, signatures: Signatures) -> float:
    """Return how much more the real rollouts of one test scatter than the simulator's do, at least 1."""
    squares, free = layout.scattered(components)
    if free < FREE:
        return 1.0
    return float(np.clip(squares.sum() / max(float(np.trace(signatures.noise)), 1e-12), 1.0, 50.0))


def _judge(
    bench: Bench,
    signatures: Signatures,
    available: NDArray[np.bool_],
    seed: int,
    cache: Path | None,
    tell: Progress,
) -> Judge:
    """Return the judge of this bank and these columns, from disk if it was trained before."""
    digest = hashlib.sha256(banks.key(bench).encode() + available.tobytes() + str(seed).encode())
    for name in SOURCES:
        digest.update((Path(__file__).parent / f"{name}.py").read_bytes())
    digest.update(f"{version('scikit-learn')} {version('numpy')}".encode())
    root = (cache or banks.cache_folder()) / "judges"
    path = root / f"{digest.hexdigest()}.pkl"
    if path.exists():
        return pickle.loads(path.read_bytes())  # type: ignore[no-any-return]
    made = train(
        signatures, bench.spec.space, seed=seed, progress=lambda done, of: tell("practising", done, of)
    )
    root.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.part")
    part.write_bytes(pickle.dumps(made))
    part.replace(path)
    return made


def _answer(
    bench: Bench,
    state: _State,
    seen: list[tuple[dict[str, float], Trace]],
    held: list[tuple[dict[str, float], Trace]],
    seed: int,
    executor: Callable[[], Executor] | None,
    tell: Progress,
    want_where: bool,
) -> Diagnosis:
    effects = state.judge.effects
    ranked = state.sets.ranked()
    first_none = not ranked[0][0]
    named = next(members for members, _ in ranked if members)
    fitted = fit(state.data, state.surrogate.catalogue, named, state.judge.weights.temperature)
    far = _how_far(bench, state, held, {} if first_none else fitted.values, seed, executor, tell)

    unknown = state.unknown
    alarm = unknown > state.judge.threshold and not first_none
    # A material gap with nothing to name for it is as open as one that its patch leaves.
    open_gap = far is not None and (far.open or (first_none and far.material))
    if far is not None and (far.closed or not far.material):
        # Odd traces alone are no unknown cause of a gap that is explained, or that is not there:
        # every machine differs from its simulator in ways that nobody asked about.
        alarm, unknown = False, unknown * IMITATED
        # Below what a little of everything makes, only a sure name is a name, or one that closes the gap.
        first_none = first_none or not (far.material or far.gone or ranked[0][1] >= SURE)
    if open_gap:
        # The patch does not close the gap that it should explain: at least as likely unknown as not.
        unknown = max(unknown, 0.5 + 0.5 * unknown)
    names = {members: tuple(effects[k] for k in members) for members in state.sets.members}
    known = 1.0 - unknown
    by_size: dict[int, dict[tuple[str, ...], float]] = {0: {}, 1: {}, 2: {}, 3: {}}
    for members, probability in zip(state.sets.members, state.sets.probability, strict=True):
        by_size[len(members)][names[members]] = known * float(probability)

    isolable = isolability(state.surrogate, state.layout.scatter, state.signatures.noise, state.nuisances)
    confounded = _confounded(isolable, names[named], by_size)
    verdict = Verdict.NAMED
    if alarm or open_gap:
        verdict = Verdict.UNKNOWN
    elif first_none:
        verdict = Verdict.NONE
    elif len(confounded) > len(named):
        verdict = Verdict.CONFOUNDED
    answer = () if verdict in (Verdict.NONE, Verdict.UNKNOWN) else names[named]
    upcoming = None
    if verdict is not Verdict.NONE and ranked[0][1] * known < SURE:
        upcoming = _next(bench, state, ranked, tell)
    families = {e.name: e.family for e in banks.catalogue_of(bench.backend)}
    which = Which(
        none=by_size[0][()],
        unknown=unknown,
        singles={n[0]: p for n, p in by_size[1].items()},
        pairs=by_size[2],
        triples=by_size[3],
        answer=answer,
        confounded=confounded if verdict is not Verdict.NONE else (),
        estimates=() if verdict is Verdict.NONE else fitted.estimates,
        nearest_family=families[names[named][0]],
        isolability=isolable,
        next_test=upcoming,
    )
    return Diagnosis(
        verdict=verdict,
        reason=_reason(verdict, which, far, names[named]),
        where=_where(bench, seen + held, seed, tell) if want_where else None,
        which=which,
        how_far=far,
        patch=fitted.values if answer else {},
        provenance={
            "s2r": version("s2r"),
            "seed": seed,
            "spec_hash": bench.spec.hash,
            "requirement": bench.requirement,
            "backend": bench.backend.name,
            "model_hash": bench.backend.model_hash,
            "rollouts": len(seen) + len(held),
            "held_out": len(held),
            "judge": {name: round(value, 4) for name, value in state.judge.practice.items()},
        },
        assumptions=ASSUMPTIONS,
    )


ASSUMPTIONS = (
    "the real rollouts were run as their tests say, and none was left out",
    "the probabilities are calibrated on cases made from the simulator, with laws up to about 20 % off, "
    "5 % of every other effect and up to twice the simulator's scatter",
    "an effect that the catalogue lacks, but that a member imitates, is named as that member",
)


def _how_far(
    bench: Bench,
    state: _State,
    held: list[tuple[dict[str, float], Trace]],
    values: Mapping[str, Mapping[str, float]],
    seed: int,
    executor: Callable[[], Executor] | None,
    tell: Progress,
) -> HowFar | None:
    if not held:
        return None
    real = np.array([bench.rho(trace, test) for test, trace in held])
    tests = [test for test, _ in held]
    distinct = [dict(key) for key in dict.fromkeys(tuple(sorted(test.items())) for test in tests)]
    runs = tuple(
        (test, rollout_seed(seed, place, shot, Stream.GAP_SIM))
        for place, test in enumerate(distinct)
        for shot in range(SHOTS)
    )
    short = replace(bench, features=None)
    jobs = [Job({}, runs)] + ([Job(values, runs)] if values else [])
    rows = run_jobs(short, jobs, None, lambda done, of: tell("held-out tests", done, of))
    place = {tuple(sorted(test.items())): i for i, test in enumerate(distinct)}
    at = [place[tuple(sorted(test.items()))] for test in tests]
    means = [block[:, 0].reshape(len(distinct), SHOTS).mean(axis=1)[at] for block in rows]
    oracle = _oracle(bench, state, tests, real, means[0])
    noise = _scatter(tests, real, state.signatures.rho_noise)
    return how_far(
        real,
        means[0],
        means[1] if values else None,
        tests,
        noise,
        _background(state, bench, tests),
        SHOTS,
        bench.spec.unit(bench.requirement),
        oracle,
        seed,
    )


def _scatter(tests: Sequence[Test], real: FloatArray, nominal: float) -> float:
    """Return the standard deviation of ρ from run to run: of replicates where there are, else the simulator's."""
    keys = np.array([hash(tuple(sorted(t.items()))) for t in tests])
    squares, free = 0.0, 0
    for key in np.unique(keys):
        mine = real[keys == key]
        squares += float(((mine - mine.mean()) ** 2).sum())
        free += len(mine) - 1
    return float(np.sqrt(squares / free)) if free >= 5 else nominal


def _oracle(
    bench: Bench, state: _State, tests: Sequence[Test], real: FloatArray, nominal: FloatArray
) -> float:
    """Return the smallest mean gap that any point of any line reaches at the held-out tests, by the bank."""
    from s2r_spec.diagnose.design import weights

    known = unit_box(bench.spec.space, state.signatures.bank.tests)
    w = weights(known, unit_box(bench.spec.space, tests))
    gaps = [
        np.abs(real - nominal - (w @ curve.rho.T).T).mean(axis=1).min()
        for curve in state.signatures.curves
        if not curve.line.base
    ]
    return float(min(gaps))


def _background(state: _State, bench: Bench, tests: Sequence[Test]) -> float:
    """Return the mean gap in ρ that a little of every effect makes, at most, in 19 of 20 random machines."""
    from s2r_spec.diagnose.design import weights

    known = unit_box(bench.spec.space, state.signatures.bank.tests)
    w = weights(known, unit_box(bench.spec.space, tests))
    rng = np.random.default_rng(0)
    total = np.zeros((200, len(tests)))
    for curve in state.signatures.curves:
        if curve.line.base:
            continue
        sides = [s for s in (-1, 1) if (curve.coordinates * s > 0).any()]
        near = {s: min((c for c in curve.coordinates if c * s > 0), key=abs) for s in sides}
        slope = {s: w @ curve.rho[list(curve.coordinates).index(near[s])] / near[s] for s in sides}
        for row in total:
            side = int(rng.choice(sides))
            row += slope[side] * side * BACKGROUND * abs(rng.normal())
    return float(np.quantile(np.abs(total).mean(axis=1), 0.95))


def _confounded(
    isolable: Any, named: tuple[str, ...], by_size: Mapping[int, Mapping[tuple[str, ...], float]]
) -> tuple[str, ...]:
    """Return the named effects and whatever is both confounded with one of them and not ruled out by the data."""
    out = list(named)
    top = by_size[len(named)].get(named, 0.0)
    for names, probability in by_size[len(named)].items():
        if probability < 0.05 * top or names == named:
            continue
        extra = [n for n in names if n not in named]
        lost = [n for n in named if n not in names]
        if len(extra) == 1 and extra[0] in isolable.confounded(lost[0]) and extra[0] not in out:
            out.append(extra[0])
    return tuple(out)


def _next(bench: Bench, state: _State, ranked: list[tuple[tuple[int, ...], float]], tell: Progress) -> Any:
    rivals: list[tuple[str, Mapping[str, Mapping[str, float]]]] = []
    for members, _ in ranked:
        if members and len(rivals) < 2:
            best = fit(state.data, state.surrogate.catalogue, members, state.judge.weights.temperature)
            rivals.append((" + ".join(state.judge.effects[k] for k in members), best.values))
    tell("next test", 0, 1)
    return next_test(bench, state.signatures, rivals, protocols=True)


def _where(bench: Bench, rollouts: list[tuple[dict[str, float], Trace]], seed: int, tell: Progress) -> Where:
    """Compare every real rollout with one of the nominal simulator at its test."""
    real, simulated = [], []
    for number, (test, trace) in enumerate(rollouts):
        other = bench.run({}, test, rollout_seed(seed, number, 0, Stream.CHECK))
        real.append((trace, bench.rho(trace, test)))
        simulated.append((other, bench.rho(other, test)))
        tell("where", number + 1, len(rollouts))
    return find_where(bench.spec, bench.requirement, [test for test, _ in rollouts], real, simulated, seed)


def _reason(verdict: Verdict, which: Which, far: HowFar | None, named: tuple[str, ...]) -> str:
    """Return the answer in one sentence."""
    words = " and ".join(named)
    share = far.share[0] if far and far.share else None
    closes = (
        f"; added to the simulator it closes {100 * share:.0f} % of the held-out gap"
        if share is not None
        else ""
    )
    if verdict is Verdict.NONE:
        seen = "" if which.ranked[0][0] == ("none",) else f"; the traces do differ, most as with {words}"
        return f"the gap is no more than a few percent of every effect of the catalogue would make it{seen}"
    if verdict is Verdict.UNKNOWN:
        return f"no effect of the catalogue explains the data; the nearest is {words} ({which.nearest_family}){closes}"
    if verdict is Verdict.CONFOUNDED:
        others = ", ".join(name for name in which.confounded if name not in named)
        return f"{words} fits best, but these data cannot tell it from {others}{closes}"
    return f"{words} explains the data best{closes}"
