"""How far the gap shrinks: measured on real rollouts that the diagnosis did not see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.gap.held_out import Gap as Gap
from s2r_spec.diagnose.gap.held_out import HeldOut as HeldOut
from s2r_spec.space import key_of

FloatArray = NDArray[np.float64]

RESAMPLES = 2000
LEVEL = 0.95
GONE = 0.8
"""A patch that closes this part of a material held-out gap explains it, whatever else the traces show."""
SURELY = 1.645 * float(np.sqrt(np.pi / 2.0 - 1.0))
"""A mean of n |normal| numbers is more than 1 + SURELY / √n times its expectation in 1 of 20 cases."""
CLOSED = 0.5
"""Where less than this part of a material held-out gap can be closed, its cause is not in the catalogue."""


@dataclass(frozen=True)
class HowFar:
    """The gap before and after the named effects were added to the simulator.

    Attributes:
        rollouts: held-out real rollouts.
        unit: of ρ.
        before: gap of the nominal simulator.
        after: gap of the one with the named effects; None when nothing is named.
        tuned: gap of the one that has, besides, a little of every other effect, as the data want it.
        background: what a little of every effect of the catalogue would make of it, at most, in 19 of 20
            machines: a gap below floor and background together is not material.
        floor: what |ρ_real − E ρ_sim| is of a perfect simulator: run-to-run scatter alone.
        share: (before − after) / (before − floor), with its interval; None where the gap is hardly more
            than the floor.
        tuned_share: the same of ``tuned``.
        oracle: the gap after, as the bank predicts it for the best of all single effects.
        oracle_share: part of what the oracle closes that the named effects close.
        seen: gap of the nominal simulator at the tests that were not held out; None where that is not asked.
        moved: whether one of these had been held out first, and alone showed a material gap.
        matters: whether the gap matters at any test, held out or not; see :mod:`s2r_spec.diagnose.gap.materiality`.
        beyond: at most this part of all tests has a larger gap than any held-out one, with 95 % confidence.
        tests: the held-out ones, signed.
    """

    rollouts: int
    unit: str
    before: Gap
    after: Gap | None
    tuned: Gap | None
    floor: float
    background: float
    share: tuple[float, float, float] | None
    tuned_share: tuple[float, float, float] | None
    oracle: float | None
    oracle_share: float | None
    beyond: float
    tests: tuple[HeldOut, ...] = ()
    seen: Gap | None = None
    moved: bool = False
    matters: bool = False

    @property
    def material(self) -> bool:
        """Whether the gap is more than scatter and a little of everything, and surely more than scatter.

        The interval of the gap does not say so: one that is there at a single test has a wide one.
        """
        return bool(self.before.mean > self._at_most)

    @property
    def elsewhere(self) -> bool:
        """Whether the gap is material at some test, but not on average over the few tests that were held out."""
        seen = self.seen is not None and self.seen.mean > self._at_most
        return not self.material and (self.matters or self.moved or seen)

    @property
    def shows(self) -> bool:
        """Whether the gap is material anywhere that was looked."""
        return self.material or self.elsewhere

    @property
    def _at_most(self) -> float:
        """What the mean gap is of a machine with scatter and a little of everything alone."""
        surely = self.floor * (1.0 + SURELY / float(np.sqrt(max(len(self.tests), 1))))
        return max(self.floor + self.background, surely)

    @property
    def closed(self) -> bool:
        """Whether a material gap is (nearly) gone after the patch, and surely smaller."""
        return self.material and self.gone and self._surely_closes

    @property
    def harmful(self) -> bool:
        """Whether the patch makes a material gap where there was none; at a single held-out test is enough.

        One that was nearly material before, and is barely so after, was not made by the patch.
        """
        return (
            self.after is not None
            and not self.material
            and self.after.mean - self.before.mean > self._at_most
        )

    @property
    def gone(self) -> bool:
        """Whether a patch closes (nearly) all of the gap, however small that was."""
        return self._closes >= GONE

    @property
    def open(self) -> bool:
        """Whether a material gap surely stays, although a little of every other effect may help."""
        return self.unclosed and not self._may_close

    @property
    def short(self) -> bool:
        """Whether what is named surely leaves a part of a material gap, whatever a little of every other closes."""
        return self.material and self.share is not None and self.share[2] < GONE

    @property
    def leaves_more(self) -> bool:
        """Whether the gap after what is named is surely more than scatter and a little of everything."""
        return self.material and self.after is not None and self.after.low > self._at_most

    @property
    def better_tuned(self) -> bool:
        """Whether a little of every other effect beside the named ones surely closes more than these alone."""
        return self.share is not None and self.tuned_share is not None and self.tuned_share[1] > self.share[2]

    @property
    def unclosed(self) -> bool:
        """Whether most of a material gap is left by what was tried, as far as a few held-out tests say."""
        return self.material and self.tuned_share is not None and self._closes < CLOSED

    @property
    def overlooked(self) -> bool:
        """Whether most of a material gap is left, and the diagnosis looked where there is none."""
        return self.unclosed and self.seen is not None and self.seen.mean <= self._at_most

    @property
    def odd(self) -> tuple[HeldOut, ...]:
        """The held-out tests with a gap that a little of everything does not make, largest first."""
        large = [test for test in self.tests if abs(test.before) > self._at_most]
        return tuple(sorted(large, key=lambda test: -abs(test.before)))

    @property
    def unexplained(self) -> bool:
        """Whether a material gap stays that nothing named is to explain, although a little of everything may help."""
        return (
            self.material
            and self.tuned_share is not None
            and self.tuned_share[0] < GONE
            and not self._may_close
        )

    @property
    def _may_close(self) -> bool:
        """Whether held-out rollouts are too few, or too unsteady, to say that a patch does not close all of it.

        An interval in which the patch helps, and as well makes the gap twice as large, says nothing either.
        """
        if not self._parts:
            return False
        _, low, high = self._best
        return any(part[2] >= 1.0 for part in self._parts) or low < -1.0 < 0.0 < high

    @property
    def _surely_closes(self) -> bool:
        """Whether that is more than the chance of a few held-out tests: where one has all of the gap, any patch may."""
        return bool(self._parts) and self._best[1] > 0.0

    @property
    def _closes(self) -> float:
        return self._best[0] if self._parts else -np.inf

    @property
    def _best(self) -> tuple[float, float, float]:
        return max(self._parts, key=lambda part: part[0])

    @property
    def _parts(self) -> tuple[tuple[float, float, float], ...]:
        return tuple(part for part in (self.share, self.tuned_share) if part is not None)

    def to_json(self) -> dict[str, Any]:
        """Return a JSON object."""
        return {
            "rollouts": self.rollouts,
            "unit": self.unit,
            "before": asdict(self.before),
            "after": None if self.after is None else asdict(self.after),
            "tuned": None if self.tuned is None else asdict(self.tuned),
            "floor": self.floor,
            "background": self.background,
            "material": self.material,
            "seen": None if self.seen is None else asdict(self.seen),
            "elsewhere": self.elsewhere,
            "share": _interval_json(self.share),
            "tuned_share": _interval_json(self.tuned_share),
            "oracle_gap": self.oracle,
            "oracle_share": self.oracle_share,
            "tests_with_a_larger_gap_at_most": self.beyond,
            "tests": [asdict(test) for test in self.tests],
        }


def _interval_json(share: tuple[float, float, float] | None) -> dict[str, float] | None:
    return None if share is None else dict(zip(("estimate", "low", "high"), share, strict=True))


def gap(differences: FloatArray, groups: NDArray[np.int64], seed: int = 0) -> Gap:
    """Return the mean of |differences| (n,) with an interval; ``groups`` (n,) says which share a test."""
    size = np.abs(differences)
    worst = max(abs(float(differences[groups == g].mean())) for g in np.unique(groups))
    low, high = _interval(lambda pick: float(size[pick].mean()), groups, seed)
    return Gap(float(size.mean()), low, high, worst)


def how_far(
    real: FloatArray,
    nominal: FloatArray,
    patched: FloatArray | None,
    tuned: FloatArray | None,
    tests: Sequence[Mapping[str, float]],
    rho_noise: float,
    background: float,
    shots: int,
    unit: str,
    oracle: float | None = None,
    seed: int = 0,
    seen: Gap | None = None,
) -> HowFar:
    """Compare held-out ρ with the mean ρ of either simulator at the same tests.

    Args:
        real: (n,) ρ of the held-out rollouts.
        nominal: (n,) mean ρ of the nominal simulator at each rollout's test.
        patched: (n,) mean ρ of the one with the named effects; None when nothing is named.
        tuned: (n,) mean ρ of the one with a little of every other effect as well; None where that is not asked.
        tests: n of them.
        rho_noise: standard deviation of ρ from one rollout to the next.
        background: see :class:`HowFar`.
        shots: simulated rollouts behind each mean.
        unit: of ρ.
        oracle: mean gap after the best that the catalogue could do.
        seed: of the resampling.
        seen: see :class:`HowFar`.
    """
    keys = [key_of(test) for test in tests]
    groups = np.array([keys.index(key) for key in keys])
    before = gap(real - nominal, groups, seed)
    floor = rho_noise * float(np.sqrt(2.0 / np.pi * (1.0 + 1.0 / max(shots, 1))))

    def closed(simulated: FloatArray | None) -> tuple[Gap | None, tuple[float, float, float] | None]:
        if simulated is None:
            return None, None
        left = gap(real - simulated, groups, seed)
        if before.mean <= 1.2 * floor:
            return left, None
        b, a = np.abs(real - nominal), np.abs(real - simulated)

        def ratio(pick: NDArray[np.int64]) -> float:
            return float((b[pick].mean() - a[pick].mean()) / max(b[pick].mean() - floor, 0.2 * floor + 1e-12))

        return left, (ratio(np.arange(len(b))), *_interval(ratio, groups, seed))

    after, share = closed(patched)
    with_rest, tuned_share = closed(tuned)
    oracle_share = None
    if (
        after is not None
        and share is not None
        and oracle is not None
        and before.mean - oracle > 0.1 * before.mean
    ):
        oracle_share = (before.mean - after.mean) / (before.mean - min(oracle, after.mean))
    distinct = len(np.unique(groups))
    return HowFar(
        len(real),
        unit,
        before,
        after,
        with_rest,
        floor,
        background,
        share,
        tuned_share,
        oracle,
        oracle_share,
        float(1.0 - (1.0 - LEVEL) ** (1.0 / distinct)),
        tuple(
            HeldOut(
                dict(tests[int(np.argmax(groups == g))]),
                int((groups == g).sum()),
                float((real - nominal)[groups == g].mean()),
                None if patched is None else float((real - patched)[groups == g].mean()),
            )
            for g in np.unique(groups)
        ),
        seen,
    )


def _interval(statistic: Any, groups: NDArray[np.int64], seed: int) -> tuple[float, float]:
    """Return a percentile bootstrap interval over whole tests; over rollouts if all are of one test."""
    rng = np.random.default_rng(seed)
    members = [np.flatnonzero(groups == g) for g in np.unique(groups)]
    if len(members) == 1:
        members = [np.array([i]) for i in members[0]]
    draws = [
        statistic(np.concatenate([members[i] for i in rng.integers(len(members), size=len(members))]))
        for _ in range(RESAMPLES)
    ]
    low, high = np.quantile(draws, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)
