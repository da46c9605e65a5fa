"""Options of a run, as one value. :func:`check`, :func:`gap` and :func:`certify` take them as keywords."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Required, TypedDict

from s2r_spec.backend import Operator
from s2r_spec.base.errors import UsageError
from s2r_spec.certify.search.observers import Observer, Silent
from s2r_spec.machine.attendance import Terms, terms_of
from s2r_spec.runs.machine_journal import AGAIN
from s2r_spec.runs.passed import PassedBackend
from s2r_spec.runs.runner import Runner
from s2r_spec.runs.seeds import NEW_SEED
from s2r_spec.runs.stop_rule import as_stop
from s2r_spec.workers.pools import ExecutorFactory, in_this_process, process_pool


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
        return self.observer or Silent()


@dataclass(frozen=True, kw_only=True)
class RunOptions(Execution):
    """Options of a run against a specification, in addition to :class:`Execution`.

    Args:
        requirement: the name of the requirement; None if the specification has only one.
        budget: most rollouts; None for as many as the specification's ε takes. Of a gap it bounds the real rollouts.
        stop: when the search ends: "epsilon" (the interval is ε wide), "decided" (the verdict is known) or "budget".
            None is the rule of a resumed search, and "epsilon" for a new one. The bound holds under every rule.
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
    mode: str = "rigorous"
    engine: str = "spectral"
    void: str = AGAIN
    operator: Operator | None = None
    terms: Terms = field(init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "terms", terms_of(self.void, self.operator))
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
