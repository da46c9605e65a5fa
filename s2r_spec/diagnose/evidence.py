"""How well each set of effects explains the data: Gaussian evidence with a background and a form error.

    y = Σ_k J_k c_k + e,    c_k ~ N(0, LARGE²) for k in the set, N(0, ALLOWED²) else

y is the data, made linear around the joint fit (:mod:`s2r_spec.diagnose.joint`).
The background says that everything in the catalogue is slightly wrong, e that
features scatter, that laws are other than ours by a part of what was seen, and that
very small changes are not to be believed. All is Gaussian, so sets are scored from one
Gram matrix: every one and two effects, and a third with the best pairs; exactly, but for effects of one
sign, whose half of the prior is taken line by line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.catalogue import Catalogue
from s2r_spec.diagnose.joint import TURN, Joint, Model, joint_fit

FloatArray = NDArray[np.float64]
Set = tuple[int, ...]

ALLOWED = 0.06
"""Standard deviation of what every effect does unasked, as the evidence reckons with it: more than
:data:`~s2r_spec.diagnose.axes.BACKGROUND`, for the laws of the background are not ours either."""
LARGE = 0.7
"""Standard deviation of an effect that is a cause, in parts of its typical size."""
FORM = 0.1
"""The data are believed up to this part of themselves: an effect's law is another than ours."""
GROUND = 0.3
"""Error that is always there, in units of the features' scale."""
MORE = (0.0, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)
"""Error that may be there besides, in the same units: a simulator of which every number is a little off."""
TRIPLES_OF = 5
"""Best pairs that a third effect is tried with."""


def believed(scatter: FloatArray, level: FloatArray | float = 0.0, part: float = 1.0) -> FloatArray:
    """Return (q, k) variance of the data's coefficients.

    Args:
        scatter: (q, k) their variance from rollout to rollout.
        level: (k,) mean square of the data over the tests.
        part: of the usual variance of what is not scatter.
    """
    return scatter + part * (FORM**2 * level + GROUND**2)


@dataclass(frozen=True)
class Linear:
    """Data that are linear in the coordinates of all lines, in units of what is believed.

    Attributes:
        lines: whose coordinates these are.
        gram: (K, K) JᵀV⁻¹J.
        toward: (K,) JᵀV⁻¹y.
        energy: yᵀV⁻¹y.
        seen: mean square of the data themselves, before they were made linear.
        around: (K,) coordinates of the based lines around which y is linear, 0 elsewhere.
        size: dimension of y.
        scale: misfit of the joint fit, at least 1, by which what is believed was widened.
    """

    lines: Catalogue
    gram: FloatArray
    toward: FloatArray
    energy: float
    seen: float
    around: FloatArray
    size: int
    scale: float

    def without(self, effect: int) -> Linear:
        """Return the same with one effect taken out of the catalogue."""
        mine = self.lines.owner == effect
        gram, toward = self.gram.copy(), self.toward.copy()
        gram[mine, :] = gram[:, mine] = 0.0
        toward[mine] = 0.0
        return replace(self, gram=gram, toward=toward)

    def believed_less(self, times: float) -> Linear:
        """Return the same with so many times the variance, that of the nuisances included."""
        return replace(
            self,
            gram=self.gram / times,
            toward=self.toward / times,
            energy=self.energy / times,
            seen=self.seen / times,
            scale=self.scale * times,
        )


def linear(
    lines: Catalogue,
    fitted: Joint,
    data: FloatArray,
    variance: FloatArray,
    nuisances: FloatArray,
) -> Linear:
    """Linearise around a joint fit; ``nuisances`` (v, q, k) may be there at unit size, and are no cause.

    What even the whole catalogue at once does not explain says how far the simulator is to be believed.
    """
    scale = max(fitted.misfit, 1.0)
    root = 1.0 / np.sqrt(variance * scale)
    amounts = np.where(lines.based, 0.0, fitted.at)
    y = ((fitted.rest + np.tensordot(amounts, fitted.jacobian, 1)) * root).ravel()
    j = (fitted.jacobian * root).reshape(len(fitted.at), -1)
    plain = (data * root).ravel()
    seen = float(plain @ plain) / plain.size
    if len(nuisances):
        n = (nuisances * root).reshape(len(nuisances), -1)
        inner = np.linalg.inv(np.eye(len(n)) + n @ n.T)
        y_n, j_n = n @ y, j @ n.T
        gram = j @ j.T - j_n @ inner @ j_n.T
        toward = j @ y - j_n @ inner @ y_n
        energy = float(y @ y - y_n @ inner @ y_n)
    else:
        gram, toward, energy = j @ j.T, j @ y, float(y @ y)
    around = np.where(lines.based, fitted.at, 0.0)
    return Linear(lines, gram, toward, energy, seen, around, y.size, scale)


