"""The search: where to test next, and what the tests so far certify.

*Modified GP-UCB* of Akella, Ubellacker and Ames with a confidence sequence that
holds: the next test maximises the upper confidence bound, and the search ends
when the certified maximum J^e is within ε of the best lower confidence bound.

The search never runs anything. It is asked for tests and told their outcomes,
so that a simulator, a folder of logs or a person with a robot can be behind it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from s2r_spec.certify import confidence
from s2r_spec.certify.bounds import Bounds
from s2r_spec.certify.certificate import ALL_COUNT, Certificate, Label, Rung
from s2r_spec.certify.coverage import LEVELS, MOST_ROLLOUTS, Coverage, constant, long_axes, too_many
from s2r_spec.certify.kernels import Kernel
from s2r_spec.certify.modes import MODES
from s2r_spec.certify.posterior import ENGINES, Conditioned
from s2r_spec.certify.rounding import at_least
from s2r_spec.certify.sample_complexity import sequential_lower_bound
from s2r_spec.certify.samples import Samples
from s2r_spec.certify.tiling import Tiling
from s2r_spec.errors import UsageError, one_of
from s2r_spec.magnitude import LARGEST, number, positive, whole
from s2r_spec.space import Space

FloatArray = NDArray[np.float64]

# Beyond it the bound's own arithmetic, of order (B/R)² times the rollouts, is lost in rounding.
MOST_PRECISE = 1e5
MOST_PARAMETERS = 8
LADDER = (1.0, 2.0, 4.0, 8.0)
# A cell is split while it hides more than this share of the interval that is left.
TOLERANCE = 0.05
# The first division hides at most this share of ε, if it need not be too fine for that.
FIRST_SHARE = 0.5


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
        kernel: with lengthscales in the units of the space.
        B: bound on the RKHS norm of J, in the unit of the outcome.
        R: sub-Gaussian proxy of one outcome's noise, in the unit of the outcome. Declared, never fitted.
        delta: the certificate holds with probability ≥ 1 − δ over the noise, at every time at once.
        epsilon: the search is done when the interval is no wider than this.
        mode: ``rigorous``, a mixture of scales and its dual, or ``rigorous-simple``, one scale
            (see :mod:`s2r_spec.certify.confidence`); both hold, the first takes fewer rollouts.
        seed: breaks ties between equally good tests; kept in the certificate.
        batch: rollouts per batch as a share of those done; a larger one means fewer rounds and more rollouts.
        spread: distinct points per batch, chosen as in GP-BUCB; each is run at least twice. The first
            batches, which that makes larger than ``batch`` asks for, may hold fewer.
        budget: most rollouts; None for as many as ε takes. The search ends before the first batch
            that would exceed it, so that the same tests are asked for under any budget.
        engine: ``spectral`` or ``gpytorch``, see :mod:`s2r_spec.certify.posterior`.
        fitted: settings ("R", "kernel", "B") that were fitted on the outcomes that this search will be
            told; whatever they are, the result is then a model's opinion and no certificate.
        unit: of the outcome, for the sentences.

    Raises:
        UsageError: a setting is out of its range; the message says which.
    """

    def __init__(
        self,
        space: Space | Mapping[str, tuple[float, float]],
        *,
        kernel: Kernel,
        B: float,
        R: float,
        delta: float,
        epsilon: float,
        mode: str = "rigorous",
        seed: int = 0,
        batch: float = 0.1,
        spread: int = 4,
        budget: int | None = None,
        engine: str = "spectral",
        fitted: tuple[str, ...] = (),
        unit: str = "",
    ) -> None:
        self.space = space if isinstance(space, Space) else Space.of(space)
        if self.space.dim == 0:
            raise UsageError("the test space is empty: declare at least one parameter with a range")
        if unfit := [axis.unfit for axis in self.space.axes if axis.unfit]:
            raise UsageError(unfit[0])
        if not isinstance(kernel, Kernel):
            raise UsageError(f"kernel = {kernel!r}; it must be a Kernel, like Kernel('matern52', 0.2)")
        kernel.lengthscales(self.space.dim)
        B, R, epsilon, batch = (
            positive(name, value)
            for name, value in (("B", B), ("R", R), ("epsilon", epsilon), ("batch", batch))
        )
        delta = number("delta", delta)
        if not 0 < delta < 1:
            raise UsageError(f"delta = {delta:g}; it is a probability and must lie strictly between 0 and 1")
        positive("delta", delta)
        if epsilon >= 2 * B:
            raise UsageError(
                f"epsilon = {epsilon:g} asks for no more than B = {B:g} says without any rollout; it must be below 2B"
            )
        if B / R > MOST_PRECISE:
            raise UsageError(
                f"R = {R:g} is too small beside B = {B:g}: double precision carries ratios up to {MOST_PRECISE:g}; "
                f"declare a larger R"
            )
        for name, value in (("spread", spread), ("seed", seed)):
            if not number(name, value).is_integer() or value < (name == "spread"):
                raise UsageError(
                    f"spread = {spread} and seed = {seed} must be whole numbers, at least 1 and 0"
                )
        if self.space.dim > MOST_PARAMETERS:
            raise UsageError(
                f"the test space has {self.space.dim} parameters; a certified search takes at most {MOST_PARAMETERS}"
            )
        if mode not in MODES:
            raise UsageError(f"no mode {mode!r}; there are: {one_of(MODES)}")
        if engine not in ENGINES:
            raise UsageError(f"no engine {engine!r}; there are: {one_of(ENGINES)}")
        budget = None if budget is None else whole("budget", budget, 0)
        if budget is not None and budget < 2 * spread:
            raise UsageError(f"budget = {budget}; the first batch alone takes {2 * spread} rollouts")
        self.kernel, self.B, self.R, self.delta, self.epsilon = kernel, B, R, delta, epsilon
        self.mode, self.engine, self.seed, self.unit = mode, engine, int(seed), unit
        if isinstance(fitted, str) or not all(isinstance(name, str) for name in fitted or ()):
            raise UsageError(f"fitted = {fitted!r}; it must be names of settings, like ('R', 'kernel')")
        self.batch, self.spread, self.budget, self.fitted = batch, int(spread), budget, tuple(fitted or ())
        self._coverage = Coverage(self.space, long_axes(self.space, kernel))
        self._constant = constant(self.space, kernel, B, epsilon)
        self._too_many = too_many(self.space, kernel, self.spread, batch, budget)
        floor = sequential_lower_bound(R, epsilon, delta)
        if budget is None and floor > MOST_ROLLOUTS:
            self._too_many = (
                f"epsilon = {epsilon:g} takes at least {floor:.0e} rollouts beside R = {R:g}, by any method; "
                f"ask for a larger epsilon, or give a budget"
            )

        self._norms = np.array(LADDER) * self.B / self.R
        self._mode = MODES[mode](kernel, self._norms)
        self._engine = ENGINES[engine](kernel)
        self._tiling = Tiling(self.space, kernel, FIRST_SHARE * self.epsilon / self.B)
        self._bounds = Bounds(self._tiling, self._norms)
        self._bound = self._mode.before(self._norms)
        self._data: Conditioned | None = None
        self._samples = Samples()
        self._open: dict[int, tuple[Query, int]] = {}
        self._told: dict[int, FloatArray] = {}
        self._asked = 0
        self._observed = 0
        self._final = False
        self._iterations = 0
        self._rollouts = 0
        self._scatter = 0.0
        self._degrees = 0
        self._log_e = 0.0
        self._B_low = 0.0
        self._missing = ""

    # -- asking and telling ------------------------------------------------------------------

    @property
    def done(self) -> bool:
        """Whether ε is reached, the budget is spent, or the certificate is refused."""
        return not self._open and self._label()[0] is not Label.RUNNING

    def ask(self) -> list[Query]:
        """Return the next batch, or the queries of the last one that were not told yet."""
        if self._open:
            return [query for query, _ in self._open.values()]
        if self.done:
            return []
        if tests := self._inside_batch():
            places = [(self._bounds.add(vector), replicates) for vector, replicates in tests]
        else:
            places = self._usual_batch()
        for place, replicates in places:
            query = Query(self._asked, self.space.point(self._tiling.points[place]), replicates)
            self._open[query.index] = (query, place)
            self._asked += 1
        return [query for query, _ in self._open.values()]

    def _usual_batch(self) -> list[tuple[int, int]]:
        """Return (index of the point, replicates) of the tests that tell most about the maximum."""
        size = self._batch_size()
        shares = [size // self.spread + (i < size % self.spread) for i in range(self.spread)]
        # May be fewer tests than shares.
        return list(zip(self._next_points(shares), shares, strict=False))

    def _inside_batch(self) -> list[tuple[FloatArray, int]]:
        """Return (point, replicates) of the tests that are lacking along axes that are shorter than the kernel."""
        if not self._coverage.axes:
            return []
        rng = np.random.default_rng([self.seed, self._asked])
        least = self._coverage.telling(self.R, max(self._width(), self.epsilon), self.delta)
        return self._coverage.batch(self.tested, self._samples.counts, least, rng)

    def tell(self, query: Query, outcomes: ArrayLike) -> None:
        """Give the (replicates,) outcomes of a query that was asked.

        Fewer outcomes than were asked for are taken, but the certificate is
        then refused: leaving rollouts out is selection.

        Raises:
            UsageError: the query was not asked or is told twice, too many outcomes, or one is not finite.
        """
        if not isinstance(query, Query):
            raise UsageError(f"tell takes a query that was asked, not a value of type {type(query).__name__}")
        if query.index not in self._open or query.index in self._told:
            raise UsageError(f"query {query.index} is not open: it was told before, or never asked")
        query = self._open[query.index][0]
        values = _numbers(outcomes, f"query {query.index} at {query.point}")
        if len(values) > query.replicates:
            raise UsageError(f"query {query.index} asked for {query.replicates} outcomes, not {len(values)}")
        if len(values) < query.replicates:
            came = f"{len(values)} of {query.replicates} came"
            self._missing = f"query {query.index} at {query.point}: {came}"
        self._told[query.index] = values / self.R
        # A batch is used only when it is whole, in the order asked: the
        # certificate then does not depend on which worker was fastest.
        if len(self._told) == len(self._open):
            self._absorb()

    def observe(self, tests: Iterable[tuple[Mapping[str, float], ArrayLike]], *, final: bool = False) -> None:
        """Give outcomes of tests that were fixed beforehand, not chosen by this search.

        Such a design is predictable, which is all that the bound asks of the choice
        of tests. It is taken in as one batch, so that the order of the list changes
        nothing. The points need not lie on any grid.

        Args:
            tests: (point, (replicates,) outcomes), every outcome that the design gave; each counts once.
            final: ask for nothing further; the search is then done.

        Raises:
            UsageError: a batch is open, a point is outside the box, or an outcome is not finite.
        """
        if self._open:
            raise UsageError("a batch is open: tell its outcomes before those of other tests")
        read = [
            (self.space.vector(point), _numbers(outcomes, f"the observed test {dict(point)}") / self.R)
            for point, outcomes in tests
        ]
        self._final = self._final or final
        for vector, values in read:
            if len(values):
                self._take(self._bounds.add(vector), values)
                self._observed += len(values)
        self._settle()

    def _batch_size(self) -> int:
        # Every query is replicated: scatter between replicates is all that can refute R.
        return max(2 * self.spread, math.ceil(self.batch * self._rollouts))

    def _next_points(self, shares: list[int]) -> list[int]:
        """GP-BUCB: after each choice the deviation shrinks as if it were done, the mean stays.

        While a batch is larger than the share of the rollouts that ``batch`` asks for, it ends after the
        test with which, by the same reckoning, ε is reached. Its tests keep their replicates.
        """
        rng = np.random.default_rng([self.seed, self._asked])
        upper, points = self._bounds.upper[0], self._tiling.points
        chosen = [_argmax(upper, rng)]
        planned = self._samples.add(chosen[0], shares[0], 0.0)
        mean, width, scale = self._tightest(chosen[0])
        oversized = self._data is not None and sum(shares) > math.ceil(self.batch * self._rollouts)
        for share in shares[1:]:
            std = self._engine.condition(points, planned).moments(scale, points).std[0]
            likely = np.minimum(upper, mean + width * std)
            if oversized:
                best = np.maximum(self._bounds.lower[0], mean - width * std).max()
                if likely.max() + self._bounds.hidden[0] - best <= self.epsilon / self.R:
                    break
            chosen.append(_argmax(likely, rng))
            planned = planned.add(chosen[-1], share, 0.0)
        return chosen

    def _tightest(self, place: int) -> tuple[FloatArray, float, FloatArray]:
        """Return (P,) mean, width and (1,) scale of the dual that bounds J best at a point."""
        scales, width, points = self._bound.scales, self._bound.widths[0], self._tiling.points
        if self._data is None:
            return np.zeros(len(points)), float(width[0]), scales
        here = self._data.moments(scales, points[place : place + 1])
        best = int(np.argmin(here.mean[:, 0] + width * here.std[:, 0]))
        mean = self._data.moments(scales[best : best + 1], points).mean[0]
        return mean, float(width[best]), scales[best : best + 1]

    def _absorb(self) -> None:
        """Take in a whole batch."""
        for index, (_query, place) in sorted(self._open.items()):
            if len(self._told[index]):
                self._take(place, self._told[index])
        self._open.clear()
        self._told.clear()
        self._settle()

    def _take(self, place: int, values: FloatArray) -> None:
        """Count (replicates,) outcomes at a point, in units of R."""
        self._rollouts += len(values)
        self._scatter += float(((values - values.mean()) ** 2).sum())
        self._degrees += len(values) - 1
        self._log_e = max(self._log_e, confidence.noise_e_value(self._scatter, self._degrees))
        self._samples = self._samples.add(place, len(values), float(values.sum()))

    def _settle(self) -> None:
        """End a batch: bound J from all outcomes so far."""
        self._iterations += 1
        if len(self._samples):
            self._tighten()

    def _tighten(self) -> None:
        samples = self._samples
        self._data = self._engine.condition(self._tiling.points, samples)
        self._bound = self._mode.bound(self._data, self._rollouts, self._norms, self.delta)
        self._bounds.tighten(self._data, self._bound, TOLERANCE)
        points = self._tiling.points[samples.at]
        gram = self.kernel.gram(points, points)
        norm = confidence.smallest_norm(gram, samples.counts, samples.means, self._bound.radius)
        self._B_low = max(self._B_low, norm)
        if np.isnan(self._bound.widths[0]).any():  # no function of norm ≤ B fits, by however little
            self._B_low = max(self._B_low, float(np.nextafter(self._norms[0], np.inf)) * (1 + 1e-9))

    # -- the answer --------------------------------------------------------------------------

    def band(self, points: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return (n,) lower and upper bounds of J at (n, dim) points, all at once with probability ≥ 1 − δ."""
        where = np.atleast_2d(np.asarray(points, dtype=np.float64))
        if (
            where.shape[1] != self.space.dim
            or not ((where >= self.space.lower) & (where <= self.space.upper)).all()
        ):
            raise UsageError(
                f"the band is known at points of shape (n, {self.space.dim}) within the test space only"
            )
        lower, upper = self._bounds.at(where, self._data, self._bound)
        return lower[0] * self.R, upper[0] * self.R

    @property
    def range(self) -> tuple[float, float]:
        """Bounds of J anywhere in the box: (lower bound of its minimum, upper bound of its maximum)."""
        return float(self._bounds.minimum[0]) * self.R, float(self._bounds.maximum[0]) * self.R

    @property
    def degrees(self) -> int:
        """How many outcomes repeat a test, beyond the first of each: what the e-test of R lives on."""
        return self._degrees

    @property
    def tested(self) -> FloatArray:
        """(u, dim) points of which outcomes were told."""
        return self._tiling.points[self._samples.at]

    @property
    def suggestion(self) -> dict[str, float]:
        """The point of the largest upper bound, where a further test would tell most."""
        return self.space.point(self._tiling.points[int(self._bounds.upper[0].argmax())])

    def _interval(self, rung: int) -> Rung:
        """One rung of the ladder, in the unit of the outcome."""
        return Rung(
            B=float(self._norms[rung]) * self.R,
            lower=float(self._bounds.best[rung]) * self.R,
            upper=float(self._bounds.maximum[rung]) * self.R,
            discretisation=float(self._bounds.hidden[rung]) * self.R,
        )

    def refuse_hopeless(self) -> None:
        """Refuse, before any rollout, a search that would be refused whatever its rollouts show.

        Raises:
            UsageError: a lengthscale is far too long or too short for the test space.
        """
        if hopeless := self._constant or self._too_many:
            raise UsageError(hopeless)

    def _label(self) -> tuple[Label, str]:
        if self._constant or (self._too_many and not self._final):
            return Label.REFUSED, self._constant or self._too_many
        if self._missing:
            return Label.REFUSED, f"rollouts are missing: {self._missing}; leaving rollouts out is selection"
        if self._log_e >= math.log(1 / self.delta):
            return Label.REFUSED, (
                f"R = {self.R:g} is refuted by the scatter of replicates (e-value 10^{self._log_e / math.log(10):.1f} "
                f"≥ 1/δ = {1 / self.delta:.3g}); declare a larger R from a pilot and begin again"
            )
        if self._bounds.empty:
            return Label.REFUSED, (
                "the bounds of different times contradict each other: B, the kernel or R is wrong "
                "(with all of them right this happens with probability ≤ δ)"
            )
        B_low = self._B_low * self.R
        if self._settled() and 2 * B_low > self.B:
            return Label.REFUSED, (
                f"B = {self.B:g} is less than twice the norm that the data already show (B_low = {at_least(B_low)}); "
                + (
                    f"the lengthscale of {self._long_names()}, longer than its range, may be what is wrong"
                    if self._coverage.axes
                    else "read the interval of a larger B in the ladder, if you can say why that B is right"
                )
            )
        width = self._width()
        if width <= self.B and self._rollouts < sequential_lower_bound(self.R, width, self.delta):
            return Label.REFUSED, (
                f"an interval of {width:.3g} after {self._rollouts} rollouts is below what any method can claim: "
                f"this is a defect of s2r, please report it"
            )
        if not self._settled():
            return Label.RUNNING, ""
        if uncovered := self._uncovered():
            return Label.REFUSED, uncovered
        if self.fitted:
            return Label.MODEL_BASED, f"{', '.join(self.fitted)} fitted on the certificate's own data"
        return (Label.CERTIFIED if width <= self.epsilon else Label.BUDGET), ""

    def _long_names(self) -> str:
        return ", ".join(self.space.axes[axis].name for axis in self._coverage.axes)

    def _width(self) -> float:
        rung = self._interval(0)
        return rung.upper - rung.lower

    def _settled(self) -> bool:
        """Whether no further rollout will be asked for, R and B aside."""
        if self._final or self._B_low * self.R > self.B:
            return True
        inside = sum(replicates for _, replicates in self._inside_batch())
        size = inside or self._batch_size()
        spent = self.budget is not None and self._rollouts + size > self.budget
        return spent or (self._width() <= self.epsilon and not inside)

    def _uncovered(self) -> str:
        """Return a sentence if a part of a range was not tested along which the kernel is longer, else ""."""
        if not self._coverage.axes:
            return ""
        least = self._coverage.covering
        lacking = self._coverage.lacking(self.tested, self._samples.counts, least)
        rows, parts = np.nonzero(lacking)
        if not len(rows):
            return ""
        axis = self.space.axes[self._coverage.axes[rows[0]]]
        low, high = (axis.low + axis.width * (parts[0] + end) / LEVELS for end in (0, 1))
        return (
            f"the kernel is longer than the range of {axis.name}, so every eighth of it must be tested first; "
            f"{axis.name} in [{low:.4g}, {high:.4g}] {axis.unit}".rstrip()
            + f" lacks {lacking[rows[0], parts[0]]} of {least} rollouts"
        )

    def certificate(self) -> Certificate:
        """Return what the outcomes told so far certify; valid at any time."""
        label, reason = self._label()
        first = self._interval(0)
        return Certificate(
            lower=first.lower,
            upper=first.upper,
            delta=self.delta,
            target=self.epsilon,
            label=label,
            reason=reason,
            worst=self.space.point(self._tiling.points[int(self._bounds.lower[0].argmax())]),
            rollouts=self._rollouts,
            iterations=self._iterations,
            points=len(self._samples),
            discretisation=first.discretisation,
            ladder=tuple(self._interval(rung) for rung in range(len(LADDER))),
            B_low=self._B_low * self.R,
            log_e_value=self._log_e,
            assumptions=self._assumptions(),
            settings={
                "mode": self.mode,
                "engine": self.engine,
                "kernel": self.kernel.name,
                "lengthscales": self.kernel.lengthscales(self.space.dim).tolist(),
                "B": self.B,
                "R": self.R,
                "delta": self.delta,
                "epsilon": self.epsilon,
                "mixture_scales": (self._mode.mixture * self.R**2).tolist(),
                "batch": self.batch,
                "spread": self.spread,
                "seed": self.seed,
                "fitted": list(self.fitted),
            },
        )

    def _assumptions(self) -> tuple[str, ...]:
        scales = ", ".join(
            f"{scale:g} {axis.unit}".rstrip()
            for axis, scale in zip(self.space.axes, self.kernel.lengthscales(self.space.dim), strict=True)
        )
        unit = f" {self.unit}" if self.unit else ""
        fixed = (
            f"{self._observed} outcomes are of tests that were fixed beforehand, or chosen from outcomes before them "
            f"only, and none was left out for what came of it",
        )
        inside = (
            f"the kernel is longer than the range of {self._long_names()}: between tests the kernel speaks, "
            f"and every eighth of the range was tested",
        )
        return (
            f"the expected outcome, as a function of the test, has norm ≤ B = {self.B:g}{unit} in the RKHS of the "
            f"{self.kernel.words} kernel with lengthscale {scales}; no data can prove this",
            f"the noise of one rollout is R-sub-Gaussian with R = {self.R:g}{unit}, declared before the data",
            f"rollouts are independent given the tests, and {ALL_COUNT}",
            *(fixed if self._observed else ()),
            *(inside if self._coverage.axes else ()),
        )


def _argmax(values: FloatArray, rng: np.random.Generator) -> int:
    return int(rng.choice(np.flatnonzero(values >= values.max() - 1e-12 * max(1.0, abs(values.max())))))


def _numbers(outcomes: ArrayLike, what: str) -> FloatArray:
    """Return outcomes as float64; a number is an array of one."""
    if getattr(outcomes, "dtype", None) in (np.float32, np.float16):
        raise UsageError(
            f"the outcomes of {what} are {np.asarray(outcomes).dtype}: a certificate needs float64"
        )
    try:
        given = np.asarray(outcomes)
    except Exception as error:  # rows of different lengths; an array that another library keeps elsewhere
        raise UsageError(f"the outcomes of {what} are not a list of numbers: {error}") from None
    if given.dtype.kind not in "biuf":
        raise UsageError(f"the outcomes of {what} are {outcomes!r:.60}; they must be a list of numbers")
    values = np.atleast_1d(given.astype(np.float64))
    if values.ndim != 1:
        raise UsageError(f"the outcomes of {what} have shape {values.shape}; they must be a list of numbers")
    if not np.isfinite(values).all():
        raise UsageError(
            f"outcome {int(np.argmin(np.isfinite(values)))} of {what} is not a finite number; "
            f"a fall or a crash must be given the value that was declared for it"
        )
    if (np.abs(values) > LARGEST).any():
        raise UsageError(f"an outcome of {what} is beyond {LARGEST:g}, which double precision cannot square")
    return values
