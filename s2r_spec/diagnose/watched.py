"""What a stage of a diagnosis says while it runs: its own count, or that of the rollouts that were run for it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from s2r_spec.diagnose.data.cost import Cost, TellsCost
from s2r_spec.diagnose.simulator.bench import WATCH

Progress = Callable[[str, int, int], None]


class Watched:
    """Passes (stage, done, of) on; a stage of 0 counts every rollout, for a fit does not know how many it takes."""

    def __init__(self, tell: Progress) -> None:
        self._tell = tell
        self._stage, self._rollouts, self._counted = "", 0, True

    def __call__(self, stage: str, done: int, of: int) -> None:
        """Tell of a stage; with ``of`` 0 the rollouts that are run from here on are its count."""
        self._stage, self._rollouts, self._counted = stage, 0, of > 0
        self._tell(stage, done, of)

    def expect(self, cost: Callable[[], Cost]) -> None:
        """Tell the cost, if the caller wants to know it; ``cost`` is called only then."""
        if isinstance(self._tell, TellsCost):
            self._tell.expect(cost())

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Count the rollouts of every stage that has no count."""
        token = WATCH.set(self._ran)
        try:
            yield
        finally:
            WATCH.reset(token)

    def _ran(self, rollouts: int) -> None:
        if not self._counted:
            self._rollouts += rollouts
            self._tell(self._stage, self._rollouts, 0)