def ground(
    lines: Catalogue, fitted: Joint, data: FloatArray, variance: FloatArray, nuisances: FloatArray
) -> float:
    """Return which of :data:`MORE` has the largest evidence, with the likeliest of no and of one effect as the cause.

    It is not what a fit of everything leaves, for that has taken much of an error of everything for its own.
    """
    few: list[Set] = [(), *((k,) for k in range(len(lines.effects)))]

    def speaks(more: float) -> float:
        wider = variance + more**2
        seen = linear(lines, replace(fitted, misfit=1.0), data, wider, nuisances)
        best = float(log_evidence(seen, few).max())
        n = (nuisances / np.sqrt(wider)).reshape(len(nuisances), wider.size)
        volume = float(np.log(wider).sum()) + float(np.linalg.slogdet(np.eye(len(n)) + n @ n.T)[1])
        return best - 0.5 * seen.energy - 0.5 * volume

    return max(MORE, key=speaks)


def solved(
    model: Model,
    lines: Catalogue,
    data: FloatArray,
    variance: FloatArray,
    nuisances: FloatArray,
    begin: FloatArray,
    first: FloatArray,
    exact: bool = False,
) -> tuple[Joint, Linear, FloatArray]:
    """Fit the whole catalogue, and linearise there; the arguments are those of :func:`joint_fit`.

    Also returns (q, k) the variance by which the data are believed in the end: where the whole catalogue leaves more
    than it should, every number is taken to be off by as much as the data speak for.
    """
    fitted = joint_fit(model, data, variance, nuisances, begin, first, exact=exact)
    if fitted.misfit > 1.0:
        wide = joint_fit(model, data, variance + max(MORE) ** 2, nuisances, begin, first, exact=exact)
        variance = variance + ground(lines, wide, data, variance, nuisances) ** 2
        fitted = joint_fit(model, data, variance, nuisances, begin, first, exact=exact)
    return fitted, linear(lines, fitted, data, variance, nuisances), variance


@dataclass(frozen=True)
class Evidence:
    """Log evidence of sets of effects, up to one constant.

    Attributes:
        members: the sets: none, every single, every pair, some triples.
        logs: (sets,) log evidence.
        left: (4,) part of the energy that is left after the best set of 0, 1, 2 and 3 effects and the background.
        pull: (4,) mean square of the background's coordinates in these, in units of what is allowed.
        energy: mean square of the data per dimension.
    """

    members: tuple[Set, ...]
    logs: FloatArray
    left: FloatArray
    pull: FloatArray
    energy: float

    def best(self, size: int) -> float:
        """Return the largest log evidence of sets of this size; −inf if there are none."""
        return max(
            (float(v) for s, v in zip(self.members, self.logs, strict=True) if len(s) == size),
            default=-np.inf,
        )


def evidence(data: Linear, without: int | None = None) -> Evidence:
    """Score every set of at most two effects, and the best pairs with a third; ``without`` one, if given."""
    if without is not None:
        data = data.without(without)
    able = [k for k in range(len(data.lines.effects)) if k != without]
    few: list[Set] = [(), *((k,) for k in able), *combinations(able, 2)]
    logs = log_evidence(data, few)
    pairs = [few[i] for i in np.argsort(-logs) if len(few[i]) == 2][:TRIPLES_OF]
    many = sorted({tuple(sorted((*s, k))) for s in pairs for k in able if k not in s})
    members = (*few, *many)
    logs = np.concatenate([logs, log_evidence(data, many)]) if many else logs
    left: list[float] = []
    pull: list[float] = []
    for size in range(4):
        of = [i for i, s in enumerate(members) if len(s) == size]
        if not of:
            left.append(left[-1])
            pull.append(pull[-1])
            continue
        chosen = members[max(of, key=lambda i: logs[i])]
        mean, _ = posterior(data, chosen)
        # The background is free to help; what it is pulled by is told apart.
        unexplained = data.energy - 2.0 * float(mean @ data.toward) + float(mean @ data.gram @ mean)
        left.append(max(unexplained, 0.0) / max(data.energy, 1e-12))
        back = ~_mine(data, [chosen])[0] & ~data.lines.based
        pull.append(float(((mean[back] / ALLOWED) ** 2).mean()) if back.any() else 0.0)
    return Evidence(members, logs, np.array(left), np.array(pull), data.seen)


