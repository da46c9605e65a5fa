"""Rollouts without a trace: their worker died, or did not answer in time. They are crashes, and count as a fall."""

from __future__ import annotations

from s2r_spec.base.errors import BackendError
from s2r_spec.runs.task import Done, Task
from s2r_spec.workers.limits import TimeLimitError

STRIKES = 3
"""Budget: workers that a rollout may break before it counts as a crash."""


def workers_died(task: Task) -> Done:
    """Return the outcome of a rollout whose worker died ``STRIKES`` times."""
    return Done(task, None, 0.0, f"crash: the worker died {STRIKES} times")


def no_answer(task: Task, error: TimeLimitError) -> Done:
    """Return the outcome of a rollout that exceeded its time limit.

    Raises:
        BackendError: the backend did not open in time, so the rollout never ran.
    """
    if error.limit.opening:
        raise BackendError(f"backend {task.backend!r} did not open within {error.words}") from None
    return Done(task, None, error.elapsed, f"crash: no answer within {error.words}")
