"""Does the best set of effects fit this machine as well as it fits machines of the catalogue?

Data: of every experiment p the residual r_p (n_p,) that the fit leaves, in units of u (:mod:`.observation`), in groups
g of one quantity and one statistic. Unknown: whether a machine of the catalogue leaves so much. Model, the null: the
machine has the sizes θ of the fit, and every error of :mod:`.hierarchical`, each with its prior:

    r_g = s_g e_g + M_g b_g,   e_g: N_g independent N(0, 1),   b_g ~ N(0, T_g),
    s_g² ~ Inv-χ²(ν, 1),   τ_g² ~ Inv-χ²(ν, τ0²),   T_g = diag(τ_g² I_K + ρ_g² diag(θ²), 4 τ_g² I_V)

M_g (n_g, K + V) are the responses at θ. Estimator: the loss of a group, and that of a *cell*, one column of it in one
part of the time, is that of the search:

    ℓ = ½ (ν + N) log(1 + N |r|²/(n ν))                  minus the log density of Student's t, up to a constant

A statistic is the sum of ℓ over the groups of an experiment, that over the groups of a quantity in all experiments, or
the largest cell of an experiment. M residuals are drawn from the null. Every statistic is counted in standard
deviations beyond its mean, over the data and all draws. T is the largest of all. p is the share of the data and the
draws with a T of at least the data's. It is a conformal p-value: if the data are exchangeable with the draws, then
P(p ≤ α) ≤ α for every α, however the statistics depend on each other. A campaign that looks L times has the level α/L
at each look (Bonferroni), so that it may stop at any look.

Assumed: θ is known. The fit has lowered the real residual and not those of the draws, so p comes out too large. A cause
that effects of the catalogue imitate in all experiments leaves no residual, and no alarm.

Units: r in u; times in s. Shapes: n_g observables and N_g independent numbers of a group, K parameters, V variants.
Source: Vovk, Gammerman & Shafer, *Algorithmic Learning in a Random World* (2005), §2; Gelman et al., *Bayesian Data
Analysis*, 3rd ed., §6.3.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.json_types import Probability
from s2r_spec.base.json_values import Shown
from s2r_spec.diagnose.inference.gauss_newton import Fit
from s2r_spec.diagnose.inference.hierarchical import DEGREES, LARGEST, LAW_ERROR, Variances, law_prior
from s2r_spec.diagnose.inference.observation import Observation, Problem
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.observables import BINS, WINDOWS

LEVEL = 0.05
"""Level: probability of an alarm at a machine of the catalogue, over all looks."""
DRAWS = 499
"""Budget: M, residuals drawn from the null. The least p-value is 1/(M + 1)."""
SEED = 2_000
"""Definition: of the draws. Every group has a stream of its own, so that the order of groups changes nothing."""
PARTS = 5
"""Definition: equal parts of the time of cells of means."""


@dataclass(frozen=True)
class Misfit(Shown):
    """Where the misfit of the traces is largest.

    Attributes:
        experiment: the experiment in words.
        quantity: the channel or the residual.
        statistic: what of it is compared: its means over parts of the trace, its scatter, …
        part: the column of the quantity; "" if it has one.
        begin: the start of the place [s].
        end: the end of the place [s].
    """

    experiment: Experiment
    quantity: str
    statistic: str
    part: str
    begin: float
    end: float

    JSON = "experiment=experiment.__str__ quantity statistic part begin end"


@dataclass(frozen=True)
class GoodnessOfFit(Shown):
    """Whether the best set of effects fits the traces as well as it fits machines of the catalogue.

    Attributes:
        p: conformal p-value over all experiments.
        level: level of the alarm.
        worst: where the misfit is largest.
    """

    p: Probability
    level: Probability
    worst: Misfit

    JSON = "p level alarm worst"

    @property
    def alarm(self) -> bool:
        """Whether the p-value is at most this level."""
        return self.p <= self.level


def goodness_of_fit(
    problem: Problem, fit: Fit, looks: int = 1, columns: Mapping[str, Sequence[str]] | None = None
) -> GoodnessOfFit:
    """Return whether a fit leaves more than machines of the catalogue do; nothing is simulated.

    The number of looks of a campaign is fixed before the first. ``columns`` is channel → name of each column; those
    without a name are numbered from 1.
    """
    pairs = zip(problem.observations, fit.errors.variances, strict=True)
    tests = [_Tested.of(one, fit, own) for one, own in pairs if one.parts]
    quantities: dict[str, FloatArray] = {}
    for each in tests:
        for ((quantity, _), _), loss in zip(each.one.parts, each.losses, strict=True):
            quantities[quantity] = quantities.get(quantity, np.zeros(1 + DRAWS)) + loss
    both = [np.maximum(_standard(one.losses.sum(axis=0)), _standard(one.excess.max(axis=0))) for one in tests]
    extreme = np.max([*both, *map(_standard, quantities.values())], axis=0)
    worst = tests[int(np.argmax([each[0] for each in both]))]
    return GoodnessOfFit(float(np.mean(extreme >= extreme[0])), LEVEL / looks, worst.place(columns or {}))


@dataclass(frozen=True)
class _Cell:
    """A cell: its group, its column among how many, begin and end as parts of the duration, places among the n."""

    group: tuple[str, str]
    column: int
    width: int
    span: tuple[float, float]
    places: NDArray[np.int64]


@dataclass(frozen=True)
class _Tested:
    """The observation of one experiment, its C cells, and losses: of the data first, then of M draws.

    Attributes:
        losses: (G, 1 + M) of every group.
        excess: (C, 1 + M) loss of each cell, in standard deviations beyond its mean.
    """

    one: Observation
    losses: FloatArray
    cells: tuple[_Cell, ...]
    excess: FloatArray

    @classmethod
    def of(cls, one: Observation, fit: Fit, variances: FloatArray) -> _Tested:
        unit = one.unit(variances)
        data, responses = one.residual(fit.theta) / unit, one.columns(fit.theta) / unit
        cells = list(_cells(one))
        losses, excess = [], []
        for number, (group, places) in enumerate(one.parts):
            stream = zlib.crc32(f"{one.response.experiment} {group}".encode())
            size, coherent = float(one.effective[number]), float(one.coherent[number])
            drawn = _draw_residuals(stream, responses[:, places], fit.errors.sizes, coherent, size)
            squares = np.clip(np.vstack([data[places], drawn]), -LARGEST, LARGEST) ** 2
            share = size / places.size
            losses.append(_loss(squares, share))
            own = [cell.places - places[0] for cell in cells if cell.group == group]
            excess += [_standard(_loss(squares[:, each], share)) for each in own]
        return cls(one, np.array(losses), tuple(cells), np.array(excess))

    def place(self, columns: Mapping[str, Sequence[str]]) -> Misfit:
        cell = self.cells[int(np.argmax(self.excess[:, 0]))]
        observables = self.one.response.observables
        channel = next(q.channel for q in observables.quantities if q.name == cell.group[0])
        names = columns.get(channel, ())
        part = "" if cell.width == 1 else f"column {cell.column + 1}"
        return Misfit(
            self.one.response.experiment,
            *cell.group,
            names[cell.column] if len(names) == cell.width > 1 else part,
            cell.span[0] * observables.duration,
            cell.span[1] * observables.duration,
        )


def _draw_residuals(
    stream: int, responses: FloatArray, sizes: FloatArray, coherent: float, effective: float
) -> FloatArray:
    """Return (M, n) residuals of a group in units of u, from (K + V, n) its responses.

    Columns are drawn in the order of their energy, so that the order of the catalogue changes nothing.
    """
    random = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(stream,)))
    size, number = responses.shape[1], round(effective)
    noise, law = DEGREES / random.chisquare(DEGREES, (2, DRAWS))
    scatter = random.normal(size=(DRAWS, number))[:, np.arange(size) * number // size]
    drawn = Variances(noise, LAW_ERROR**2 * law)
    variance = law_prior(drawn, np.full(DRAWS, coherent), sizes, len(responses))
    order = np.argsort((responses**2).sum(axis=1))
    errors = np.sqrt(variance[:, order]) * random.normal(size=(DRAWS, len(responses)))
    return np.asarray(np.sqrt(noise)[:, None] * scatter + errors @ responses[order])


def _loss(squares: FloatArray, share: float) -> FloatArray:
    number = share * squares.shape[1]
    return np.asarray(0.5 * (DEGREES + number) * np.log1p(share * squares.sum(axis=1) / DEGREES))


def _standard(values: FloatArray) -> FloatArray:
    return np.asarray((values - values.mean()) / max(float(values.std()), 1e-12))


def _cells(one: Observation) -> Iterator[_Cell]:
    widths = {quantity.name: quantity.scale.size for quantity in one.response.observables.quantities}
    starts = {(group.quantity, group.statistic): group.start for group in one.response.observables.groups}
    for group, places in one.parts:
        width = widths[group[0]]
        row, column = np.divmod(one.kept[places] - starts[group], width)
        spans = _spans(group[1])
        span = row * len(spans) // BINS if group[1] == "bin" else np.minimum(row, len(spans) - 1)
        for k, c in sorted(set(zip(span.tolist(), column.tolist(), strict=True))):
            yield _Cell(group, c, width, spans[k], places[(span == k) & (column == c)])


def _spans(statistic: str) -> list[tuple[float, float]]:
    if statistic == "bin":
        return list(pairwise(np.linspace(0.0, 1.0, PARTS + 1).tolist()))
    if statistic == "mean":
        return list(pairwise(WINDOWS))
    return [(0.0, 0.5), (0.5, 1.0), (0.0, 1.0)] if statistic == "ripple" else [(0.0, 1.0)]
