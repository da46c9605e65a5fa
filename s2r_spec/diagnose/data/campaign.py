"""A campaign: the experiments that a machine runs within a budget.

A plan with protocols has three parts, in this order:

    held out    6 tests that fill the space. They measure the gap before and after; no experiment is chosen by them.
    screen      the library's tests, then the allowed protocols, each twice, so that scatter is known everywhere.
    chosen      what the budget leaves. A rule chooses one experiment at a time from the train rollouts so far.

A smaller budget first leaves out second runs, the protocols' before the tests', which differ more. Then it holds out
fewer tests, down to 3. A plan without protocols has tests that fill the space. The first of them run again, and `split`
draws those that are held out.

A resumed campaign takes what its journal has, and chooses only what comes after. So it ends with the same rollouts, bit
for bit, if the machine is deterministic. An experiment that the machine refused counts in the budget.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory

from s2r_spec.backend import Backend, HasDuration, Recording
from s2r_spec.backend.protocols import HasProtocols, protocol_of
from s2r_spec.base.errors import UsageError
from s2r_spec.diagnose.data.journal import CampaignJournal
from s2r_spec.diagnose.data.rollouts import FEWEST, RealRollouts, as_experiment
from s2r_spec.diagnose.data.space_filling import spread
from s2r_spec.diagnose.data.split import LEAST, number_held_out
from s2r_spec.diagnose.simulator.bench import Bench, Test, refuse_machine
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.runs.compatibility import check_compatibility
from s2r_spec.runs.seeds import SeedStream, rollout_seed

BUDGET = 30
"""Budget: real rollouts of a machine when the user gives no number."""
HELD_OUT = 2 * LEAST
"""Definition: tests that a campaign holds out, if its budget is large enough."""
DISTINCT = 0.6
"""Budget: share of different tests in a plan without protocols; the rest are second and third runs."""

Choose = Callable[[RealRollouts, frozenset[str]], Experiment | None]
"""Chooses the next experiment from the train rollouts and the protocols that must not run again; None ends."""


@dataclass(frozen=True)
class CampaignPlan:
    """The experiments of a campaign that are fixed before it begins.

    Attributes:
        steps: the experiments in order, in the simulator's units.
        tests: experiment → its test in the spec's units.
        held_out: number of first experiments that are held out; 0 if they are drawn afterwards.
        chosen: largest number of further experiments.
    """

    steps: tuple[Experiment, ...]
    tests: Mapping[Experiment, Test]
    held_out: int = 0
    chosen: int = 0


def plan(
    bench: Bench, tests: Sequence[Test], protocols: Sequence[Experiment], budget: int = BUDGET, seed: int = 0
) -> CampaignPlan:
    """Return the plan of a campaign; the module says how a budget is shared.

    Without protocols it has tests that fill the space, else ``tests``, which the library simulates, in the spec's
    units.

    Raises:
        UsageError: the budget is smaller than 3 held-out tests, and each test and protocol once.
    """
    space = bench.spec.space
    if not protocols:
        distinct = _distinct_count(budget, space.dim)
        filling = spread(space, distinct, seed)
        places = [i if i < distinct else (i - distinct) // 2 % distinct for i in range(budget)]
        steps = tuple(as_experiment(bench, filling[place]) for place in places)
        return CampaignPlan(steps, {as_experiment(bench, test): test for test in filling})
    filling = spread(space, HELD_OUT, seed)
    known = {as_experiment(bench, test): test for test in (*filling, *tests)}
    screen = [*(as_experiment(bench, test) for test in tests), *protocols]
    spare = budget - LEAST - len(screen)
    if spare < 0:
        raise UsageError(
            f"a budget of {budget} rollouts is too small for {len(tests)} tests and {len(protocols)} protocols. It "
            f"takes {budget - spare}: {LEAST} tests that are held out, and one run each. Use a larger --budget, or "
            f"fewer --protocols"
        )
    held_out = min(HELD_OUT, LEAST + spare)
    spare -= held_out - LEAST
    again = min(spare, len(screen))
    twice = [e for place, e in enumerate(screen) for _ in range(2 if place < again else 1)]
    apart = [as_experiment(bench, test) for test in filling[:held_out]]
    return CampaignPlan((*apart, *twice), known, held_out, spare - again)


def smallest_with_held_out(dim: int) -> int:
    """Return the smallest budget of a plan without protocols that holds tests out, for so many test parameters.

    With protocols every plan does.
    """
    return next(budget for budget in count(1) if number_held_out(_distinct_count(budget, dim), budget))


def _distinct_count(budget: int, dim: int) -> int:
    return max(min(FEWEST, budget), round(budget * DISTINCT)) if dim else 1


def campaign(
    bench: Bench,
    machine: Backend,
    plan: CampaignPlan,
    seed: int,
    choose: Choose = lambda train, dropped: None,
    folder: Path | None = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> RealRollouts:
    """Run a campaign, or resume it from its folder; return its rollouts, those that are held out first.

    A protocol that the machine refuses, or in which it falls, is not run again. A note names the reason, and the fallen
    trace is kept. The machine itself asks about the risk of a protocol. Without a folder nothing is kept. ``progress``
    is called with the number of experiments and the budget.

    Raises:
        UsageError: the machine needs an operator, refuses a test, or does not fit the spec; or the folder has another
            campaign, or recordings without a campaign.
    """
    if folder is None:
        with TemporaryDirectory() as place:
            return campaign(bench, machine, plan, seed, choose, Path(place), progress)
    refuse_machine(machine)
    if isinstance(machine, HasDuration):
        machine = machine.with_duration(bench.backend.duration)
    matched, space = check_compatibility(bench.spec, bench.requirement, machine), bench.spec.space
    protocols = machine.protocols() if isinstance(machine, HasProtocols) else ()
    declared = (*(p for protocol in protocols for p in protocol.parameters), *machine.parameters)
    journal = CampaignJournal(folder, {p.name: p.unit for p in declared}, seed)
    rollouts, dropped, done = RealRollouts(), dict[str, str](), list[Experiment]()
    planned, budget = iter(plan.steps), len(plan.steps) + plan.chosen
    for number in range(budget):
        begun = journal.experiment(number)
        experiment = next((e for e in planned if e.protocol not in dropped), begun)
        if experiment is None:
            experiment = choose(replace(rollouts, tests=rollouts.tests[plan.held_out :]), frozenset(dropped))
        if experiment is None:
            break
        done.append(experiment)
        name = experiment.protocol
        if name:
            own = params = protocol_of(bench.backend, name).values(dict(experiment.params))
        else:
            chosen = bench.matched.to_spec(dict(experiment.params)) or {}
            own = dict(plan.tests.get(experiment) or space.point(space.vector(chosen)))
            params = matched.to_backend(own)
        draws = rollout_seed(seed, done.index(experiment), number, SeedStream.GAP_REAL)
        on_machine = Experiment(name, tuple(params.items()))
        trace = journal.run(number, experiment, params, partial(on_machine.run, machine, draws))
        progress(number + 1, budget)
        if trace is None:
            dropped[name] = f"the protocol {name!r} was not run: {journal.refused(number)}"
            continue
        rollouts = rollouts.plus(bench, Recording(f"real rollout {number}", own, trace, name))
        if name and trace.failure is not None:
            dropped[name] = (
                f"the protocol {name!r} ended early ({trace.failure}), so it was not run again; its samples before the "
                f"end are used"
            )
    return replace(rollouts, notes=tuple(dropped.values()))
