"""Diagnose: from real rollouts and a simulator with a catalogue of effects to an answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend, HasRecordings, load_backend
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.ask import Rollouts, real_rollouts
from s2r_spec.diagnose.axes import BACKGROUND
from s2r_spec.diagnose.catalogue import Catalogue
from s2r_spec.diagnose.design import unit_box, weights
from s2r_spec.diagnose.diagnosis import Diagnosis, Verdict, Which
from s2r_spec.diagnose.estimate import by_linear, fit
from s2r_spec.diagnose.evidence import Set
from s2r_spec.diagnose.how_far import HowFar, how_far
from s2r_spec.diagnose.isolability import isolability
from s2r_spec.diagnose.judge import Sets
from s2r_spec.diagnose.next_test import next_test
from s2r_spec.diagnose.notes import notes
from s2r_spec.diagnose.prepare import ENOUGH, Progress, State, bench_of, prepare, split
from s2r_spec.diagnose.simulate import Bench, Job, Test, run_jobs
from s2r_spec.diagnose.size import sized
from s2r_spec.diagnose.together import together
from s2r_spec.diagnose.where.found import Where
from s2r_spec.diagnose.where.found import where as find_where
from s2r_spec.errors import UsageError
from s2r_spec.rollouts.pools import kept_open
from s2r_spec.rollouts.seeds import Stream, rollout_seed
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

SHOTS = 3
"""Simulated rollouts per held-out test, before and after."""
SURE = 0.9
CLEAR = 0.7
"""Probability from which on a set is named although the gap is not material; :data:`SURE` of each effect does, too."""
RIVAL = 0.2
"""A set this many times as likely as the first is a rival of it."""
RULED_OUT = 0.05
"""One less likely than this is ruled out, even where the two are hard to tell apart."""
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
    bench = bench_of(spec, name, sim)
    tell = progress or (lambda stage, done, of: None)
    bank = banks.bank(bench, executor, lambda done, of: tell("simulating effects", done, of), cache)
    bench = replace(bench, features=bank.features)
    # The bank comes first: a simulator that cannot be diagnosed costs no rollout of the machine.
    real = load_backend(real) if isinstance(real, str) else real
    rollouts = real_rollouts(bench, real, budget, seed, folder, lambda n, of: tell("real rollouts", n, of))
    seen, held = split(rollouts, seed)
    lacking = notes(bench.backend, rollouts, _recorded(real), len(held), ENOUGH)
    with kept_open(executor) as pool:
        state = prepare(bench, bank, seen, seed, cache, pool, tell)
        return replace(_answer(bench, state, seen, held, seed, pool, tell, where), notes=lacking)


def _recorded(real: Rollouts | Backend) -> int:
    """Return how many rollouts there were before anybody asked; 0 of a machine that is asked."""
    if isinstance(real, Backend):
        return len(real.recordings) if isinstance(real, HasRecordings) else 0
    return len(real)


def _answer(
    bench: Bench,
    state: State,
    seen: list[tuple[dict[str, float], Trace]],
    held: list[tuple[dict[str, float], Trace]],
    seed: int,
    executor: Callable[[], Executor] | None,
    tell: Progress,
    want_where: bool,
) -> Diagnosis:
    effects = state.judge.effects
    weighed = together(state, lambda done, of: tell("simulating sets", done, of))
    state = replace(state, sets=weighed.sets, temperature=weighed.temperature)
    ranked = state.sets.ranked()
    first_none = not ranked[0][0]
    named = next(members for members, _ in ranked if members)
    tell("fitting the causes", 0, 1)
    catalogue = state.view.surrogate.catalogue
    best = sized(state, weighed, named)
    large = _large(catalogue, named, best.at)
    if large != named:
        named, best = large, sized(state, weighed, large)
    fitted = fit(catalogue, named, best)
    tuned = catalogue.values(sized(state, weighed, ()).at if first_none else best.at)
    far = _how_far(bench, state, held, {} if first_none else fitted.values, tuned, seed, executor, tell)

    unknown = state.unknown
    alarm = unknown > state.judge.threshold and not first_none
    open_gap = far is not None and (far.open or (first_none and far.unexplained))
    if far is not None and far.unclosed:
        # What closes too little to vouch for a name is not named against the odds.
        open_gap = open_gap or unknown > (1.0 - unknown) * ranked[0][1]
    if far is not None and (far.closed or not far.material):
        # Odd traces alone are no unknown cause of a gap that is explained, or that is not there:
        # every machine differs from its simulator in ways that nobody asked about.
        alarm, unknown = False, unknown * IMITATED
        # A gap that a little of everything would make needs no name, unless the traces are clear.
        # Nor is what makes a gap where there is none its cause, however the traces look.
        first_none = first_none or not (far.material or _clear(state.sets, *ranked[0])) or far.harmful
    if open_gap:
        # The patch does not close the gap that it should explain: at least as likely unknown as not.
        unknown = max(unknown, 0.5 + 0.5 * unknown)
    names = {members: tuple(effects[k] for k in members) for members in state.sets.members}
    known = 1.0 - unknown
    by_size: dict[int, dict[tuple[str, ...], float]] = {0: {}, 1: {}, 2: {}, 3: {}}
    for members, probability in zip(state.sets.members, state.sets.probability, strict=True):
        by_size[len(members)][names[members]] = known * float(probability)

    isolable = isolability(
        state.smooth.surrogate,
        state.smooth.layout.scatter,
        state.signatures.noise,
        state.smooth.nuisances,
        state.temperature,
    )
    confounded = _confounded(isolable, names[named], by_size)
    verdict = Verdict.NAMED
    if alarm or open_gap:
        verdict = Verdict.UNKNOWN
    elif first_none:
        verdict = Verdict.SPREAD if far is not None and far.material else Verdict.NONE
    elif len(confounded) > len(named):
        verdict = Verdict.CONFOUNDED
    nothing = verdict in (Verdict.NONE, Verdict.SPREAD)
    answer = () if nothing or verdict is Verdict.UNKNOWN else names[named]
    upcoming = None
    if verdict is not Verdict.NONE and ranked[0][1] * known < SURE:
        upcoming = _next(bench, state, ranked, [test for test, _ in (*seen, *held)], tell)
    families = {e.name: e.family for e in banks.catalogue_of(bench.backend)}
    which = Which(
        none=by_size[0][()],
        unknown=unknown,
        singles={n[0]: p for n, p in by_size[1].items()},
        pairs=by_size[2],
        triples=by_size[3],
        answer=answer,
        confounded=confounded if answer else (),
        estimates=() if nothing else fitted.estimates,
        nearest_family=families[names[named][0]],
        isolability=isolable,
        next_test=upcoming,
    )
    return Diagnosis(
        verdict=verdict,
        reason=_reason(verdict, which, far, names[named]),
        where=_where(bench, seen + held, tuned, seed, executor, tell) if want_where else None,
        which=which,
        how_far=far,
        patch=fitted.values if answer else {},
        tuned=tuned,
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
    "the probabilities weigh evidence and networks by fixed numbers from development twins; on sealed twins those of "
    "0.9 and more were right less often than they say (docs/explanation/diagnosis.md)",
    "an effect that the catalogue lacks, but that a member imitates, is named as that member",
)


def _how_far(
    bench: Bench,
    state: State,
    held: list[tuple[dict[str, float], Trace]],
    values: Mapping[str, Mapping[str, float]],
    tuned: Mapping[str, Mapping[str, float]],
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
    jobs = [Job({}, runs), Job(tuned, runs)] + ([Job(values, runs)] if values else [])
    rows = run_jobs(short, jobs, executor, lambda done, of: tell("held-out tests", done, of))
    place = {tuple(sorted(test.items())): i for i, test in enumerate(distinct)}
    at = [place[tuple(sorted(test.items()))] for test in tests]
    means = [block[:, 0].reshape(len(distinct), SHOTS).mean(axis=1)[at] for block in rows]
    oracle = _oracle(bench, state, tests, real, means[0])
    # What the cause makes unsteady scatters more than the nominal simulator does.
    patched = rows[-1][:, 0].reshape(len(distinct), SHOTS)
    own = max(state.signatures.rho_noise, float(np.sqrt(patched.var(axis=1, ddof=1).mean())))
    noise = _scatter(tests, real, own)
    return how_far(
        real,
        means[0],
        means[2] if values else None,
        means[1],
        tests,
        noise,
        _background(state, bench, tests),
        SHOTS,
        bench.spec.unit(bench.requirement),
        oracle,
        seed,
    )


def _clear(sets: Sets, members: tuple[int, ...], probability: float) -> bool:
    """Return whether the traces name these effects, although ρ does not need them; there may be more beside them."""
    among = [
        sum(p for s, p in zip(sets.members, sets.probability, strict=True) if effect in s)
        for effect in members
    ]
    return bool(probability >= CLEAR or min(among, default=0.0) >= SURE)


def _scatter(tests: Sequence[Test], real: FloatArray, simulated: float) -> float:
    """Return the standard deviation of ρ from run to run: of replicates where there are, else the simulator's."""
    of_test: dict[tuple[tuple[str, float], ...], list[float]] = {}
    for test, rho in zip(tests, real.tolist(), strict=True):
        of_test.setdefault(tuple(sorted(test.items())), []).append(rho)
    squares = sum(float(((np.array(mine) - np.mean(mine)) ** 2).sum()) for mine in of_test.values())
    free = len(tests) - len(of_test)
    return float(np.sqrt(squares / free)) if free >= 5 else simulated


