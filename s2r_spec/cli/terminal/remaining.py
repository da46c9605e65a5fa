"""Rollouts and seconds that are left of a search, from its plan and from its progress.

Data: the plan before the search; after each batch the rollouts n and the interval, of width w; the times at which
rollouts and batches ended. Unknown: the rollouts N at the end, where the interval is ε wide. Model: ln N is near the
plan's estimate, which counts as ``PLANNED`` rollouts, and near the growth from here:

    ln N = [PLANNED · ln N_plan + n · (ln N_square + ln N_flat)/2] / (PLANNED + n),
    N_square = n (w/ε)²,    N_flat = n F(ε)/F(w),

with F(w) the rollouts of a flat objective until width w (:mod:`s2r_spec.certify.search.effort`). The width falls with
the square root of the rollouts if the worst test is known, and more slowly if every test is nearly the worst one: the
two growths bracket what happens.

Under the rule ``decided`` the search may end before. Let t be the lowest mean ρ at a test, and a its distance from the
end of the interval that must pass zero. The search ends when a is at most |t|, so

    N = n (a/|t|)^p,    p = 1 in the first ``FIRST`` rollouts, and 2 afterwards.

Units: rollouts, seconds, and the outcome's unit for widths and ρ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.certify.bound.certificate import Certificate
from s2r_spec.certify.bound.settings import SearchSettings
from s2r_spec.certify.search.effort import Effort, Objective
from s2r_spec.certify.search.plan import SHARE_FLAT, rollouts
from s2r_spec.certify.search.state import LEAST_DEGREES
from s2r_spec.runs.stop_rule import BUDGET, DECIDED

PLANNED = 32
"""Tolerance: rollouts as which the plan's estimate counts. The width of the first four batches is mostly B, and says
little about the end."""
FIRST = 2 * LEAST_DEGREES
"""Definition: rollouts in which the test of R gets its degrees of freedom; the tests spread over the space in them."""
GROWTH = 0.1
"""Tolerance: growth of the computation between batches with each batch, as a share of its first duration: every batch
adds tests."""
WIDTHS = np.array([1.0, 2.0, 4.0, 8.0, 16.0])
"""Tolerance: widths, in ε, at which a flat objective's rollouts are computed; between them ln F is linear in ln w."""


@dataclass(frozen=True)
class RolloutForecast:
    """What is known of a search's end before it begins.

    Attributes:
        expected: N_plan.
        flat: (5,) F at ``WIDTHS`` · ε.
    """

    settings: SearchSettings
    expected: float
    flat: FloatArray

    @classmethod
    def of(cls, settings: SearchSettings) -> RolloutForecast:
        """Return the forecast of a search with these settings."""
        low, high = rollouts(settings)
        flat = []
        for width in WIDTHS:
            effort = Effort.of(replace(settings, epsilon=min(settings.epsilon * width, 1.99 * settings.B)))
            flat.append(effort.rollouts(Objective.flat(len(effort.region.points), 0.0), SHARE_FLAT))
        return cls(settings, math.sqrt(low * high), np.array(flat))

    def total(self, certificate: Certificate | None, worst: float | None) -> float | None:
        """Return an estimate of N from the certificate of −ρ, and from t, the ``worst`` mean; None if there is none."""
        budget, stop = self.settings.budget, self.settings.stop
        if certificate is not None and not certificate.rollouts:
            certificate = None
        if stop == BUDGET or (stop == DECIDED and certificate is None):
            return budget
        total = self.expected
        if certificate is not None:
            total = self._until_epsilon(certificate)
            if stop == DECIDED and worst is not None:
                total = min(total, _until_decided(certificate, worst))
        if not math.isfinite(total):
            return budget
        return total if budget is None else min(total, budget)

    def _until_epsilon(self, certificate: Certificate) -> float:
        """Return N of the rule ``epsilon``, from n ≥ 1 rollouts."""
        n, target = certificate.rollouts, certificate.target
        square = 2 * math.log(max(1.0, certificate.epsilon / target))
        grown = math.log(n) + (square + self._growth(max(certificate.epsilon, target))) / 2
        return math.exp((PLANNED * math.log(self.expected) + n * grown) / (PLANNED + n))

    def batches(self, done: int, total: float) -> int:
        """Return the number of batches from ``done`` rollouts to ``total``."""
        count = 0
        while done < total:
            done += max(2 * self.settings.spread, math.ceil(self.settings.batch * done))
            count += 1
        return count

    def _growth(self, width: float) -> float:
        """Return ln F(ε) − ln F(width)."""
        beside = math.log(width / self.settings.epsilon)
        known = np.log(np.maximum(self.flat, 1.0))
        # Beyond the widest one B decides the width, which then falls as the square root.
        beyond = 2 * max(0.0, beside - math.log(WIDTHS[-1]))
        return float(known[0] - np.interp(beside, np.log(WIDTHS), known)) + beyond


def _until_decided(certificate: Certificate, worst: float) -> float:
    """Return N of the rule ``decided``, if the worst expected ρ is ``worst``."""
    lower, upper = -certificate.upper, -certificate.lower
    distance = worst - lower if worst >= 0 else upper - worst
    ratio = max(1.0, distance / max(abs(worst), 1e-300))
    power = 1 if certificate.rollouts < FIRST else 2
    return max(float(FIRST), certificate.rollouts * ratio**power)


@dataclass
class Pace:
    """Time of rollouts and of the computation between batches.

    The wait for the first result is not counted, for workers start in it.

    Attributes:
        paired: whether each rollout is compared with simulated ones, which run after the batch and are not reported.
        counted: rollouts whose time is known.
        busy: their time [s].
        between: time between the last rollout and the next batch, of the latest batch [s]; None before the second.
        size: reported rollouts of the latest batch.
    """

    paired: bool = False
    counted: int = 0
    busy: float = 0.0
    between: float | None = None
    size: int = 0
    batches: int = 0
    _latest: float | None = field(default=None, repr=False)
    _here: int = field(default=0, repr=False)

    def rollout(self, now: float) -> None:
        """Count a rollout that ended."""
        if self._latest is not None and (self._here or self.between is not None):
            self.busy += now - self._latest
            self.counted += 1
        self._here, self._latest = self._here + 1, now

    def batch(self, now: float) -> None:
        """Count the time until the choice of a batch."""
        if self._here and self._latest is not None:
            self.between, self.size, self._here = now - self._latest, self._here, 0
            self.batches += 1
        self._latest = now

    def seconds(self, left: float, batches: int) -> float | None:
        """Return the time of so many rollouts in so many batches [s]; None before the first batch ended."""
        if not self.counted or self.between is None:
            return None
        if self.paired:  # the simulated rollouts take most of it, in proportion to the real ones
            times = left / self.size
        else:
            grown = 1 + GROWTH * (self.batches + (batches + 1) / 2)
            times = batches * grown / (1 + GROWTH * self.batches)
        return left * self.busy / self.counted + times * self.between
