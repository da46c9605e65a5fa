"""Settings of a search: all of them are declared before the first outcome."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Required, TypedDict

from s2r_spec.base.errors import UsageError, one_of
from s2r_spec.base.magnitude import number, positive, whole
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.bound.modes import MODES
from s2r_spec.certify.bound.posterior import ENGINES
from s2r_spec.runs.stop_rule import EPSILON, as_stop
from s2r_spec.space import Space

MOST_PRECISE = 1e5
"""Tolerance: largest B/R (dimensionless). The bound's arithmetic has numbers of order (B/R)² times the rollouts; beyond
this ratio it is lost in rounding."""
MOST_PARAMETERS = 8
"""Budget: most test parameters. A cell has 2^dim corners, so one more parameter doubles the work."""


class SearchKeywords(TypedDict, total=False):
    """Keywords of :class:`s2r_spec.Search`; :class:`SearchSettings` describes them and has their defaults."""

    kernel: Required[Kernel]
    B: Required[float]
    R: Required[float]
    delta: Required[float]
    epsilon: Required[float]
    mode: str
    seed: int
    batch: float
    spread: int
    budget: int | None
    stop: str
    engine: str
    repeats: bool
    fitted: tuple[str, ...]
    unit: str


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """The declaration of a search.

    Args:
        space: the test space.
        kernel: the kernel, with lengthscales in the units of the space.
        B: bound on the RKHS norm of J, in the unit of the outcome.
        R: sub-Gaussian proxy of one outcome's noise, in the unit of the outcome. It is declared, never fitted.
        delta: the certificate holds with probability ≥ 1 − δ over the noise, at every time at once.
        epsilon: the search is done when the interval is no wider than this, in the unit of the outcome.
        mode: the confidence set. ``rigorous`` mixes several prior scales, ``rigorous-simple`` has one (see
            :mod:`s2r_spec.certify.bound.confidence`). Both hold; the first takes fewer rollouts.
        seed: breaks ties between equally good tests.
        batch: rollouts of a batch as a share of all rollouts before it. A larger share means fewer batches and more
            rollouts.
        spread: distinct tests of a batch, chosen as in GP-BUCB. Each is run at least twice, so that the first batches
            are larger than ``batch`` says; they may have fewer tests.
        budget: most rollouts; None for as many as ε takes. The search ends before the first batch that would exceed
            it, so that the tests are the same under every budget.
        stop: when the search ends before its budget is spent. ``epsilon``: the interval is ε wide. ``decided``: the
            sign of the maximum is known, too, and R was tested (see :mod:`s2r_spec.certify.search.stopping`).
            ``budget``: never. The tests are the same under every rule.
        engine: the engine of the Gaussian process, ``spectral`` or ``gpytorch``; see
            :mod:`s2r_spec.certify.bound.posterior`.
        repeats: whether a batch repeats a test once the verdict is known and only the test of R lacks outcomes.
        fitted: names of settings ("R", "kernel", "B") that were fitted on the outcomes of this same search. The
            result is then model-based and no certificate.
        unit: the unit of the outcome, for the sentences.

    Raises:
        UsageError: a setting is out of its range; the message names it.
    """

    space: Space
    kernel: Kernel
    B: float
    R: float
    delta: float
    epsilon: float
    mode: str = "rigorous"
    seed: int = 0
    batch: float = 0.1
    spread: int = 4
    budget: int | None = None
    stop: str = EPSILON
    engine: str = "spectral"
    repeats: bool = False
    fitted: tuple[str, ...] = ()
    unit: str = ""

    def __post_init__(self) -> None:
        _check_space(self.space)
        if not isinstance(self.kernel, Kernel):
            raise UsageError(f"kernel = {self.kernel!r}; it must be a Kernel, like Kernel('matern52', 0.2)")
        self.kernel.lengthscales(self.space.dim)
        for name in ("B", "R", "epsilon", "batch"):
            self._set(name, positive(name, getattr(self, name)))
        self._set("delta", _probability(self.delta))
        B, R, epsilon = self.B, self.R, self.epsilon
        if epsilon >= 2 * B:
            raise UsageError(
                f"epsilon = {epsilon:g} is no narrower than the interval that B = {B:g} gives without rollouts; "
                f"it must be below 2B"
            )
        if B / R > MOST_PRECISE:
            raise UsageError(
                f"R = {R:g} is too small for B = {B:g}: double precision allows B/R up to {MOST_PRECISE:g}; "
                f"declare a larger R"
            )
        for name, least in (("spread", 1), ("seed", 0)):
            count = number(name, getattr(self, name))
            if not count.is_integer() or count < least:
                words = (
                    f"spread = {self.spread} and seed = {self.seed} must be whole numbers, at least 1 and 0"
                )
                raise UsageError(words)
        self._set("spread", int(self.spread))
        self._set("seed", int(self.seed))
        for name, value, valid in (("mode", self.mode, MODES), ("engine", self.engine, ENGINES)):
            if value not in valid:
                raise UsageError(f"{name} = {value!r}; it must be one of {one_of(valid)}")
        self._set("stop", as_stop(self.stop))
        self._set("budget", _budget(self.budget, self.spread))
        self._set("fitted", _names(self.fitted))

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)


def _check_space(space: Space) -> None:
    if space.dim == 0:
        raise UsageError("the test space is empty: declare at least one parameter with a range")
    if unfit := [axis.unfit for axis in space.axes if axis.unfit]:
        raise UsageError(unfit[0])
    if space.dim > MOST_PARAMETERS:
        raise UsageError(
            f"the test space has {space.dim} parameters; a certified search takes at most {MOST_PARAMETERS}"
        )


def _probability(delta: object) -> float:
    probability = number("delta", delta)
    if not 0 < probability < 1:
        raise UsageError(
            f"delta = {probability:g}; it is a probability and must lie strictly between 0 and 1"
        )
    return positive("delta", probability)


def _budget(budget: object, spread: int) -> int | None:
    if budget is None:
        return None
    rollouts = whole("budget", budget, 0)
    if rollouts < 2 * spread:
        raise UsageError(f"budget = {rollouts}; the first batch alone takes {2 * spread} rollouts")
    return rollouts


def _names(fitted: tuple[str, ...] | None) -> tuple[str, ...]:
    if isinstance(fitted, str) or not all(isinstance(name, str) for name in fitted or ()):
        raise UsageError(f"fitted = {fitted!r}; it must be names of settings, like ('R', 'kernel')")
    return tuple(fitted or ())