def _from_bank(state: State, bench: Bench, tests: Sequence[Test]) -> FloatArray:
    """Return (tests, m) weights with which values at the bank's tests become values at these."""
    space = bench.spec.space
    return weights(unit_box(space, state.signatures.bank.tests), unit_box(space, tests))


def _oracle(
    bench: Bench, state: State, tests: Sequence[Test], real: FloatArray, nominal: FloatArray
) -> float:
    """Return the smallest mean gap that any point of any line reaches at the held-out tests, by the bank."""
    w = _from_bank(state, bench, tests)
    gaps = [
        np.abs(real - nominal - (w @ curve.rho.T).T).mean(axis=1).min()
        for curve in state.signatures.curves
        if not curve.line.base
    ]
    return float(min(gaps))


def _background(state: State, bench: Bench, tests: Sequence[Test]) -> float:
    """Return the mean gap in ρ that a little of every effect makes, at most, in 19 of 20 random machines."""
    w = _from_bank(state, bench, tests)
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


def _large(catalogue: Catalogue, named: Set, at: FloatArray) -> Set:
    """Return the effects that are there, of (K,) coordinates, by more than of any machine; all, if none is.

    Sets are weighed before their values are put right: what turns out next to nothing then is no cause beside others.
    """
    lines = ~catalogue.based
    sizes = {k: np.abs(at[lines & (catalogue.owner == k)]).max(initial=0.0) for k in named}
    return tuple(k for k in named if sizes[k] >= BACKGROUND) or named


