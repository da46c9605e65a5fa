"""Diagnose: from real rollouts and a simulator with a catalogue of effects to an answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend, HasRecordings, load_backend
from s2r_spec.certify.arguments import as_folder, as_rollouts, as_simulator, as_spec
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.accused import named_by_falls
from s2r_spec.diagnose.ask import Rollouts, real_rollouts, refuse_machine
from s2r_spec.diagnose.cache import Cache
from s2r_spec.diagnose.diagnosis import Diagnosis, Verdict, Which
from s2r_spec.diagnose.estimate import Fit, by_linear, fit
from s2r_spec.diagnose.falls import always_early, falls, falls_alone
from s2r_spec.diagnose.gap.by_test import compared_at_all_tests
from s2r_spec.diagnose.gap.where import Pairs, Where
from s2r_spec.diagnose.gap.where import where as find_where
from s2r_spec.diagnose.held_out import measured, mostly_of_one
from s2r_spec.diagnose.how_far import HowFar
from s2r_spec.diagnose.idle import active
from s2r_spec.diagnose.isolability import Isolability, isolability
from s2r_spec.diagnose.kin import shared
from s2r_spec.diagnose.next_test import next_test
from s2r_spec.diagnose.notes import Used, hidden_by_one, looked_again, notes
from s2r_spec.diagnose.parted import ENOUGH, Parted
from s2r_spec.diagnose.prepare import Progress, State, bench_of, prepare
from s2r_spec.diagnose.quality import findings
from s2r_spec.diagnose.quality.doubt import doubted
from s2r_spec.diagnose.remainder import remainders
from s2r_spec.diagnose.simulate import Bench, Test
from s2r_spec.diagnose.size import sized
from s2r_spec.diagnose.threads import one_thread
from s2r_spec.diagnose.together import LARGEST, Together, together
from s2r_spec.diagnose.verdict import (
    SURE,
    certain,
    clear,
    confounded,
    decided,
    early_ends,
    large,
    likeliest,
    reason,
    spare,
)
from s2r_spec.diagnose.watched import Watched
from s2r_spec.distribution import version
from s2r_spec.documentation import page
from s2r_spec.effects import catalogue_of
from s2r_spec.errors import require
from s2r_spec.rollouts.compatibility import check_compatibility
from s2r_spec.rollouts.pools import kept_open
from s2r_spec.rollouts.recorded import tests_of
from s2r_spec.rollouts.seeds import Stream, rollout_seed
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

PLAIN = 3.0
"""A gap that is so many times what scatter makes is there, whatever a little of every effect would make."""


@one_thread()
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
        progress: called with (stage, done, of) now and then; ``of`` is 0 where nobody knows how much there is.
        cache: folder for what is simulated and learnt once; the user's cache folder if not given.
        folder: where rollouts that are asked of a machine are kept, each before the next begins; a
            second call goes on from what is there.
        where: also say where the gap lies in tests, time, formula and body.

    Raises:
        UsageError: scikit-learn is not installed, the simulator declares no effects, or the
            rollouts do not fit the spec.
    """
    require("a diagnosis needs", "sklearn")
    spec, sim, real = as_spec(spec), as_simulator(sim), as_rollouts(real)
    called = real if isinstance(real, str) else str(getattr(real, "name", ""))
    cache, folder = (None if path is None else as_folder(path) for path in (cache, folder))
    name = spec.requirements[0] if requirement is None else requirement
    bench = bench_of(spec, name, sim)
    if isinstance(real, str) and not real.startswith("log:"):  # a folder is read only when it is needed
        real = load_backend(real)
    refuse_machine(real)
    tell = Watched(progress or (lambda stage, done, of: None))
    kept = Cache.usual() if cache is None else Cache(cache)
    bank, idle = active(banks.bank(bench, executor, tell, kept))
    bench = replace(bench, features=bank.features)
    # The bank comes first: a simulator that cannot be diagnosed costs no rollout of the machine.
    real = load_backend(real) if isinstance(real, str) else real
    rollouts = real_rollouts(bench, real, budget, seed, folder, lambda n, of: tell("real rollouts", n, of))
    parts = Parted.of(rollouts, seed)
    begun = len(parts.compared) < len(parts.seen)
    told = Used(rollouts, len(parts.used), begun, len(parts.held), *_recorded(bench, real))
    held_first = parts.held
    with kept_open(executor) as pool, tell.watching():
        gap = compared_at_all_tests(
            bench, rollouts, seed, pool, lambda done, of: tell("simulating all tests", done, of)
        )
        matters = bool(gap.places)
        tell("where the simulator falls", 0, 0)
        why = falls(bench, bank.lines, rollouts, seed, pool)
        odd = findings(
            bench, rollouts, bank.lines, pool, lambda done, of: tell("checking the recordings", done, of)
        )
        alone = falls_alone(bench, rollouts, seed, pool)
        lacking = notes(bench, told, ENOUGH, idle, why, odd, alone)
        state = prepare(bench, bank, parts.compared, seed, kept, pool, tell)
        found = _answer(bench, state, parts, seed, pool, tell, where, matters=matters)
        if (far := found.how_far) is not None and far.overlooked:
            parts, moved = parts.looked_at([dict(test.params) for test in far.odd])
            if moved:
                state = prepare(bench, bank, parts.compared, seed, kept, pool, tell)
                found = _answer(bench, state, parts, seed, pool, tell, where, moved=True, matters=matters)
                lacking = (*lacking, looked_again(moved))
        lacking = (*lacking, *_hidden(bench, state, found))
        left_out = len(rollouts) - len(parts.used)
        if left_out and found.verdict is Verdict.NONE and always_early(rollouts):
            found = named_by_falls(found, state, why)
        elif why is not None and not left_out and not found.which.answer:
            # So many fell that they are the gap: what closes it by falling there, too, is the cause. No trace of a
            # fall was looked at, so those that changed places are as good as held out.
            asked = replace(parts, held=held_first)
            found = named_by_falls(
                found,
                state,
                why,
                lambda patch: measured(bench, state, asked, patch, found.tuned, seed, pool, tell),
            )
        found = early_ends(found, gap)
        if left_out and found.verdict is Verdict.NONE:
            # That a machine falls where its simulator does not is a gap, whatever the other rollouts say.
            found = replace(
                found,
                reason=f"{found.reason} This leaves out {left_out} of {len(rollouts)} rollouts, which ended early.",
            )
        found = replace(found, notes=(*lacking, *dict.fromkeys(kept.said)), findings=odd, materiality=gap)
        return replace(doubted(found), spec=spec, real=called)


