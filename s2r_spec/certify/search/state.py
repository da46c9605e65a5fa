"""The state of a search between two batches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from s2r_spec.base.arrays import FloatArray
from s2r_spec.certify.bound.confidence_set import ConfidenceSet
from s2r_spec.certify.bound.coverage import Coverage, long_axes
from s2r_spec.certify.bound.samples import Outcomes
from s2r_spec.certify.bound.settings import SearchSettings
from s2r_spec.certify.search.feasibility import Obstacles
from s2r_spec.runs.stop_rule import DECIDED

LEAST_DEGREES = 20
"""Level: fewest degrees of freedom of the test of R before a verdict may end a search: rollouts minus replicated
tests."""


@dataclass
class SearchState:
    """All that the next batch, the label and the certificate depend on.

    Attributes:
        outcomes: all outcomes so far, in units of R.
        budget: most rollouts; None for as many as ε takes.
        fixed: outcomes of tests that the search did not choose.
        final: whether no further test will be asked for.
        verdict_known: whether the bounds decide the verdict; None for the sign of the maximum.
        decided: whether the verdict was known after the last batch; only under the rule ``decided``.
        lacking: degrees of freedom that the test of R lacks, if the verdict is known; else 0.
        missing: a sentence on outcomes that a caller left out, "" if none were.
    """

    settings: SearchSettings
    obstacles: Obstacles
    coverage: Coverage
    confidence: ConfidenceSet
    budget: int | None
    outcomes: Outcomes = field(default_factory=Outcomes)
    queries: int = 0
    batches: int = 0
    fixed: int = 0
    final: bool = False
    verdict_known: Callable[[], bool] | None = None
    decided: bool = False
    lacking: int = 0
    missing: str = ""

    @classmethod
    def of(cls, settings: SearchSettings) -> SearchState:
        """Return the state before any outcome."""
        return cls(
            settings,
            Obstacles.of(settings),
            Coverage(settings.space, long_axes(settings.space, settings.kernel)),
            ConfidenceSet(settings),
            settings.budget,
        )

    @property
    def tested(self) -> FloatArray:
        """(u, dim) points with outcomes."""
        return self.confidence.points[self.outcomes.samples.at]

    def add(self, place: int, values: FloatArray) -> None:
        """Count (replicates,) outcomes at a point, in units of R; an empty array adds none."""
        if len(values):
            self.outcomes = self.outcomes.add(place, values)

    def end_batch(self) -> None:
        """Bound J from all outcomes so far."""
        self.batches += 1
        if self.outcomes.rollouts:
            self.confidence.update(self.outcomes)
        untested = max(LEAST_DEGREES - self.outcomes.degrees, 0)
        decides = self.settings.stop == DECIDED
        repeats = self.settings.repeats and untested > 0
        known = (decides or repeats) and (self.verdict_known or self._sign_known)()
        self.lacking = untested if known and repeats else 0
        self.decided = decides and known and not untested

    def _sign_known(self) -> bool:
        interval = self.confidence.ladder[0]
        return interval.upper <= 0 or interval.lower > 0