def _confounded(
    isolable: Any, named: tuple[str, ...], by_size: Mapping[int, Mapping[tuple[str, ...], float]]
) -> tuple[str, ...]:
    """Return the named effects and whatever could be in the place of one of them, or beside them.

    That is what these data leave nearly as likely, and what no data at these tests could tell from one of them
    unless they all but rule it out.
    """
    out = list(named)
    # Of a set with an effect of next to nothing, which was left out of what is named, the rest is as likely as that.
    top = max(p for sets in by_size.values() for names, p in sets.items() if set(named) <= set(names))
    for names, probability in by_size[len(named)].items():
        if probability < RULED_OUT * top or names == named:
            continue
        extra = [n for n in names if n not in named]
        lost = [n for n in named if n not in names]
        near = probability >= RIVAL * top or extra[0] in isolable.confounded(lost[0])
        if len(extra) == 1 and near and extra[0] not in out:
            out.append(extra[0])
    for names, probability in by_size.get(len(named) + 1, {}).items():
        if probability >= RIVAL * top and set(named) < set(names):
            out += [n for n in names if n not in out]
    return tuple(out)


def _next(
    bench: Bench,
    state: State,
    ranked: list[tuple[tuple[int, ...], float]],
    run: Sequence[Test],
    tell: Progress,
) -> Any:
    rivals: list[tuple[str, Mapping[str, Mapping[str, float]]]] = []
    for members, _ in ranked:
        if members and len(rivals) < 2:
            best = fit(
                state.view.surrogate.catalogue, members, by_linear(state.data, members, state.temperature)
            )
            rivals.append((" + ".join(state.judge.effects[k] for k in members), best.values))
    tell("next test", 0, 1)
    return next_test(bench, state.signatures, rivals, run, protocols=True)


def _where(
    bench: Bench,
    rollouts: list[tuple[dict[str, float], Trace]],
    improved: Mapping[str, Mapping[str, float]],
    seed: int,
    executor: Callable[[], Executor] | None,
    tell: Progress,
) -> Where:
    """Compare every real rollout with one of the nominal simulator at its test."""
    real, simulated = [], []
    for number, (test, trace) in enumerate(rollouts):
        other = bench.run({}, test, rollout_seed(seed, number, 0, Stream.CHECK))
        real.append((trace, bench.rho(trace, test)))
        simulated.append((other, bench.rho(other, test)))
        tell("where", number + 1, len(rollouts))
    tests = [test for test, _ in rollouts]
    return find_where(bench.spec, bench.requirement, tests, real, simulated, seed, bench, improved, executor)


def _reason(verdict: Verdict, which: Which, far: HowFar | None, named: tuple[str, ...]) -> str:
    """Return the answer in one sentence."""
    words = " and ".join(named)
    share = far.share[0] if far and far.share else None
    closes = (
        f"; added to the simulator it closes {100 * share:.0f} % of the held-out gap"
        if share is not None
        else ""
    )
    if verdict in (Verdict.NONE, Verdict.SPREAD):
        seen = "" if which.ranked[0][0] == ("none",) else f"; the traces do differ, most as with {words}"
        little = "a few percent of every effect of the catalogue"
        if far is None:
            return f"the traces are as {little} would make them{seen}; no gap was held out to compare"
        if verdict is Verdict.SPREAD:
            part = "" if far.tuned_share is None else f" {100 * far.tuned_share[0]:.0f} % of"
            return f"nothing stands out: {little} close{part} the held-out gap{seen}"
        return f"the gap is no more than {little} would make it{seen}"
    if verdict is Verdict.UNKNOWN:
        return f"no effect of the catalogue explains the data; the nearest is {words} ({which.nearest_family}){closes}"
    if verdict is Verdict.CONFOUNDED:
        others = ", ".join(name for name in which.confounded if name not in named)
        return f"{words} fits best, but these data do not rule out {others} in its place or beside it{closes}"
    return f"{words} explains the data best{closes}"