def _hidden(bench: Bench, state: State, found: Diagnosis) -> list[str]:
    """Return what to say where a plain gap is not material for one effect's prior alone."""
    far = found.how_far
    if far is None or found.verdict is not Verdict.NONE or far.before.mean < PLAIN * far.floor:
        return []
    only = mostly_of_one(state.signatures.curves)
    return [hidden_by_one(e, far) for e in catalogue_of(bench.backend) if e.name == only]


def _recorded(bench: Bench, real: Rollouts | Backend) -> tuple[int, int]:
    """Return how many rollouts of the spec's tests, and of others, there were before anybody asked.

    None of either of a machine that is asked.
    """
    if not isinstance(real, Backend):
        return len(real), 0
    if not isinstance(real, HasRecordings):
        return 0, 0
    matched = check_compatibility(bench.spec, bench.requirement, real)
    tests = tests_of(real.recordings)
    of_spec = sum(matched.to_spec(each.params) is not None for each in tests)
    return of_spec, len(tests) - of_spec


def _answer(
    bench: Bench,
    state: State,
    parts: Parted,
    seed: int,
    executor: Callable[[], Executor] | None,
    tell: Progress,
    want_where: bool,
    moved: bool = False,
    matters: bool = False,
) -> Diagnosis:
    effects = state.judge.effects
    weighed = together(state, lambda done, of: tell("simulating sets of effects", done, of))
    state = replace(state, sets=weighed.sets, temperature=weighed.temperature)
    isolable = isolability(
        state.smooth.surrogate,
        state.smooth.layout.scatter,
        state.signatures.noise,
        state.smooth.nuisances,
        state.temperature,
    )
    ranked = state.sets.ranked()
    first_none = not ranked[0][0]
    told = shared(state.sets, isolable.kin)
    named = likeliest(ranked, told.ranked())
    tell("fitting the causes", 0, 0)
    catalogue = state.view.surrogate.catalogue
    best = sized(state, weighed, named)
    there = large(catalogue, named, best.at)
    if there != named:
        named, best = there, sized(state, weighed, there)
    fitted = fit(catalogue, named, best)
    tuned = catalogue.values((sized(state, weighed, ()) if first_none else best).tuned)
    left = remainders(
        bench,
        state.signatures.bank.lines,
        parts.used,
        tuned,
        seed,
        executor,
        lambda done, of: tell("unexplained motion", done, of),
        None if first_none else fitted.values,
    )

    def answered(fitted: Fit, plain: bool) -> tuple[HowFar | None, Verdict, float]:
        values = {} if first_none else fitted.values
        far = measured(bench, state, parts, values, tuned, seed, executor, tell)
        far = far and replace(far, moved=moved, matters=matters)
        return far, *decided(
            far,
            state.unknown,
            state.judge.threshold,
            ranked[0][1],
            nothing=first_none,
            plain=plain,
            at_end=any(e.at_end for e in fitted.estimates),
            strange=any(each.material for each in left),
            matters=matters,
        )

    far, verdict, unknown = answered(fitted, clear(state.sets, *ranked[0]))
    sure = certain(state.sets, named)
    if verdict is Verdict.NONE and not first_none and 0 < len(sure) < len(named):
        # The traces are sure of some of them, and what may be beside these does not make that less so.
        named, fitted = sure, fit(catalogue, sure, sized(state, weighed, sure))
        far, verdict, unknown = answered(fitted, plain=True)
    known = 1.0 - unknown
    by_size: dict[int, dict[tuple[str, ...], float]] = {size: {} for size in range(LARGEST + 2)}
    for several, probability in zip(told.members, told.probability, strict=True):
        by_size[len(several)][tuple(effects[k] for k in several)] = known * float(probability)

    members = tuple(effects[k] for k in named)
    alike = confounded(isolable, members, by_size)
    if verdict is Verdict.NAMED and len(alike) > len(named):
        verdict = Verdict.CONFOUNDED
    nothing = verdict in (Verdict.NONE, Verdict.SPREAD)
    answer = () if nothing or verdict is Verdict.UNKNOWN else members
    upcoming = None
    unsure = told.probability.max() * known < SURE or verdict is Verdict.CONFOUNDED
    if verdict not in (Verdict.NONE, Verdict.UNKNOWN) and unsure:
        upcoming = _next(
            bench, state, weighed, isolable, told.ranked(), [test for test, _ in parts.used], tell
        )
    families = {e.name: e.family for e in catalogue_of(bench.backend)}
    which = Which(
        none=by_size[0][()],
        unknown=unknown,
        singles={n[0]: p for n, p in by_size[1].items()},
        several={names: p for size in range(2, LARGEST + 1) for names, p in by_size[size].items()},
        answer=answer,
        confounded=alike if answer else (),
        estimates=() if nothing else fitted.estimates,
        nearest_family=" and ".join(dict.fromkeys(families[name] for name in members)),
        isolability=isolable,
        next_test=upcoming,
        spare=spare(members, by_size) if answer else (),
    )
    return Diagnosis(
        verdict=verdict,
        reason=reason(verdict, which, far, members, left),
        where=_where(bench, parts.used, tuned, seed, executor, tell) if want_where else None,
        which=which,
        how_far=far,
        left=left,
        patch=fitted.values if answer else {},
        tuned=tuned,
        provenance={
            "s2r": version(),
            "seed": seed,
            "spec_hash": bench.spec.hash,
            "requirement": bench.requirement,
            "backend": bench.backend.name,
            "model_hash": bench.backend.model_hash,
            "rollouts": len(parts.used),
            "held_out": len(parts.held),
            "weighed_by": "bank" if state.by_bank else "simulator",
            "judge": {name: round(value, 4) for name, value in state.judge.practice.items()},
        },
        assumptions=ASSUMPTIONS,
    )


