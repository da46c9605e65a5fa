"""The loop of code around a machine's controller: that of the simulator's files, or one with mistakes.

A mistake is no effect: it has no size. Where recordings show one, the simulator gets the same loop, and the effects are
estimated beside it. How recordings show it, says the backend (:class:`s2r_spec.backend.HasLoop`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from s2r_spec.backend import LOG, HasLoop, LoopMistake
from s2r_spec.base.json_values import Shown
from s2r_spec.diagnose.inference.prior import LIKELY, POSSIBLE, SURE
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.simulator.bench import Bench, TestRun

FILES = "the loop of the files"
"""Definition: words for it."""


@dataclass(frozen=True)
class Loop(Shown):
    """The loop that recordings show.

    Attributes:
        mistakes: what is wrong with it; () for the loop of the files.
        probability: of this loop, among those that were tried.
        rivals: the next loops, in words, each with its probability.
        words: what shows it, as a sentence.
        channels: what stands in them, the controller had at its ticks.
        explained: whether the loop explains what it is compared with.
    """

    mistakes: tuple[LoopMistake, ...]
    probability: float
    rivals: tuple[tuple[str, float], ...]
    words: str
    channels: frozenset[str] = frozenset()
    explained: bool = True

    JSON = "mistakes probability rivals words explained"

    @property
    def sure(self) -> bool:
        """Whether it is the loop of the machine."""
        return self.explained and self.probability >= SURE

    @property
    def names(self) -> tuple[str, ...]:
        """The mistakes that the loop surely has, each in words."""
        return tuple(one.name for one in self.mistakes) if self.sure else ()

    @property
    def is_stated(self) -> bool:
        """Whether files can state the loop, so that a simulator has it; not where a mistake begins later."""
        return all(one.keys for one in self.mistakes)

    def failing(self, where: str) -> Loop:
        """Return the loop with words on the simulator that fails with it somewhere."""
        words = f"With it the simulator fails in {where}, so no effect is estimated beside it."
        return replace(self, words=f"{self.words} {words}")

    @property
    def possible(self) -> tuple[str, ...]:
        """Loops with a mistake, in words, of which more likely than not the machine has one; () where one is sure."""
        every = dict([(words_of(self.mistakes), self.probability), *self.rivals])
        if self.sure or every.pop(FILES, 0.0) >= LIKELY:
            return ()
        return tuple(words for words, p in every.items() if p >= POSSIBLE)


def with_loop_of(bench: Bench, rollouts: Sequence[TestRun]) -> tuple[Bench, Loop | None]:
    """Return a bench whose simulator has the loop of the recordings, and that loop; None where they show none."""
    traces = [trace for _, trace in rollouts]
    if not isinstance(bench.backend, HasLoop) or not traces:
        return bench, None
    found = bench.backend.replayed(traces)
    loop = None
    if found is not None and found.explained and found.probability >= SURE:
        rivals = tuple((words_of(mistakes), p) for mistakes, p in found.rivals)
        words = (
            f"On the recorded state, this loop leaves {100.0 * found.share:.3g} % of {found.output} unexplained, and "
            f"that of the files {100.0 * found.files:.3g} %."
        )
        words = words if found.mistakes else ""
        loop = Loop(found.mistakes, found.probability, rivals, words, found.channels)
    elif found is not None:
        words = (
            f"on the recorded state no loop explains {found.output}: the nearest, {words_of(found.mistakes)}, leaves "
            f"{100.0 * found.share:.3g} % of it"
        )
        loop = Loop(found.mistakes, found.probability, (), words, explained=False)
    known = loop is not None and loop.sure and loop.is_stated
    backend = bench.backend.with_mistakes(loop.mistakes if loop is not None and known else ())
    return replace(bench, backend=backend.as_logged(traces)), loop


def unstated(loop: Loop | None) -> tuple[Finding, ...]:
    """Return the mistakes of a loop that is sure and that no file can state: nothing is estimated beside these."""
    if loop is None or not loop.names or loop.is_stated:
        return ()
    text = f"the code around the controller has a mistake: {', '.join(loop.names)}. Correct it, then record again"
    return (Finding("loop", "the loop", text, certain=True),)


def words_of(mistakes: Sequence[LoopMistake]) -> str:
    """Return the mistakes of a loop in words."""
    return " and ".join(one.name for one in mistakes) or FILES


def by_loop(bench: Bench, rollouts: Sequence[TestRun]) -> list[Finding]:
    """Return how the control loop of the recordings differs from that of the simulator's files, where files state one.

    Only what no physics explains counts: a delay and other gains are effects, too.
    """
    if not isinstance(bench.backend, HasLoop):
        return []
    found: dict[str, Finding] = {}
    for _, trace in rollouts:
        for one in bench.backend.loop(trace):
            if one.certain:
                rows = f" ({'; '.join(one.table)})" if one.table else ""
                whose = "" if one.topic == LOG else f"the robot's loop is not that of {bench.backend.name}: "
                text = f"{whose}{one.words}{rows}. "
                remedy = "Correct the code on the robot or the file, then record again"
                found.setdefault(one.words, Finding("loop", one.topic, text + remedy, certain=True))
    return list(found.values())
