"""The pre-flight of a backend that was put together from a user's files: do the files fit, and does it repeat?"""

from __future__ import annotations

from collections.abc import Iterator

from s2r_spec.backend import Backend, Finding, HasPreflight
from s2r_spec.base.errors import S2RError
from s2r_spec.runs.repeatability import difference
from s2r_spec.runs.task import Task, run_task
from s2r_spec.testing.subject import SEED
from s2r_spec.workers.pools import process_pool

FEW = 5
"""Definition: lines of a pre-flight that a search prints before it begins."""
_ORDER = ("wrong", "note", "ok")


def preflight(backend: Backend) -> Iterator[Finding]:
    """Yield every finding of a backend, then whether two processes give the same trace; nothing for other backends."""
    if not isinstance(backend, HasPreflight):
        return
    try:
        yield from backend.preflight(run=True)
        yield _repeats(backend)
    except S2RError as error:  # for instance a controller that raises
        yield Finding("rollout", str(error), "wrong")


def in_short(backend: Backend) -> list[Finding]:
    """Return the few findings without a rollout that matter most."""
    if not isinstance(backend, HasPreflight):
        return []
    return sorted(backend.preflight(run=False), key=lambda one: _ORDER.index(one.level))[:FEW]


def _repeats(backend: Backend) -> Finding:
    test = {p.name: p.default for p in backend.parameters}
    first = backend.rollout(test, SEED)
    again = backend.rollout(test, SEED)
    task = Task(0, 0, backend.name, test, SEED, duration=backend.duration)
    with process_pool(1)() as pool:
        other, _ = pool.submit(run_task, task).result()
    for trace, where in ((again, "a second rollout in one process"), (other, "a rollout in another process")):
        if found := difference(first, trace):
            return Finding("repeat", f"{where} gives another trace with the same seed: {found}", "wrong")
    return Finding("repeat", "two rollouts in two processes give the same trace, bit for bit")
