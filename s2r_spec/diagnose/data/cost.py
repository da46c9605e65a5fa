"""What a diagnosis will cost, known before its first rollout.

Numbers of rollouts are largest ones: a campaign ends earlier when nothing is open. The simulator's are those of the
library; the fits after it run as many more as they need. Times [s] are sums of declared costs. The simulator's are
multiplied by the measured time of one rollout over its declared cost.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Protocol, runtime_checkable

from s2r_spec.backend import Backend
from s2r_spec.backend.protocols import HasProtocols
from s2r_spec.diagnose.data.campaign import CampaignPlan
from s2r_spec.diagnose.data.journal import TRACES
from s2r_spec.diagnose.data.split import number_held_out
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.observables import Observables
from s2r_spec.diagnose.simulator.runs import SEED

PILOT_TIME = 0.2
"""Budget: time [s] in which rollouts are repeated to measure theirs; one at least."""
TINY = 1e-9
"""Tolerance: least declared cost of a rollout [s]."""


@dataclass(frozen=True)
class Expected:
    """Rollouts on one backend: their largest number, and their time on one core [s]."""

    backend: str
    rollouts: int
    seconds: float


@dataclass(frozen=True)
class Cost:
    """What a diagnosis will cost.

    Attributes:
        real: the rollouts that the machine still has to run; None for recordings.
        simulated: the rollouts of the simulator's library.
        held_out: number of held-out tests; without any, no held-out gap is measured. None before the data.
        enough: smallest budget that holds tests out; None for recordings.
    """

    real: Expected | None
    simulated: Expected
    held_out: int | None
    enough: int | None = None


@runtime_checkable
class TellsCost(Protocol):
    """A progress that is also told the cost, before the first rollout."""

    def expect(self, cost: Cost) -> None:
        """Take the cost."""
        ...


def on_machine(machine: Backend, plan: CampaignPlan, folder: Path | None) -> Expected:
    """Return the rollouts of a campaign that are not yet in the folder of its traces."""
    done = 0 if folder is None else len(list(folder.glob(TRACES)))
    ahead = plan.steps[done:]
    chosen = plan.chosen - max(0, done - len(plan.steps))
    seconds = _seconds(machine, Counter(ahead)) + chosen * float(machine.cost)
    return Expected(machine.name, len(ahead) + chosen, seconds)


def of_library(backend: Backend, rollouts: Mapping[Experiment, int]) -> Expected:
    """Return the rollouts of a library: experiment → number. One of these experiments is run, to measure its time."""
    ahead = {experiment: count for experiment, count in rollouts.items() if count}
    seconds = 0.0
    for one in list(ahead)[:1]:
        seconds = _seconds(backend, ahead) * _measured(backend, one) / _seconds(backend, {one: 1})
    return Expected(backend.name, sum(ahead.values()), seconds)


def _measured(backend: Backend, experiment: Experiment) -> float:
    """Return the mean time of a nominal rollout and its observables [s], without the first, which may compile code."""

    def observed(observables: Observables | None = None) -> Observables:
        trace = experiment.with_residuals(experiment.run(backend, SEED), backend)
        observables = observables or Observables.of_nominal([trace])
        observables.vector(trace)
        return observables

    observables, began, count = observed(), perf_counter(), 0
    while perf_counter() - began < PILOT_TIME:
        observed(observables)
        count += 1
    return (perf_counter() - began) / count


def planned_held_out(plan: CampaignPlan) -> int:
    """Return the number of tests that a campaign will hold out."""
    return plan.held_out or number_held_out(len(set(plan.steps)), len(plan.steps))


def _seconds(backend: Backend, rollouts: Mapping[Experiment, int]) -> float:
    protocols = backend.protocols() if isinstance(backend, HasProtocols) else ()
    costs = {protocol.name: float(protocol.cost) for protocol in protocols}
    usual = float(backend.cost)
    return sum(count * max(costs.get(e.protocol, usual), TINY) for e, count in rollouts.items())
