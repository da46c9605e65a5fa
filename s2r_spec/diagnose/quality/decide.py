"""Which of the candidate mistakes is a finding: one rule for all; see the package."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.quality.channels import by_channel, find_copied, hold
from s2r_spec.diagnose.quality.comparison import CLEAR, Comparison, compare, nearest_machine
from s2r_spec.diagnose.quality.faults import Fault, Undone, faults
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.labels import labels
from s2r_spec.diagnose.quality.law import by_law
from s2r_spec.diagnose.quality.loop import Loop, by_loop
from s2r_spec.diagnose.quality.recordings import Recordings
from s2r_spec.diagnose.simulator.axes import EffectAxis
from s2r_spec.diagnose.simulator.bench import Bench, TestRun
from s2r_spec.diagnose.simulator.practice import CAUSES

MOST = 0.75
"""Level: part of what the best machine leaves beyond the usual that undoing a mistake must remove; the rest is what a
candidate must remove to be tried beside effects."""


@dataclass(frozen=True, eq=False)
class _Judged:
    """A mistake, and ℓ without and with it undone: beside effects, and beside none."""

    finding: Finding
    undone: Undone
    usual: float
    clear: float
    before: float
    after: float
    bare: float
    alone: float

    @classmethod
    def of(cls, c: Comparison, fault: Fault) -> _Judged:
        finding, one = fault
        before, bare = (c.misfit(c.recorded, effects, one.there) for effects in (True, False))
        after, alone = (c.misfit(one.values, effects, one.there) + one.price for effects in (True, False))
        return cls(finding, one, c.usual, c.clear, before, after, bare, alone)

    def removes(self, part: float, before: float) -> bool:
        """Whether it clearly removes this part of what is beyond the usual, or beyond what is left if less."""
        removed, beyond = before - self.after, before - min(self.usual, self.after)
        return removed >= self.clear and removed >= part * beyond

    @property
    def alike(self) -> bool:
        return self.bare - self.alone >= self.clear and self.alone <= self.usual + self.clear


def findings(
    bench: Bench, rollouts: Sequence[TestRun], axes: Sequence[EffectAxis] = ()
) -> tuple[Finding, ...]:
    """Return the mistakes that the recordings, in the order of their table, have for certain, or else seem to have."""
    return certain_findings(bench, rollouts) or likely_findings(bench, rollouts, axes)


def certain_findings(bench: Bench, rollouts: Sequence[TestRun]) -> tuple[Finding, ...]:
    """Return the mistakes that no machine can explain; whatever else the recordings show follows from them."""
    of = Recordings(bench, rollouts)
    if other := by_loop(bench, rollouts):
        return tuple(other)
    broken = by_law(of)
    if any(one.code == "labels" for one in broken) and (copied := find_copied(of)):
        return tuple(replace(one, certain=True) for one in copied)
    return tuple(broken)


def likely_findings(
    bench: Bench, rollouts: Sequence[TestRun], axes: Sequence[EffectAxis] = (), loop: Loop | None = None
) -> tuple[Finding, ...]:
    """Return the mistakes that recordings seem to have beside the simulator, without those that their loop refutes."""
    of = Recordings(bench, rollouts)
    first = by_channel(of)
    held, straight = hold(of)
    c = compare(bench, straight.rollouts, axes, [each.channel for each in first])
    suspects = [] if c is None else find_suspects(bench, c, straight.rollouts, loop)
    return (*held, *suspects, *first)


def _is_refuted(finding: Finding, undone: Undone, c: Comparison, shown: frozenset[str]) -> bool:
    """Return whether the loop of a machine refutes a mistake of its recordings: the controller used these channels.

    What stands in them is what the controller had at its ticks. Of a clock nothing else is known: a loop that itself
    has another period is no mistake of the recordings.
    """
    others = {column.channel for column in c.columns} - undone.group
    if finding.code in ("clock", "begin"):
        return bool(shown)
    if finding.code == "late":
        return bool(shown & undone.group) and bool(shown & others)
    return bool(undone.group) and undone.group <= shown


def find_suspects(
    bench: Bench, c: Comparison, rollouts: Sequence[TestRun], loop: Loop | None = None
) -> list[Finding]:
    """Return the mistakes that explain what no machine does, or as much as the best machine; one of each code."""
    if c.misfit(c.recorded, effects=False) < c.usual:
        return []  # as the nominal simulator's: there is nothing to explain
    candidates = [*faults(c), *labels(bench, c, rollouts)]
    if loop is not None and loop.sure:
        candidates = [one for one in candidates if not _is_refuted(*one, c, loop.channels)]
    judged = sorted((_Judged.of(c, fault) for fault in candidates), key=lambda one: one.after)
    judged = [one for one in judged if one.removes(1.0 - MOST, one.before) or one.alike]
    if not judged:
        return []

    def left(machine: Comparison, values: FloatArray, undone: Undone) -> float:
        return machine.misfit(values, there=undone.there) + machine.volume - c.volume

    bench = replace(bench, progress=None)  # nobody knows how many machines are tried

    @cache
    def machine() -> Comparison:
        return nearest_machine(bench, c, c.recorded)

    if not any(one.removes(MOST, one.before) for one in judged):
        # A mistake may stand beside an effect that is far from nominal.
        for k, one in enumerate(judged[:CAUSES]):
            values = one.undone.values
            after = left(nearest_machine(bench, c, values), values, one.undone) + one.undone.price
            judged[k] = replace(one, after=min(one.after, after))
    out: dict[str, tuple[float, Finding]] = {}
    for one in sorted(judged, key=lambda one: one.after):
        best, finding = one.before, one.finding
        # What removes too little beside no effects removes less beside the nearest machine.
        if one.removes(MOST, best):
            best = min(best, left(machine(), c.recorded, one.undone))
        if one.removes(MOST, best):
            out.setdefault(finding.code, (best - one.after, finding))
        elif one.alike:
            out.setdefault(finding.code, (one.bare - one.alone, replace(finding, same=True)))
    most = max((removed for removed, _ in out.values()), default=0.0)
    return [finding for removed, finding in out.values() if removed >= (1.0 - CLEAR) * most]
