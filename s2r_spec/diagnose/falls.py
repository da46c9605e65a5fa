"""Why real rollouts ended early: which effects alone end the simulator early at these tests, and not at others.

The least of an effect that ends it at all of these tests does so at the fewest others. It is found by halving the way
from nominal to the end of its range, as if more of an effect ended what less of it ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.gap import SHOTS
from s2r_spec.diagnose.gap.nominal import Nominal
from s2r_spec.diagnose.simulator.axes import EffectAxis
from s2r_spec.diagnose.simulator.bench import Bench, Test, TestRun, evenly, places_of, table
from s2r_spec.trace import Trace

HALVINGS = 6
"""Budget: halvings of the way from nominal to the end of a range."""
SHOWN = 3
"""Definition: effects that a sentence names; it counts the others."""


class Culprit(NamedTuple):
    """A parameter, the least of it that ends the simulator early at all tests, and at how many others it does."""

    axis: EffectAxis
    coordinate: float
    others: int

    def __str__(self) -> str:
        value = f"{self.axis.value(self.coordinate):.3g} {self.axis.unit}".rstrip()
        return f"{self.axis.name} beyond {value}"


@dataclass(frozen=True)
class Falls:
    """Whether the simulator ends early at these tests; else effects that end it, tried at so many ``others``."""

    nominal: bool
    culprits: tuple[Culprit, ...] = ()
    others: int = 0

    def __str__(self) -> str:
        if self.nominal:
            return "The simulator ends early at these tests, too"
        if not self.culprits:
            return (
                "No single effect of the catalogue ends the simulator early at these tests and not at others"
            )
        shown = self.culprits[:SHOWN]
        more = len(self.culprits) - len(shown)
        names = " or ".join(map(str, shown)) + (f" (or {more} more)" if more else "")
        few = max(each.others for each in shown)
        return (
            f"Alone, {names} ends the simulator early at these tests, and at "
            f"{f'at most {few}' if few else 'none'} of {self.others} other tests"
        )


def falls(
    bench: Bench, axes: Sequence[EffectAxis], rollouts: Sequence[TestRun], nominal: Nominal
) -> Falls | None:
    """Ask every effect of the catalogue; None where no real rollout ended early, or all did.

    At most :data:`~.gap.SHOTS` tests at which real rollouts ended early are asked about, and twice as many others. An
    effect is suspected if it ends the simulator early at a third of the others at most. ``nominal`` is the simulator at
    the tests of the real rollouts.
    """
    early, stood = (
        [of[n] for n in evenly(len(of), most)]
        for of, most in zip(_by_end(rollouts), (SHOTS, 2 * SHOTS), strict=True)
    )
    if not early or not stood:
        return None

    def ended(tried: Sequence[tuple[EffectAxis, float]], tests: Sequence[Test]) -> NDArray[np.int_]:
        if not tried:
            return np.zeros(0, dtype=int)
        machines = [axis.at(axis.value(x)) for axis, x in tried]
        return np.asarray((table(bench, machines, nominal.first(tests), _end)[0] > 0.0).sum(axis=1))

    if all(map(nominal.ends, early)):
        return Falls(True)
    # An end that is nominal is no effect.
    ends = [(axis, axis.coordinate(end)) for axis in axes if not axis.base for end in (axis.low, axis.high)]
    candidates = sorted(((axis, x) for axis, x in ends if x), key=lambda one: abs(one[1]))
    enough = [
        one for one, count in zip(candidates, ended(candidates, early), strict=True) if count == len(early)
    ]
    effects, high = [axis for axis, _ in enough], np.array([x for _, x in enough])
    low = np.zeros(len(enough))
    for _ in range(HALVINGS if enough else 0):
        middle = 0.5 * (low + high)
        counts = ended([*zip(effects, middle.tolist(), strict=True)], early)
        low, high = np.where(counts < len(early), middle, low), np.where(counts < len(early), high, middle)
    least = [*zip(effects, high.tolist(), strict=True)]
    culprits = [Culprit(*one, int(count)) for one, count in zip(least, ended(least, stood), strict=True)]
    culprits = [each for each in culprits if 3 * each.others <= len(stood)]
    return Falls(False, tuple(sorted(culprits, key=lambda each: abs(each.coordinate))), len(stood))


def falls_alone(rollouts: Sequence[TestRun], nominal: Nominal) -> list[Test]:
    """Return the tests at which the simulator, with nothing added, ends early, and no real rollout does."""
    return [test for test in _by_end(rollouts)[1] if nominal.ends(test)]


def _by_end(rollouts: Sequence[TestRun]) -> tuple[list[Test], list[Test]]:
    ends: tuple[list[Test], list[Test]] = [], []
    for key, own in places_of([test for test, _ in rollouts]).items():
        ends[all(rollouts[n][1].failure is None for n in own)].append(dict(key))
    return ends


def _end(bench: Bench, trace: Trace, test: Test) -> FloatArray:
    return np.array([float(trace.failure is not None)])
