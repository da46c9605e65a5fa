"""The search: where to test next, and what the tests so far certify.

*Modified GP-UCB* of Akella, Ubellacker and Ames with a confidence sequence that
holds: the next test maximises the upper confidence bound, and the search ends
when the certified maximum J^e is within ε of the best lower confidence bound.

The search never runs anything. It is asked for tests and told their outcomes,
so that a simulator, a folder of logs or a person with a robot can be behind it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from s2r_spec.certify import confidence
from s2r_spec.certify.band import Band, Fit, fit, scales_for
from s2r_spec.certify.certificate import Certificate, Label, Rung
from s2r_spec.certify.kernels import FAMILIES, Kernel
from s2r_spec.certify.maximise import grid_for
from s2r_spec.certify.posterior import ENGINES
from s2r_spec.certify.samples import Samples
from s2r_spec.errors import UsageError, one_of
from s2r_spec.space import Space

FloatArray = NDArray[np.float64]

LADDER = (1.0, 2.0, 4.0, 8.0)
# Share of ε that the grid may cost; smaller only makes the grid finer.
GRID_SHARE = 0.02


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
        spread: distinct points per batch, chosen as in GP-BUCB; each is run at least twice.
        budget: most rollouts; None for as many as ε takes. The search ends before the first batch
            that would exceed it, so that the same tests are asked for under any budget.
        engine: ``spectral`` or ``gpytorch``, see :mod:`s2r_spec.certify.posterior`.

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
    ) -> None:
        self.space = space if isinstance(space, Space) else Space.of(space)
        if self.space.dim == 0:
            raise UsageError("the test space is empty: declare at least one parameter with a range")
        _positive(B=B, R=R, epsilon=epsilon, batch=batch, spread=spread)
        if not 0 < delta < 1:
            raise UsageError(f"delta = {delta:g}; it is a probability and must lie strictly between 0 and 1")
        if engine not in ENGINES:
            raise UsageError(f"no engine {engine!r}; there are: {one_of(ENGINES)}")
        if budget is not None and budget < 2 * spread:
            raise UsageError(f"budget = {budget}; the first batch alone takes {2 * spread} rollouts")
        self.kernel, self.B, self.R, self.delta, self.epsilon = (
            kernel,
            float(B),
            float(R),
            float(delta),
            float(epsilon),
        )
        self.mode, self.seed, self.batch, self.spread, self.budget = mode, seed, batch, int(spread), budget
        self.engine = engine

        self._grid = grid_for(self.space, kernel, GRID_SHARE * self.epsilon / self.B)
        self._norms = np.array(LADDER) * self.B / self.R
        self._scales = scales_for(mode, kernel, self._norms)
        self._gp = ENGINES[engine](kernel, self._grid.points)
        self._band = Band.prior(self._norms, len(self._grid.points))
        self._fit: Fit | None = None
        self._samples = Samples()
        self._open: dict[int, tuple[Query, int]] = {}
        self._told: dict[int, FloatArray] = {}
        self._asked = 0
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
        size = self._batch_size()
        shares = [size // self.spread + (i < size % self.spread) for i in range(self.spread)]
        for place, share in zip(self._next_points(shares), shares, strict=True):
            query = Query(self._asked, self.space.point(self._grid.points[place]), share)
            self._open[query.index] = (query, place)
            self._asked += 1
        return [query for query, _ in self._open.values()]

    def tell(self, query: Query, outcomes: ArrayLike) -> None:
        """Give the (replicates,) outcomes of a query that was asked.

        Fewer outcomes than were asked for are taken, but the certificate is
        then refused: leaving rollouts out is selection.

        Raises:
            UsageError: the query was not asked or is told twice, too many outcomes, or one is not finite.
        """
        if query.index not in self._open or query.index in self._told:
            raise UsageError(f"query {query.index} is not open: it was told before, or never asked")
        values = np.atleast_1d(np.asarray(outcomes, dtype=np.float64))
        if values.ndim != 1 or len(values) > query.replicates:
            raise UsageError(f"query {query.index} asked for {query.replicates} outcomes, not {values.shape}")
        if not np.isfinite(values).all():
            raise UsageError(
                f"outcome {int(np.argmin(np.isfinite(values)))} of query {query.index} at {query.point} is not a "
                f"finite number; a fall or a crash must be given the value that was declared for it"
            )
        if len(values) < query.replicates:
            came = f"{len(values)} of {query.replicates} came"
            self._missing = f"query {query.index} at {query.point}: {came}"
        self._told[query.index] = values / self.R
        # A batch is used only when it is whole, in the order asked: the
        # certificate then does not depend on which worker was fastest.
        if len(self._told) == len(self._open):
            self._absorb()

    def _batch_size(self) -> int:
        # Every query is replicated: scatter between replicates is all that can refute R.
        return max(2 * self.spread, math.ceil(self.batch * self._rollouts))

    def _next_points(self, shares: list[int]) -> list[int]:
        """GP-BUCB: after each choice the deviation shrinks as if it were done, the mean stays."""
        rng = np.random.default_rng([self.seed, self._asked])
        upper = self._band.upper[0]
        chosen = [_argmax(upper, rng)]
        planned = self._samples.add(chosen[0], shares[0], 0.0)
        mean, width, scale = self._tightest(chosen[0])
        for share in shares[1:]:
            std = self._gp.posterior(planned.at, planned.counts, planned.means, scale).std[0]
            chosen.append(_argmax(np.minimum(upper, mean + width * std), rng))
            planned = planned.add(chosen[-1], share, 0.0)
        return chosen

    def _tightest(self, place: int) -> tuple[FloatArray, float, FloatArray]:
        """Return (G,) mean, width and (1,) scale of the dual that bounds J best at a grid point."""
        if self._fit is None:
            scale = self._scales.dual[:1]
            return np.zeros(len(self._grid.points)), float(self._norms[0] / np.sqrt(scale[0])), scale
        posterior, width = self._fit.posterior, self._fit.width[0]
        best = int(np.argmin(posterior.mean[:, place] + width * posterior.std[:, place]))
        return posterior.mean[best], float(width[best]), self._scales.dual[best : best + 1]

    def _absorb(self) -> None:
        """Take in a whole batch."""
        for index, (_query, place) in sorted(self._open.items()):
            values = self._told[index]
            if not len(values):
                continue
            self._rollouts += len(values)
            self._scatter += float(((values - values.mean()) ** 2).sum())
            self._degrees += len(values) - 1
            self._log_e = max(self._log_e, confidence.noise_e_value(self._scatter, self._degrees))
            self._samples = self._samples.add(place, len(values), float(values.sum()))
        self._open.clear()
        self._told.clear()
        self._iterations += 1
        if len(self._samples):
            self._tighten()

    def _tighten(self) -> None:
        data = self._samples
        self._fit = fit(self._gp, data, self._scales, self._norms, self.delta)
        self._band = self._band.intersect(self._fit)
        points = self._grid.points[data.at]
        norm = confidence.smallest_norm(
            self.kernel.gram(points, points), data.counts, data.means, self._fit.radius
        )
        self._B_low = max(self._B_low, norm)

    # -- the answer --------------------------------------------------------------------------

    def _interval(self, rung: int) -> Rung:
        """One rung of the ladder, in the unit of the outcome."""
        norm = float(self._norms[rung])
        hidden = norm * self._grid.interpolation
        return Rung(
            B=norm * self.R,
            lower=float(self._band.lower[rung].max()) * self.R,
            upper=(float(self._band.upper[rung].max()) + hidden) * self.R,
            discretisation=hidden * self.R,
        )

    def _label(self) -> tuple[Label, str]:
        if self._missing:
            return Label.REFUSED, f"rollouts are missing: {self._missing}; leaving rollouts out is selection"
        if self._log_e >= math.log(1 / self.delta):
            return Label.REFUSED, (
                f"R = {self.R:g} is refuted by the scatter of replicates (e-value 10^{self._log_e / math.log(10):.1f} "
                f"≥ 1/δ = {1 / self.delta:.3g}); declare a larger R from a pilot and begin again"
            )
        B_low = self._B_low * self.R
        if self._settled() and 2 * B_low > self.B:
            return Label.REFUSED, (
                f"B = {self.B:g} is less than twice the norm that the data already show (B_low = {B_low:.3g}); "
                f"read the interval of a larger B in the ladder, if you can say why that B is right"
            )
        if self._width() <= self.epsilon:
            return Label.CERTIFIED, ""
        return (Label.BUDGET if self._settled() else Label.RUNNING), ""

    def _width(self) -> float:
        rung = self._interval(0)
        return rung.upper - rung.lower

    def _settled(self) -> bool:
        """Whether no further rollout will be asked for, R and B aside."""
        spent = self.budget is not None and self._rollouts + self._batch_size() > self.budget
        return spent or self._width() <= self.epsilon or self._B_low * self.R > self.B

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
            worst=self.space.point(self._grid.points[int(self._band.lower[0].argmax())]),
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
                "mixture_scales": (self._scales.mixture * self.R**2).tolist(),
                "batch": self.batch,
                "spread": self.spread,
                "seed": self.seed,
            },
        )

    def _assumptions(self) -> tuple[str, ...]:
        scales = ", ".join(
            f"{scale:g} {axis.unit}".rstrip()
            for axis, scale in zip(self.space.axes, self.kernel.lengthscales(self.space.dim), strict=True)
        )
        return (
            f"the expected outcome, as a function of the test, has norm ≤ B = {self.B:g} in the RKHS of the "
            f"{FAMILIES[self.kernel.name].words} kernel with lengthscale {scales}; no data can prove this",
            f"the noise of one rollout is R-sub-Gaussian with R = {self.R:g}, declared before the data",
            "rollouts are independent given the tests, and every rollout that was asked for is counted",
        )


def _argmax(values: FloatArray, rng: np.random.Generator) -> int:
    return int(rng.choice(np.flatnonzero(values >= values.max() - 1e-12 * max(1.0, abs(values.max())))))


def _positive(**settings: float) -> None:
    for name, value in settings.items():
        if not (math.isfinite(value) and value > 0):
            raise UsageError(f"{name} = {value:g}; it must be a positive number")
