"""Which of the candidate mistakes is a finding: one rule for all; see the package."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.quality.clock import clock
from s2r_spec.diagnose.quality.comparison import Comparison, compare
from s2r_spec.diagnose.quality.direct import direct, glitches
from s2r_spec.diagnose.quality.exchanged import exchanged
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.frame import offset, turned
from s2r_spec.diagnose.quality.hold import hold
from s2r_spec.diagnose.quality.labels import labels
from s2r_spec.diagnose.quality.late import late
from s2r_spec.diagnose.quality.physics import nearest
from s2r_spec.diagnose.quality.recordings import Recordings, Rollout
from s2r_spec.diagnose.quality.scale import scale
from s2r_spec.diagnose.quality.sign import sign
from s2r_spec.diagnose.quality.suspects import Suspect
from s2r_spec.diagnose.simulate import Bench

MOST = 0.75
"""Level: part of what the best machine leaves beyond the usual that undoing a mistake must remove. At twice the
distance from 1 it finds mistakes beside larger unknown effects, and takes more unknown effects for mistakes."""
CLEAR = 0.15
"""Level: of the usual misfit, by which a discrepancy is there at all, and two explanations are not the same. Twice as
much misses mistakes that are 1.4 times as large; a third as much takes scatter for one."""
NEARLY = 0.95
"""Level: part of what the best mistake removes from which on another one is a finding beside it. At twice the distance
from 1 poorer ones are said, too."""
PROMISING = 0.3
"""Budget: as MOST, for candidates that are tried again beside effects. Twice as much tries fewer of them."""
AGAIN = 2
"""Budget: such candidates. Twice as many cost twice the simulations."""
APART = ("still", "wrapped", "unit", "unit of one", "spike", "stopped")
"""Definition: codes of findings whose channels are not compared with the others."""
TOGETHER = {
    "late": ("late", "begin"),
    "clock": ("clock", "begin"),
    "exchanged": ("exchanged", "sign", "begin"),
}
"""Definition: by code, what the same mistake also looks like to checks that see one channel alone."""


@dataclass(frozen=True, eq=False)
class _Judged:
    """A candidate.

    Attributes:
        suspect: it.
        usual: Q of a fresh nominal rollout.
        before: ℓ of the recordings as they are, beside effects.
        after: with it undone.
        bare: as ``before``, beside no effect.
        alone: as ``after``, beside no effect.
    """

    suspect: Suspect
    usual: float
    before: float
    after: float
    bare: float
    alone: float

    @classmethod
    def of(cls, c: Comparison, suspect: Suspect) -> _Judged:
        """Undo a mistake."""
        mine, there = suspect.beside or c, suspect.there
        before, bare = (c.misfit(c.recorded, effects, there) for effects in (True, False))
        after, alone = (mine.misfit(suspect.values, effects, there) for effects in (True, False))
        return cls(suspect, c.usual, before, after + suspect.volume, bare, alone + suspect.volume)

    def removes(self, least: float, before: float) -> bool:
        """Whether it clearly removes this part of what is beyond the usual, or beyond what is left if less."""
        removed, beyond = before - self.after, before - min(self.usual, self.after)
        return removed >= CLEAR * self.usual and removed >= least * beyond

    def alike(self, best: float) -> bool:
        """Whether it alone explains clearly more than nothing does, and as much as a machine that leaves ``best``."""
        clear = CLEAR * self.usual
        return self.bare - self.alone >= clear and self.alone <= min(best, self.usual) + clear


def findings(
    bench: Bench,
    rollouts: Sequence[Rollout],
    lines: Sequence[Line] = (),
    executor: Callable[[], Executor] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Finding, ...]:
    """Return the mistakes that the recordings seem to have.

    Args:
        bench: the simulator.
        rollouts: the machine's, in the order of their table.
        lines: of the catalogue.
        executor: makes a pool for the simulations.
        progress: called with (done, of).
    """
    of = Recordings(bench, rollouts)
    first = [*glitches(of), *direct(of, lines)]
    held, straight = hold(of)
    wrong = [each.channel for each in first if each.code in APART]
    c = compare(bench, straight.rollouts, lines, executor, progress, wrong)
    found = [] if c is None else suspected(bench, c, straight.rollouts, executor, progress)
    # What all channels say together is said of each of them no more.
    kinds = {kind for each in found for kind in TOGETHER.get(each.code, (each.code,))}
    return (*held, *found, *(each for each in first if each.code not in kinds))


def suspected(
    bench: Bench,
    c: Comparison,
    rollouts: Sequence[Rollout],
    executor: Callable[[], Executor] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Finding]:
    """Return the mistakes that explain what no machine does, or as much as the best machine; one of each code."""
    if c.misfit(c.recorded, effects=False) < c.usual:
        return []  # as the nominal simulator's: there is nothing to explain
    checks = (late, clock, exchanged, sign, scale, turned, offset)
    suspects = [
        *(one for check in checks for one in check(c)),
        *labels(bench, c, rollouts, executor, progress),
    ]
    judged = sorted((_Judged.of(c, suspect) for suspect in suspects), key=lambda one: one.after)
    promising = [one for one in judged if one.removes(PROMISING, one.before)]
    good = [one for one in promising if one.removes(MOST, one.before)]
    same = [one for one in judged if one.alike(np.inf) and one not in good]
    if not promising and not same:
        return []
    machines = [nearest(bench, c, c.recorded, executor)]
    if not good and not same and machines[0].misfit(c.recorded) > (1.0 + CLEAR) * machines[0].usual:
        for one in promising[:AGAIN]:
            beside = nearest(bench, one.suspect.beside or c, one.suspect.values, executor)
            left = _left(c, beside, one.suspect.values, one) + one.suspect.volume
            good.append(replace(one, after=min(one.after, left)))
            machines.append(beside)
    out: dict[str, tuple[float, Finding]] = {}
    for one in sorted((*good, *same), key=lambda one: one.after):
        best = min(one.before, *(_left(c, each, c.recorded, one) for each in machines))
        finding = one.suspect.finding
        if one.removes(MOST, best):
            out.setdefault(finding.code, (best - one.after, finding))
        elif one.alike(best):
            out.setdefault(finding.code, (one.bare - one.alone, replace(finding, same=True)))
    most = max((removed for removed, _ in out.values()), default=0.0)
    return [finding for removed, finding in out.values() if removed >= NEARLY * most]


def _left(c: Comparison, machine: Comparison, values: NDArray[np.float64], one: _Judged) -> float:
    """Return ℓ of recordings of a machine."""
    return machine.misfit(values, there=one.suspect.there) + machine.volume - c.volume
