"""Options of a run, as one value, which :func:`check`, :func:`gap` and :func:`certify` take as keywords.

The seed and the stopping rule of a resumed run are those that it began with.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Required, TypedDict, TypeVar

from s2r_spec.backend import Operator
from s2r_spec.base.errors import UsageError, one_of
from s2r_spec.certify.arguments import as_folder
from s2r_spec.certify.search.observers import Observer
from s2r_spec.machine.attendance import Terms
from s2r_spec.machine.operator import Terminal
from s2r_spec.runs import layout
from s2r_spec.runs.journal import Journal
from s2r_spec.runs.lines import is_count
from s2r_spec.runs.machine_journal import AGAIN
from s2r_spec.runs.passed import PassedBackend
from s2r_spec.runs.runner import Runner
from s2r_spec.runs.seeds import NEW_SEED, inherited_seed
from s2r_spec.runs.stop_rule import BUDGET, DECIDED, EPSILON, as_stop, repeats_of, stop_of
from s2r_spec.workers.pools import ExecutorFactory, in_this_process, process_pool

Options = TypeVar("Options", bound="Execution")


class ExecutionKeywords(TypedDict, total=False):
    """Keywords of :class:`Execution`."""

    seed: int | None
    executor: ExecutorFactory | None
    workers: int | None
    timeout: float | None
    resume: bool
    observer: Observer | None


class RunKeywords(ExecutionKeywords, total=False):
    """Keywords of ``check``, ``gap`` and ``certify``; :class:`RunOptions` describes them and has their defaults."""

    requirement: str | None
    budget: int | None
    stop: str | None
    repeats: bool | None
    mode: str
    engine: str
    void: str
    operator: Operator | None


class MeasureKeywords(ExecutionKeywords, total=False):
    """Keywords of ``check_measure``; :class:`MeasureOptions` describes them and has their defaults."""

    fall: Required[float]
    duration: float | None


@dataclass(frozen=True, kw_only=True)
class Execution:
    """How rollouts are run.

    Args:
        seed: the seed of the whole run; None for the seed of a resumed run, and 0 for a new one.
        executor: a function that makes the pool of workers. By default two processes of this computer, or one
            thread of this process for a backend object that no other process can load (a class of a notebook).
        workers: how many processes of this computer run rollouts, in place of ``executor``.
        timeout: a rollout that uses more CPU time, or ten times as much wall time, is ended, and counts as a crash
            [s]; on a machine it is wall time. ``inf`` for never, None for
            :func:`s2r_spec.runs.scorer.default_timeout`.
        resume: go on with the run in the folder.
        observer: receives batches and rollouts, to show them.
    """

    seed: int | None = None
    executor: ExecutorFactory | None = None
    workers: int | None = None
    timeout: float | None = None
    resume: bool = False
    observer: Observer | None = None

    def __post_init__(self) -> None:
        if self.workers is not None and self.executor is not None:
            raise UsageError("give either workers or executor")
        if self.workers is not None and self.workers < 1:
            raise UsageError(f"workers = {self.workers}; at least 1 is needed")

    def runner(self, *passed: PassedBackend | None) -> Runner:
        """Return a runner with a pool of its own, for these backend objects; close it."""
        portable = all(one is None or one.portable for one in passed)
        if not portable and (self.workers or 1) > 1:
            raise UsageError("no other process can load this backend object; leave out workers")
        usual = process_pool(self.workers or 2) if portable else in_this_process
        return Runner(self.executor or usual, self.timeout)

    @property
    def fixed_seed(self) -> int:
        """The seed, or that of a new run."""
        return NEW_SEED if self.seed is None else self.seed

    @property
    def watching(self) -> Observer:
        """The observer, or one that shows nothing."""
        return self.observer or Observer()


@dataclass(frozen=True, kw_only=True)
class RunOptions(Execution):
    """Options of a run against a specification, in addition to :class:`Execution`.

    Args:
        requirement: the name of the requirement; None if the specification has only one.
        budget: most rollouts; None for as many as the specification's ε takes. Of a gap it bounds the real rollouts.
        stop: when the search ends: "epsilon" (the interval is ε wide), "decided" (the verdict is known) or "budget".
            None is the rule of a resumed search; for a new one "decided" in a check, and "epsilon" in a gap and a
            certificate. The bound holds under every rule.
        repeats: whether a batch repeats tests once the verdict is known and only the test of R lacks outcomes. None is
            the answer of a resumed search; for a new one True if ``stop`` is "decided".
        mode: the mode of the confidence set, see :class:`~s2r_spec.certify.bound.settings.SearchSettings`.
        engine: the engine of the Gaussian process, see :class:`~s2r_spec.certify.bound.settings.SearchSettings`.
        void: the treatment of a void rollout, on a machine only: "again" repeats the test, "fall" counts
            the rollout as a fall.
        operator: the person who answers, for a machine; whoever is at this process's terminal if None.

    Raises:
        UsageError: ``void`` is neither word, or there is no such stopping rule.
    """

    requirement: str | None = None
    budget: int | None = None
    stop: str | None = None
    repeats: bool | None = None
    mode: str = "rigorous"
    engine: str = "spectral"
    void: str = AGAIN
    operator: Operator | None = None
    terms: Terms = field(init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "terms", Terms(self.void, self.operator or Terminal()))
        if self.stop is not None:
            as_stop(self.stop)


@dataclass(frozen=True, kw_only=True)
class MeasureOptions(Execution):
    """Options of a run with a measure instead of a requirement, in addition to :class:`Execution`.

    Args:
        fall: value of a rollout that fails, in the unit of the measure.
        duration: length of a rollout [s]; the backend's own if None.

    Raises:
        UsageError: ``fall`` is not a finite number.
    """

    fall: float
    duration: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.fall, int | float) or not math.isfinite(self.fall):
            raise UsageError(
                f"fall, the value of a failed rollout, must be a finite number, not {self.fall!r}"
            )


@contextmanager
def run_folder(folder: Any, name: str, options: Execution) -> Iterator[Path]:
    """Give the folder of a run; for None a new one in ``s2r-runs``, which goes again if nothing was written into it.

    A resumed run whose folder is not given is a UsageError.
    """
    if folder is not None:
        yield as_folder(folder)
        return
    if options.resume:
        raise UsageError("to resume a run, give its folder")
    new = layout.new_run(name, options.fixed_seed)
    try:
        yield new
    finally:
        with suppress(OSError):  # it has files
            new.rmdir()


def require_begun(places: list[Path], run: Path) -> None:
    """Refuse to resume a run that has a journal in none of the places with a UsageError."""
    if not any(map(Journal.exists, places)):
        looked = ", ".join(map(str, places))
        raise UsageError(
            f"no run to resume in {run}: there is no journal in {looked}; begin one without resume"
        )


def with_rule(options: RunOptions, *places: Path, usual: str = EPSILON) -> RunOptions:
    """Return options with a stopping rule: the given one, or that of the resumed journal in one of the places.

    A new run without a given one has the ``usual`` one of its command. A resumed run repeats tests if it began so. The
    rule "budget" without a budget is a UsageError.
    """
    stop, repeats = options.stop, options.repeats
    begun = [place for place in places if options.resume and Journal.begun(place)]
    header = Journal.read(begun[0]).header if begun else None
    if stop is None:
        stop = usual if header is None else stop_of(header)
    if repeats is None:
        repeats = stop == DECIDED if header is None else repeats_of(header)
    if stop == BUDGET and options.budget is None:
        raise UsageError("stop = 'budget' needs a budget: the largest number of rollouts")
    return replace(options, stop=stop, repeats=repeats)


def with_seed(options: Options, *places: Path) -> Options:
    """Return options with a seed: the given one, or that of the resumed run; see :func:`seed_of`."""
    return replace(options, seed=seed_of(options.seed, *(places if options.resume else ())))


def seed_of(given: int | None, *places: Path) -> int:
    """Return the seed of a run: the given one, that of the journals of a resumed run, or that of a new one.

    A seed that differs from that of the resumed run is a UsageError.
    """
    for place in places:
        seed = Journal.header_in(place).get("seed")
        if seed is not None and is_count(seed):  # the check of the whole header names a fault
            return inherited_seed(place, seed, given)
    return NEW_SEED if given is None else given


def places_of(folder: Path, requirements: Sequence[str], resume: bool) -> dict[str, Path]:
    """Return requirement → folder of its journal, for a run that checks several requirements.

    The folder of a resumed run may also be that of one of its journals. A folder without such a run is a UsageError.
    """
    if not resume:
        return layout.places(folder, requirements, None)
    places = layout.places(folder, requirements, _direct_requirement(folder, requirements))
    require_begun([*places.values()], folder)
    return places


def _direct_requirement(folder: Path, requirements: Sequence[str]) -> str | None:
    """Return the requirement whose journal lies directly in a folder; None if the folder holds a whole run."""
    header = Journal.header_in(folder)
    own = header.get("requirement")
    if header and (own not in requirements or "side" in header):
        of = f"of the requirement {own!r}" if own not in requirements else "a part of a gap"
        raise UsageError(
            f"the run in {folder} is {of}, but this command checks {one_of(requirements)}; begin a new run with --run"
        )
    return own


def refuse_rule(stop: str, backend: str) -> None:
    """Refuse any stopping rule but the usual one for recordings with a UsageError."""
    if stop != EPSILON:
        raise UsageError(
            f"stop = {stop!r} does not apply to {backend}: its tests are fixed, and s2r uses all of its recordings"
        )