def posterior(data: Linear, chosen: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Return mean (K,) and covariance (K, K) of all coordinates, if ``chosen`` are the causes.

    The mean of a based line is its distance from ``data.around``.
    """
    spread = _spreads(data, [tuple(chosen)])[0]
    covariance: FloatArray = np.asarray(np.linalg.inv(data.gram + np.diag(spread**-2.0)), dtype=np.float64)
    mean: FloatArray = covariance @ data.toward
    return mean, covariance


def explained(data: Linear, chosen: Sequence[int]) -> float:
    """Return what the posterior mean of this set costs: what it leaves of the data, and how unlikely it is itself."""
    mean, _ = posterior(data, chosen)
    # At the mean, (G + S⁻²) m = Jᵀy.
    return data.energy - float(mean @ data.toward)


def _spreads(data: Linear, sets: Sequence[Set]) -> FloatArray:
    """Return (sets, K) standard deviations of the coordinates before the data are seen."""
    usual = np.where(data.lines.based, TURN, ALLOWED)
    return np.where(_mine(data, sets), LARGE, usual)


def _mine(data: Linear, sets: Sequence[Set]) -> NDArray[np.bool_]:
    """Return (sets, K): which coordinates are amounts of an effect in the set."""
    inside = np.zeros((len(sets), len(data.lines.effects)), dtype=np.bool_)
    for row, chosen in zip(inside, sets, strict=True):
        row[list(chosen)] = True
    return inside[:, data.lines.owner] & ~data.lines.based


def log_evidence(data: Linear, sets: Sequence[Set]) -> FloatArray:
    """Return (sets,) log evidence, up to one constant."""
    usual = np.where(data.lines.based, TURN, ALLOWED)
    covariance: FloatArray = np.asarray(np.linalg.inv(data.gram + np.diag(usual**-2.0)), dtype=np.float64)
    mean = covariance @ data.toward
    little = 0.5 * float(np.linalg.slogdet(covariance)[1] - 2.0 * np.log(usual).sum() + mean @ data.toward)
    large = [tuple(np.flatnonzero(row).tolist()) for row in _mine(data, sets)]
    return little + gained(covariance, mean, usual, data.lines.side, large)


def gained(
    covariance: FloatArray,
    mean: FloatArray,
    usual: FloatArray,
    side: FloatArray | NDArray[np.intp],
    large: Sequence[tuple[int, ...]],
) -> FloatArray:
    """Return (n,) by how much log evidence grows if some lines are causes, and not a little of everything.

    Args:
        covariance: (K, K) of the coordinates if none is.
        mean: (K,) of these.
        usual: (K,) their standard deviations before the data are seen, if none is; of one that is, LARGE.
        side: (K,) 1 or −1 where a coordinate can only be of that sign, else 0.
        large: n times, the places of the lines that are.
    """
    found = np.zeros(len(large))
    for count in {len(lines) for lines in large} - {0}:
        which = [n for n, lines in enumerate(large) if len(lines) == count]
        found[which] = _updated(
            covariance, mean, usual, side, np.array([large[n] for n in which], dtype=np.intp)
        )
    return found


def _updated(
    covariance: FloatArray,
    mean: FloatArray,
    usual: FloatArray,
    side: FloatArray | NDArray[np.intp],
    lines: NDArray[np.intp],
) -> FloatArray:
    """Return the same for (n, count) lines: an update of low rank."""
    from scipy.special import log_ndtr

    less = LARGE**-2.0 - usual[lines] ** -2.0
    before = covariance[lines[:, :, None], lines[:, None, :]]
    turned = np.eye(lines.shape[1]) + before * less[:, None, :]
    inner = np.linalg.inv(turned)
    there = np.einsum("nij,nj->ni", inner, mean[lines])
    volume = -0.5 * np.linalg.slogdet(turned)[1] - np.log(LARGE / usual[lines]).sum(axis=1)
    gain = -0.5 * np.einsum("ni,ni,ni->n", mean[lines], less, there)
    deviation = np.sqrt(np.maximum(np.einsum("nij,nji->ni", inner, before), 1e-300))
    # A law of one sign: only that half of the prior was there to begin with.
    half = np.log(2.0) + log_ndtr(side[lines] * there / deviation)
    found: FloatArray = volume + gain + np.where(side[lines] != 0, half, 0.0).sum(axis=1)
    return found
