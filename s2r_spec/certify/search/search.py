"""A search asks for tests, takes their outcomes, and certifies the maximum at any time.

*Modified GP-UCB* of Akella, Ubellacker and Ames with a confidence sequence that holds: the next test maximises
the upper confidence bound. The search ends when the certified maximum J^e is within ε of the best lower bound.

A search runs nothing. So a simulator, a folder of logs or a person with a robot can answer it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Self, Unpack

from numpy.typing import ArrayLike

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError
from s2r_spec.certify.bound import confidence
from s2r_spec.certify.bound.certificate import Certificate, Label
from s2r_spec.certify.bound.samples import as_outcomes
from s2r_spec.certify.bound.settings import SearchKeywords, SearchSettings
from s2r_spec.certify.search import assembly
from s2r_spec.certify.search.acquisition import coverage_tests, next_batch
from s2r_spec.certify.search.state import SearchState
from s2r_spec.certify.search.stopping import label
from s2r_spec.space import Space


@dataclass(frozen=True)
class Query:
    """Test ``point`` this many times; tell the search all outcomes at once."""

    index: int
    point: dict[str, float]
    replicates: int


class Search:
    """Ask/tell maximisation of J(z) = E[outcome | z] over a box, with a certificate at any time.

    Args:
        space: the test space, or ``{"vd": (-0.2, 0.3)}``.
        keywords: ``kernel``, ``B``, ``R``, ``delta`` and ``epsilon`` must be given, the others may be; see
            :class:`~s2r_spec.certify.bound.settings.SearchSettings`.

    Raises:
        UsageError: a setting is out of its range; the message names it.
    """

    def __init__(
        self, space: Space | Mapping[str, tuple[float, float]], **keywords: Unpack[SearchKeywords]
    ) -> None:
        self._begin(SearchSettings(space=space if isinstance(space, Space) else Space.of(space), **keywords))

    @classmethod
    def of(cls, settings: SearchSettings) -> Self:
        """Return a search with these settings."""
        search = cls.__new__(cls)
        search._begin(settings)
        return search

    def _begin(self, settings: SearchSettings) -> None:
        self.settings = settings
        self.space, self.kernel, self.unit = settings.space, settings.kernel, settings.unit
        self.B, self.R, self.delta, self.epsilon = settings.B, settings.R, settings.delta, settings.epsilon
        self._state = SearchState.of(settings)
        self._open: dict[int, tuple[Query, int]] = {}  # of the batch that is asked: query and its point
        self._answers: dict[int, FloatArray] = {}

    def refuse_hopeless(self) -> None:
        """Refuse, before any rollout, a search whose certificate would be refused whatever its rollouts show.

        Raises:
            UsageError: a lengthscale is far too long or too short for the test space, or the budget is smaller than
                the first tests on the axes that are shorter than their lengthscale.
        """
        if obstacle := self._state.obstacles.any:
            raise UsageError(obstacle)
        first = sum(replicates for _, replicates in coverage_tests(self._state))
        if self.budget is not None and first > self.budget:
            raise UsageError(f"budget = {self.budget}; the first batch alone takes {first} rollouts")

    @property
    def done(self) -> bool:
        """Whether the stopping rule ends the search, the budget is spent, or the certificate is refused."""
        return not self._open and label(self._state)[0] is not Label.RUNNING

    @property
    def budget(self) -> int | None:
        """Most rollouts; None for as many as ε takes."""
        return self._state.budget

    def end_when(self, verdict_known: Callable[[], bool]) -> None:
        """Decide another verdict than the sign of the maximum; it ends the search under the rule ``decided``.

        Args:
            verdict_known: whether the bounds of this search decide the verdict; called after a batch.
        """
        self._state.verdict_known = verdict_known

    def close(self) -> None:
        """Take the rollouts so far as the budget, so that the search ends."""
        self._state.budget = self._state.outcomes.rollouts

    def ask(self, *, beyond: bool = False) -> list[Query]:
        """Return the next batch, or the last one again while it lacks outcomes.

        Args:
            beyond: whether a search that is done returns the batch that would follow.
        """
        if not self._open and (beyond or not self.done):
            for place, replicates in next_batch(self._state):
                point = self.space.point(self._state.confidence.points[place])
                query = Query(self._state.queries, point, replicates)
                self._open[query.index] = (query, place)
                self._state.queries += 1
        return [query for query, _ in self._open.values()]

    def tell(self, query: Query, outcomes: ArrayLike) -> None:
        """Give the (replicates,) outcomes of a query that was asked.

        Fewer outcomes than were asked for are taken, but the certificate is
        then refused: leaving out rollouts biases the bound.

        Raises:
            UsageError: the query is unknown or already answered, there are too many outcomes, or one is not finite.
        """
        if not isinstance(query, Query):
            raise UsageError(f"tell takes a query that was asked, not a value of type {type(query).__name__}")
        if query.index not in self._open or query.index in self._answers:
            raise UsageError(
                f"query {query.index} is not open: it has its outcomes, or this search never asked it"
            )
        query = self._open[query.index][0]
        values = as_outcomes(outcomes, f"query {query.index} at {query.point}")
        if len(values) > query.replicates:
            raise UsageError(f"query {query.index} asked for {query.replicates} outcomes, not {len(values)}")
        if len(values) < query.replicates:
            came = f"{len(values)} of {query.replicates} came"
            self._state.missing = f"query {query.index} at {query.point}: {came}"
        self._answers[query.index] = values / self.R
        # A batch is used only when it is whole, in the order asked: the
        # certificate then does not depend on which worker was fastest.
        if len(self._answers) == len(self._open):
            for index, (_, place) in sorted(self._open.items()):
                self._state.add(place, self._answers[index])
            self._open.clear()
            self._answers.clear()
            self._state.end_batch()

    def withdraw(self) -> None:
        """Take back the batch that is open; its outcomes so far do not count, and the next :meth:`ask` repeats it."""
        self._state.queries -= len(self._open)
        self._open.clear()
        self._answers.clear()

    @property
    def answered(self) -> int:
        """Number of queries with outcomes, and the index of the next one."""
        return self._state.queries - len(self._open)

    def counts(self, index: int) -> bool:
        """Return whether the certificate counts the outcomes of a query; those of fixed tests always count."""
        return self._state.final or index < self.answered

    def observe(self, tests: Iterable[tuple[Mapping[str, float], ArrayLike]], *, final: bool = False) -> None:
        """Give outcomes of tests that were fixed beforehand, not chosen by this search.

        Such a design is predictable, and the bound needs nothing more of the choice of tests. All outcomes form one
        batch, so the order of the list does not matter. The points need not lie on a grid.

        Args:
            tests: (point, (replicates,) outcomes), every outcome of the design; each counts once.
            final: whether to end the search after these outcomes.

        Raises:
            UsageError: a batch is open, a point is outside the box, or an outcome is not finite.
        """
        if self._open:
            raise UsageError("a batch is open: tell its outcomes before the outcomes of other tests")
        observed = [
            (self.space.vector(point), as_outcomes(outcomes, f"the observed test {dict(point)}") / self.R)
            for point, outcomes in tests
        ]
        self._state.final = self._state.final or final
        for vector, values in observed:
            if len(values):
                self._state.add(self._state.confidence.bounds.add(vector), values)
                self._state.fixed += len(values)
        self._state.end_batch()

    def certificate(self) -> Certificate:
        """Return the certificate from the outcomes so far; valid at any time."""
        return assembly.certificate(self._state)

    def one_sided(self) -> Certificate | None:
        """Return a certificate that the maximum is positive, which needs no B; None if the outcomes do not show it.

        Only a search whose certificate is refused because of B or the kernel has one.
        """
        return assembly.one_sided_certificate(self._state)

    def band(self, points: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return (n,) lower and upper bounds of J at (n, dim) points, all at once with probability ≥ 1 − δ.

        Raises:
            UsageError: a point is outside the test space, or has another dimension.
        """
        return self._state.confidence.band(points)

    @property
    def range(self) -> tuple[float, float]:
        """Bounds of J anywhere in the box: (lower bound of its minimum, upper bound of its maximum)."""
        return self._state.confidence.range

    @property
    def degrees(self) -> int:
        """Number of outcomes that repeat a test, beyond the first of each: the test of R is based on them."""
        return self._state.outcomes.degrees

    @property
    def least_proxy(self) -> float:
        """The smallest R, at least the declared one, that the scatter of replicates does not refute."""
        return confidence.least_proxy(self._state.outcomes.history, self.delta) * self.R

    @property
    def tested(self) -> FloatArray:
        """(u, dim) points with outcomes."""
        return self._state.tested

    @property
    def suggestion(self) -> dict[str, float]:
        """The point of the largest upper bound, where a further test is most informative."""
        bounds, points = self._state.confidence.bounds, self._state.confidence.points
        return self.space.point(points[int(bounds.upper[0].argmax())])