ASSUMPTIONS = (
    "the real rollouts were run at the recorded tests, and only those named in a note were left out",
    "the probabilities combine evidence and networks with fixed weights, chosen on development twins; "
    f"{page('explanation/diagnosis')} shows how often they come true on sealed twins",
    "if an effect outside the catalogue looks like one in it, the diagnosis names the one in the catalogue",
)


def _next(
    bench: Bench,
    state: State,
    weighed: Together,
    isolable: Isolability,
    ranked: list[tuple[tuple[int, ...], float]],
    run: Sequence[Test],
    tell: Progress,
) -> Any:
    rivals: list[tuple[str, Mapping[str, Mapping[str, float]]]] = []
    first = next((members for members, _ in ranked if members), ())
    for members, _ in ranked:
        if members and len(rivals) < 2 and not isolable.same(first, members):
            size = by_linear(state.data, members, state.temperature)
            # Linear data are right near the fit of everything; a set that was simulated has a fit of its own.
            if looked := weighed.fits.get(members):
                size = replace(size, at=looked.at)
            best = fit(state.view.surrogate.catalogue, members, size)
            rivals.append((" + ".join(state.judge.effects[k] for k in members), best.values))
    tell("next test", 0, 0)
    return next_test(bench, state.signatures, rivals, run, protocols=True, temperature=state.temperature)


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
    tell("where in the machine and between the tests", 0, 0)
    pairs = Pairs(tests, real, simulated)
    return find_where(bench.spec, bench.requirement, pairs, seed, bench, improved, executor)
