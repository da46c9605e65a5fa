"""Which real rollouts a cause is named from, and which are held out to see whether it closes their gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from s2r_spec.diagnose.ask import FEWEST
from s2r_spec.diagnose.simulate import Test
from s2r_spec.space import key_of
from s2r_spec.trace import Trace

Rollouts = list[tuple[dict[str, float], Trace]]

HELD_OUT = 0.3
"""Part of the tests that the diagnosis does not see."""
ENOUGH = (9, 2 * FEWEST)
"""Different tests from which on that is three of them, and rollouts: of fewer none are held out."""
ACCIDENTS = 0.1
"""Part of the rollouts, or one of them, that may have failed by accident, and is left out."""


@dataclass(frozen=True)
class Parted:
    """Real rollouts, parted by whole tests.

    Attributes:
        seen: to diagnose with.
        held: held out; none where there are too few.
        seed: drew these.
    """

    seen: Rollouts
    held: Rollouts
    seed: int

    @classmethod
    def of(cls, rollouts: Rollouts, seed: int) -> Parted:
        """Part the rollouts, without the few that failed by accident."""
        return cls(*split(without_accidents(rollouts), seed), seed)

    @property
    def used(self) -> Rollouts:
        """Return all of them."""
        return self.seen + self.held

    @property
    def compared(self) -> Rollouts:
        """Return those of ``seen`` of which a cause is named: that did not fail, if these are enough, at least half.

        What was recorded up to a fall has not the means, spreads and ripples of a whole rollout.
        """
        ran = _whole(self.seen)
        return ran if len(ran) >= max(FEWEST, (len(self.seen) + 1) // 2) else self.seen

    def looked_at(self, telling: Sequence[Test]) -> tuple[Parted, int]:
        """Let every other one of these held-out tests change places, and return how many did.

        Args:
            telling: tests that alone show a gap, most telling first. Half of them stay held out, to see whether the
                gap closes; those that ``seen`` has, too, need no change.
        """
        ran = [test for test, _ in self.seen]
        moved = [dict(test) for test in telling if dict(test) not in ran][::2]
        seen, held = exchanged(self.seen, self.held, moved, self.seed)
        return (replace(self, seen=seen, held=held) if moved else self), len(moved)


def without_accidents(rollouts: Rollouts) -> Rollouts:
    """Return the rollouts without those that failed, if these are few and enough are left.

    One fall outweighs all else in ρ, and says nothing of where the others differ from the simulator. Where falls are
    common they are what differs, and count.
    """
    ran = _whole(rollouts)
    failed = len(rollouts) - len(ran)
    few = failed <= max(1, int(ACCIDENTS * len(rollouts)))
    return ran if few and len(ran) >= FEWEST else rollouts


def split(rollouts: Rollouts, seed: int) -> tuple[Rollouts, Rollouts]:
    """Return the rollouts to diagnose with, and those held out: whole tests, drawn at random."""
    keys = list(dict.fromkeys(key_of(test) for test, _ in rollouts))
    count = round(HELD_OUT * len(keys))
    if count < 3 or len(rollouts) < ENOUGH[1]:
        if len(keys) > 1:
            return rollouts, []
        # One test alone: rollouts of it are all there is to hold out.
        count = round(HELD_OUT * len(rollouts))
        return (rollouts[count:], rollouts[:count]) if count >= 3 else (rollouts, [])
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7,)))
    out = {keys[i] for i in rng.permutation(len(keys))[:count]}
    seen = [r for r in rollouts if key_of(r[0]) not in out]
    held = [r for r in rollouts if key_of(r[0]) in out]
    return seen, held


def exchanged(seen: Rollouts, held: Rollouts, shown: Sequence[Test], seed: int) -> tuple[Rollouts, Rollouts]:
    """Return what to diagnose with and what to hold out, after held-out tests changed places with as many others.

    Where one test of all shows the gap, as with a motor that saturates there, it says more of the cause if it is
    looked at than if it is held out.

    Args:
        seen: rollouts diagnosed with.
        held: rollouts held out.
        shown: tests of the latter that are to be looked at.
        seed: draws those that take their places.
    """
    moved = {key_of(test) for test in shown}
    others = list(dict.fromkeys(key_of(test) for test, _ in seen))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7, 1)))
    hidden = {others[i] for i in rng.permutation(len(others))[: len(moved)]}
    out = [r for r in seen if key_of(r[0]) in hidden] + [r for r in held if key_of(r[0]) not in moved]
    return [r for r in seen if key_of(r[0]) not in hidden] + [r for r in held if key_of(r[0]) in moved], out


def _whole(rollouts: Rollouts) -> Rollouts:
    return [(test, trace) for test, trace in rollouts if trace.failure is None]
