"""Which of the candidate mistakes is a finding: one rule for all; see the package."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.quality.clock import clock
from s2r_spec.diagnose.quality.comparison import Comparison, Rollout, compare
from s2r_spec.diagnose.quality.direct import direct
from s2r_spec.diagnose.quality.exchanged import exchanged
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.frame import offset, turned
from s2r_spec.diagnose.quality.glitches import glitches
from s2r_spec.diagnose.quality.hold import hold
from s2r_spec.diagnose.quality.labels import labels, others
from s2r_spec.diagnose.quality.late import late
from s2r_spec.diagnose.quality.physics import nearest
from s2r_spec.diagnose.quality.scale import scale
from s2r_spec.diagnose.quality.sign import sign
from s2r_spec.diagnose.quality.suspects import Suspect
from s2r_spec.diagnose.simulate import Bench

MOST = 0.75
"""Level: part of what the best machine leaves beyond the usual that undoing a mistake must remove. At twice the
distance from 1 it finds mistakes beside larger unknown effects, and takes more unknown effects for mistakes."""
CLEAR = 0.15
"""Level: of the usual misfit, by which a discrepancy is there at all. Twice as much misses mistakes that are 1.4 times
as large; a third as much takes scatter for one."""
SAME = 0.1
"""Tolerance: of the usual misfit, within which two explanations are the same."""
NEARLY = 0.95
"""Level: part of what the best mistake removes from which on another one is a finding beside it. At twice the distance
from 1 poorer ones are said, too."""
PROMISING = 0.3
"""Budget: as MOST, for candidates that are tried again beside effects. Twice as much tries fewer of them."""
APART = ("still", "wrapped", "unit", "unit of one", "spike", "stopped")
"""Definition: codes of findings whose channels are not compared with the others."""
TOGETHER = {
    "late": ("late", "begin"),
    "clock": ("clock", "begin"),
    "exchanged": ("exchanged", "sign", "begin"),
}
"""Definition: by code, what the same mistake also looks like to checks that see one channel alone."""
AGAIN = 2
"""Budget: such candidates. Twice as many cost twice the simulations."""


@dataclass(frozen=True, eq=False)
class _Judged:
    """A candidate.

    Attributes:
        suspect: it.
        before: ℓ of the recordings as they are, beside effects.
        after: with it undone.
        bare: as ``before``, beside no effect.
        alone: as ``after``, beside no effect.
    """

    suspect: Suspect
    before: float
    after: float
    bare: float
    alone: float


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
    first = [*glitches(bench, rollouts), *direct(bench, rollouts, lines)]
    held, straight = hold(bench, rollouts)
    wrong = [each.channel for each in first if each.code in APART]
    c = compare(bench, straight, lines, executor, progress, wrong)
    found = [] if c is None else suspected(bench, c, straight, executor, progress)
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
    found = [suspect for check in checks for suspect in check(c)]
    found += labels(c, others(bench, c, rollouts, executor, progress))
    judged = sorted((_judged(c, suspect) for suspect in found), key=lambda one: one.after)
    clear = CLEAR * c.usual
    good = [
        one
        for one in judged
        if _removed(one, one.before, c.usual) >= MOST and one.before - one.after >= clear
    ]
    same = [one for one in judged if one.alone <= c.usual + clear <= one.bare - one.alone + c.usual]
    same = [one for one in same if one not in good]
    promising = [
        one
        for one in judged
        if _removed(one, one.before, c.usual) >= PROMISING and one.before - one.after >= clear
    ]
    if not good and not same and not promising:
        return []
    machine, _ = nearest(bench, c, c.recorded, executor)
    machines = [machine]
    if not good and not same and machine.misfit(c.recorded) > (1.0 + CLEAR) * machine.usual:
        for one in promising[:AGAIN]:
            beside, _ = nearest(bench, one.suspect.beside or c, one.suspect.values, executor)
            left = beside.misfit(one.suspect.values, there=one.suspect.there) + beside.volume - c.volume
            good.append(replace(one, after=min(one.after, left + one.suspect.volume)))
            machines.append(beside)

    def physics(one: _Judged) -> float:
        left = [
            each.misfit(c.recorded, there=one.suspect.there) + each.volume - c.volume for each in machines
        ]
        return min(one.before, *left)

    out: dict[str, tuple[float, Finding]] = {}
    for one in sorted((*good, *same), key=lambda one: one.after):
        best, finding = physics(one), one.suspect.finding
        if _removed(one, best, c.usual) >= MOST and best - one.after >= clear:
            out.setdefault(finding.code, (best - one.after, finding))
        elif one.alone <= min(best + SAME * c.usual, c.usual + clear) and one.bare - one.alone >= clear:
            out.setdefault(finding.code, (one.bare - one.alone, replace(finding, same=True)))
    most = max((removed for removed, _ in out.values()), default=0.0)
    return [finding for removed, finding in out.values() if removed >= NEARLY * most]


def _judged(c: Comparison, suspect: Suspect) -> _Judged:
    before = c.misfit(c.recorded, there=suspect.there)
    mine = suspect.beside or c
    after = mine.misfit(suspect.values, there=suspect.there)
    bare = c.misfit(c.recorded, effects=False, there=suspect.there)
    alone = mine.misfit(suspect.values, effects=False, there=suspect.there)
    return _Judged(suspect, before, after + suspect.volume, bare, alone + suspect.volume)


def _removed(one: _Judged, before: float, usual: float) -> float:
    """Return the part of what is beyond the usual, or beyond what is left if less, that undoing a mistake removes."""
    beyond = before - min(usual, one.after)
    return (before - one.after) / beyond if beyond > 0.0 else 0.0
