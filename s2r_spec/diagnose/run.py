"""Diagnose: from real rollouts and a simulator with a catalogue of effects to an answer.

The pipeline, in this order:

    data          tests and protocols that were recorded, or that a machine runs in a campaign
    library       what every effect does in these experiments, simulated once (:mod:`.simulator.library`)
    estimate      sizes of all effects, from the train rollouts (:mod:`.estimation`)
    evidence      the gap at all tests and on held-out ones, motion that no effect explains, suspected mistakes
    diagnosis     the verdict, by one table of rules (:mod:`.decision`)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from s2r_spec.backend import Backend, HasLoop, HasRecordings, load_backend
from s2r_spec.backend.effects import catalogue_of
from s2r_spec.backend.protocols import protocol_of
from s2r_spec.certify.arguments import as_folder, as_rollouts, as_simulator, as_spec
from s2r_spec.diagnose.data.campaign import BUDGET, campaign, plan, smallest_with_held_out
from s2r_spec.diagnose.data.cost import Cost, Expected, of_library, on_machine, planned_held_out
from s2r_spec.diagnose.data.journal import campaign_seed
from s2r_spec.diagnose.data.protocols import allowed_experiments, with_protocols_of
from s2r_spec.diagnose.data.rollouts import (
    RealRollouts,
    Rollouts,
    as_experiment,
    recorded_inputs,
    recorded_rollouts,
)
from s2r_spec.diagnose.data.space_filling import representative, star
from s2r_spec.diagnose.data.split import TrainHeldOut, split
from s2r_spec.diagnose.decision import Evidence
from s2r_spec.diagnose.diagnosis import Diagnosis, Which
from s2r_spec.diagnose.estimation import Estimate, estimate, size_prior
from s2r_spec.diagnose.experiment_design.identifiability import Candidate, InformationForecast, separations
from s2r_spec.diagnose.experiment_design.next_test import next_test
from s2r_spec.diagnose.gap.breaking import breaking_sizes
from s2r_spec.diagnose.gap.held_out import held_out_gap
from s2r_spec.diagnose.gap.materiality import compared_at_all_tests
from s2r_spec.diagnose.gap.nominal import Nominal
from s2r_spec.diagnose.gap.where import locate
from s2r_spec.diagnose.inference.estimates import (
    EffectEstimate,
    Status,
    by_effects,
    effect_estimates,
    further_causes,
    mean_sizes,
    with_status,
)
from s2r_spec.diagnose.notes import early_ends, notes
from s2r_spec.diagnose.quality import Loop, certain_findings, likely_findings, unstated, with_loop_of
from s2r_spec.diagnose.refusal import provenance, refusal, refuse_memory
from s2r_spec.diagnose.residuals.left import remainders
from s2r_spec.diagnose.rivals import rival_loops
from s2r_spec.diagnose.simulator.bench import Bench, refuse_machine, travels
from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import library, most_rollouts, refined_at
from s2r_spec.diagnose.simulator.open_loop import OpenLoop
from s2r_spec.diagnose.simulator.response import ResponseLibrary
from s2r_spec.diagnose.simulator.runs import NominalError
from s2r_spec.diagnose.simulator.score import Score
from s2r_spec.diagnose.watched import Progress, Watched
from s2r_spec.runs.scorer import adapt_to_spec
from s2r_spec.space import key_of
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace
from s2r_spec.workers.pools import ExecutorFactory, keep_open
from s2r_spec.workers.threads import one_thread

ASSUMPTIONS = (
    "the real rollouts were run at the recorded tests, and only those named in a note were left out",
    "the real machine's laws differ from the simulator's by a tenth of each effect in size and shape, seldom by more",
    "if an effect outside the catalogue looks like one in it, the diagnosis names the one in the catalogue",
)

HERE = 2e-3
"""Budget: declared time of a rollout [s] up to which all run in this process: the thousands of a diagnosis then take a
few seconds, and a worker takes one to start."""


@one_thread()
def diagnose(
    spec: Spec | Path | str,
    sim: Backend | str,
    real: Rollouts | Backend | str,
    budget: int | None = None,
    *,
    requirement: str | None = None,
    seed: int | None = None,
    executor: ExecutorFactory | None = None,
    progress: Progress | None = None,
    cache: Path | None = None,
    folder: Path | None = None,
    where: bool = True,
    protocols: Sequence[str] | None = None,
    passive: bool = False,
    open_loop: bool = False,
) -> Diagnosis:
    """Say where a sim-to-real gap lies, which unmodelled effect causes it, and how far it shrinks.

    Args:
        spec: what is required, and over which tests; or its file.
        sim: the simulator; it must declare effects.
        real: (test in the spec's units, trace) of each real rollout, or a backend: a folder of recordings, or a
            machine, which then runs a campaign of tests and protocols.
        budget: largest number of real rollouts; 30 from a machine, and all recorded ones, if not given.
        requirement: the requirement to look at; the spec's first if not given.
        seed: fixes everything that is drawn; None for the seed of a resumed campaign, and 0 for a new one.
        executor: makes a pool for the simulations; None runs them here, where quick ones (:data:`HERE`) always run.
        progress: called with (stage, done, of) now and then; ``of`` is 0 where it is not known.
        cache: folder for what is simulated once; the user's cache folder if not given.
        folder: folder of the rollouts of a machine, each on disk before the next begins; a second call resumes.
        where: also say where the gap lies in tests, time, formula and body.
        protocols: names of the protocols that a machine may run; None for all, empty for none.
        passive: use tests of the specification alone.
        open_loop: simulate every recorded test with the commands that were recorded, without the controller.

    Raises:
        UsageError: the simulator declares no effects, or the rollouts do not fit the spec.
    """
    spec, sim, real = as_spec(spec), as_simulator(sim), as_rollouts(real)
    called = real if isinstance(real, str) else str(getattr(real, "name", ""))
    kept = Cache.usual() if cache is None else Cache(as_folder(cache))
    folder = None if folder is None else as_folder(folder)
    requirement = spec.requirements[0] if requirement is None else requirement
    refuse_machine(real := load_backend(real) if isinstance(real, str) else real)
    if isinstance(real, Backend):
        real = adapt_to_spec(real, spec, requirement)
    if open_loop:
        sim = load_backend(sim) if isinstance(sim, str) else sim
        real = real if isinstance(real, Backend) else list(real)
        sim = OpenLoop.of(sim, spec, recorded_inputs(spec, requirement, sim, real))
    bench = Bench.of(spec, requirement, sim)
    seed, tell = campaign_seed(folder, seed), Watched(progress or (lambda stage, done, of: None))
    pooled = bench.backend.cost > HERE and travels(bench)
    with keep_open(executor if pooled else None) as pool, tell.watching():
        work = _Work(replace(bench, pool=pool), seed, tell, kept)
        if isinstance(real, Backend) and not isinstance(real, HasRecordings):
            data = _campaign(work, real, budget, folder, protocols, passive)
            rollouts = data.rollouts
        else:
            rollouts, data = recorded_rollouts(work.bench, real, budget, passive), None
        tell("checking the recordings", 0, 0)
        if data is None:
            files = work.bench
            bench, loop = with_loop_of(files, rollouts.tests)
            work = replace(work, bench=bench, files=files, loop=loop)
        broken = unstated(work.loop) if work.mistakes else certain_findings(work.bench, rollouts.tests)
        if broken:
            diagnosis = refusal(work.bench, seed, rollouts, broken, ASSUMPTIONS)
        else:
            try:
                data = data or _recordings(work, rollouts, protocols, passive)
                work, data = _with_rival_loop(work, data, protocols, passive)
                diagnosis = _answer(work, data, where)
            except NominalError as error:
                if work.loop is None or not work.mistakes:
                    raise
                diagnosis = refusal(
                    work.bench, seed, rollouts, (), ASSUMPTIONS, work.loop.failing(error.where)
                )
    return replace(diagnosis, notes=(*diagnosis.notes, *dict.fromkeys(kept.notes)), spec=spec, real=called)


@dataclass(frozen=True)
class _Work:
    """What every step needs; ``files`` is the simulator as its files are, without mistakes of the machine's loop."""

    bench: Bench
    seed: int
    tell: Watched
    cache: Cache
    files: Bench | None = None
    loop: Loop | None = None

    @property
    def mistakes(self) -> bool:
        return self.loop is not None and bool(self.loop.names)

    def library(self, experiments: Sequence[Experiment], where: str = "") -> ResponseLibrary:
        self.tell("trying each effect", 0, 0)

        def progress(stage: str, done: int, of: int) -> None:
            self.tell(stage + where, done, of)

        return library(self.bench.backend, experiments, self.bench.pool, progress, self.cache, self.score)

    def simulated(self, experiments: Sequence[Experiment]) -> Expected:
        self.tell("timing a rollout of the simulator", 0, 0)
        most = most_rollouts(self.bench.backend, experiments, self.cache, self.score)
        return of_library(self.bench.backend, most)

    @property
    def score(self) -> Score:
        return Score(self.bench.spec, self.bench.requirement, self.bench.matched)

    def counted(self, stage: str) -> Bench:
        """Return the bench whose jobs are the count of a stage."""
        return replace(self.bench, progress=partial(self.tell, stage))


@dataclass(frozen=True)
class _Data:
    """Real rollouts, in two parts, the library of their experiments, and those that may run next."""

    rollouts: RealRollouts
    parts: TrainHeldOut
    responses: ResponseLibrary
    allowed: frozenset[Experiment]

    def train(self, bench: Bench) -> dict[Experiment, list[Trace]]:
        runs = self.parts.train.by_experiment(bench)
        return {
            experiment: own for experiment, own in runs.items() if experiment in self.responses.experiments
        }

    def candidates(
        self, bench: Bench, train: RealRollouts, dropped: frozenset[str] = frozenset()
    ) -> list[Candidate]:
        """Return every experiment of the library, with the number of its runs so far."""
        runs = train.by_experiment(bench)
        candidates = []
        for one in self.responses.experiments:
            able = one in self.allowed and one.protocol not in dropped
            duration = (
                protocol_of(bench.backend, one.protocol).duration if one.protocol else bench.backend.duration
            )
            test = None if one.protocol else bench.matched.to_spec(dict(one.params))
            candidates.append(Candidate(one, duration, able, len(runs.get(one, [])), test))
        return candidates


def _campaign(
    work: _Work,
    machine: Backend,
    budget: int | None,
    folder: Path | None,
    protocols: Sequence[str] | None,
    passive: bool,
) -> _Data:
    """Run a campaign: a fixed plan, then the experiments that best separate what is open, until nothing is."""
    bench = work.bench
    tests = star(bench.spec.space)
    runnable, refusals = allowed_experiments(bench.backend, machine, () if passive else protocols)
    fixed = plan(bench, tests, runnable, BUDGET if budget is None else budget, work.seed)
    others = () if passive else with_protocols_of(bench.backend, runnable)
    middle = representative(fixed.tests.values(), bench.spec.space)
    studied = tests if runnable else middle
    work.tell.expect(
        lambda: Cost(
            on_machine(machine, fixed, folder),
            work.simulated([*(as_experiment(bench, test) for test in studied), *others]),
            planned_held_out(fixed),
            smallest_with_held_out(bench.spec.space.dim),
        )
    )
    refuse_memory(bench, work.seed)
    progress = partial(work.tell, "real rollouts")
    # The library comes first: a simulator that cannot be diagnosed costs no rollout of the machine.
    if not runnable:
        work.library([as_experiment(bench, test) for test in middle[:1]])
        rollouts = campaign(bench, machine, fixed, work.seed, folder=folder, progress=progress)
        rollouts = replace(rollouts, notes=(*refusals, *rollouts.notes))
        return _data_of_tests(work, rollouts, others, frozenset(), " at the other tests")
    experiments = [as_experiment(bench, test) for test in tests]
    responses = work.library([*experiments, *others])
    before = _Data(
        RealRollouts(), TrainHeldOut(RealRollouts(), ()), responses, frozenset([*experiments, *runnable])
    )

    def choose(train: RealRollouts, dropped: frozenset[str]) -> Experiment | None:
        current = estimate(bench.backend, responses, train.by_experiment(bench), corrections=0)
        if not with_status(_sizes(work, current), Status.POSSIBLE):
            return None
        best = next_test(InformationForecast.of(current), before.candidates(bench, train, dropped))
        return None if best is None else best.candidate.experiment

    rollouts = campaign(bench, machine, fixed, work.seed, choose, folder, progress)
    rollouts = replace(rollouts, notes=(*refusals, *rollouts.notes))
    return replace(before, rollouts=rollouts, parts=split(rollouts, work.seed, fixed.held_out))


def _recordings(work: _Work, rollouts: RealRollouts, protocols: Sequence[str] | None, passive: bool) -> _Data:
    run = list(dict.fromkeys(experiment for experiment, _ in rollouts.protocols))
    runnable, _ = allowed_experiments(work.bench.backend, work.bench.backend, () if passive else protocols)
    others = () if passive else with_protocols_of(work.bench.backend, [*run, *runnable])
    return _data_of_tests(work, rollouts, [*run, *others], frozenset([*run, *runnable]))


def _with_rival_loop(
    work: _Work, data: _Data, protocols: Sequence[str] | None, passive: bool
) -> tuple[_Work, _Data]:
    """Return the work and the data with the loop that the tests show, where the recordings have shown none."""
    bench, tests = work.bench, data.train(work.bench)
    if work.loop is not None or work.files is None or any(one.protocol for one in tests):
        return work, data
    loop = rival_loops(bench, data.responses, tests, size_prior(data.responses), work.cache, work.tell)
    work = replace(work, loop=loop)
    if loop is None or not loop.names or not isinstance(bench.backend, HasLoop):
        return work, data
    work = replace(work, bench=replace(bench, backend=bench.backend.with_mistakes(loop.mistakes)))
    return work, _recordings(work, data.rollouts, protocols, passive)


def _data_of_tests(
    work: _Work,
    rollouts: RealRollouts,
    others: Sequence[Experiment],
    allowed: frozenset[Experiment],
    where: str = "",
) -> _Data:
    bench = work.bench
    parts = split(rollouts, work.seed)
    run = [test for test, _ in parts.train.tests]
    tests = representative(run or star(bench.spec.space), bench.spec.space)
    experiments = [as_experiment(bench, test) for test in tests]
    needed = list(dict.fromkeys([*experiments, *others]))
    if not where:
        held_out = len({key_of(test) for test, _ in parts.held_out})
        work.tell.expect(lambda: Cost(None, work.simulated(needed), held_out))
        refuse_memory(bench, work.seed)
    responses = work.library(needed, where)
    different = len({key_of(test) for test in run})
    if different > len(tests):
        note = f"sizes come from the runs at {len(tests)} of the {different} recorded tests, which fill the space"
        rollouts = replace(rollouts, notes=(*rollouts.notes, note))
    return _Data(rollouts, parts, responses, allowed | frozenset(experiments))


def _sizes(work: _Work, estimate: Estimate) -> tuple[EffectEstimate, ...]:
    families = {effect.name: effect.family for effect in catalogue_of(work.bench.backend)}
    return effect_estimates(
        estimate.posterior, estimate.fit.likelihood, estimate.library.parameters, families
    )


def _answer(work: _Work, data: _Data, want_where: bool) -> Diagnosis:
    bench, seed, tell = work.bench, work.seed, work.tell
    tests, parts, axes = data.rollouts.tests, data.parts, data.responses.parameters
    used = [*parts.train.tests, *parts.held_out]
    odd = likely_findings(work.counted("checking the recordings"), tests, axes, work.loop)
    # Tests at which a rollout ended early come last, so that an accident changes no seed of another test.
    ordered = sorted(tests, key=lambda run: run[1].failure is not None)
    nominal = Nominal.of(work.counted("simulating all tests"), [test for test, _ in ordered], seed)
    if work.mistakes and work.files is not None:
        nominal = replace(nominal, files=Nominal.of(work.files, [test for test, _ in ordered], seed))
    tell("estimating sizes", 0, 0)
    refine = partial(refined_at, bench.backend, data.responses, bench.pool, tell, work.cache)
    fitted = estimate(bench.backend, data.responses, data.train(bench), executor=bench.pool, refine=refine)
    sizes = _sizes(work, fitted)
    tuned = data.responses.values(mean_sizes(fitted.posterior))
    patch = {one.effect: one.values for one in with_status(sizes, Status.NAMED)}
    forecast, candidates = InformationForecast.of(fitted), data.candidates(bench, parts.train)
    tell("gap before and after", 0, 0)
    at_tests = compared_at_all_tests(bench, tests, nominal) if tests else None
    evidence = Evidence(
        sizes,
        further_causes(fitted.posterior, sizes),
        fitted.misfit,
        separations(forecast, [one.effect for one in with_status(sizes, Status.POSSIBLE)], candidates),
        held_out_gap(bench, parts.held_out, parts.train.tests, patch, tuned, nominal, at_tests),
        at_tests,
        left=remainders(work.counted("unexplained motion"), axes, used, tuned, seed, patch),
        findings=odd,
        loop=work.loop,
    )
    upcoming = next_test(forecast, candidates) if with_status(sizes, Status.POSSIBLE) else None
    why, alone = early_ends(bench, fitted.library, tests, nominal)
    lacking = notes(bench, tests, parts, data.responses.idle, why, odd, alone)
    return Diagnosis(
        Which(evidence, by_effects(fitted.posterior, axes), upcoming),
        locate(bench, used, tuned, seed, tell) if want_where and used else None,
        tuned,
        provenance(bench, seed, data.rollouts, len(parts.held_out)),
        ASSUMPTIONS,
        (*lacking, *data.rollouts.notes, *([work.loop.words] if work.loop and not work.loop.sure else [])),
        passive=not data.rollouts.protocols,
        breaking=breaking_sizes(bench, fitted.library, tests, sizes),
    )
