"""Confidence sequences for a function of bounded RKHS norm, observed with sub-Gaussian noise.

Everything is in units of R: outcomes are divided by R before they come here, so
that a mean over m rollouts has noise variance proxy 1/m. Notation: u distinct
points, Gram matrix K (u, u), rollouts per point m (u,), M = diag(m), means ȳ
(u,), and for every scale a > 0 the Gaussian-process posterior of prior a·k:

    q_a = ȳᵀ(aK + M⁻¹)⁻¹ȳ        L_a = ln det(I + a M^½ K M^½)
    μ_a, v_a: posterior mean and standard deviation

Fixed before the data: mixture scales c_1 … c_J. With probability ≥ 1 − δ, for
all numbers of rollouts at once and every predictable choice of tests,

    (ȳ−J)ᵀM(ȳ−J) ≤ r_n = −2 ln (1/J) Σ_j exp(−(L_{c_j} + q_{c_j})/2) + 2 ln(1/δ),

and then, whenever ‖J‖ ≤ B, for every a > 0 and every test z

    |J(z) − μ_a(z)| ≤ sqrt(r_n + B²/a − q_a) v_a(z).

Neither B nor a enters the event: both may be chosen afterwards.

Sources: Flynn & Reeb, *Tighter confidence bounds for sequential kernel
regression* (2024), for mixtures and the dual; Abbasi-Yadkori (2013) for the
method. One scale, J = 1 and a = c, is their AMM bound. The proof, with
replicates, is in docs/explanation/certificate.md.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from s2r_spec.base.arrays import FloatArray

R_TEST_SCALES = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95])


@dataclass(frozen=True)
class SampleEvidence:
    """Evidence of a sample for A prior scales."""

    log_det: FloatArray
    """(A,) L_a, twice the information gain."""
    quadratic: FloatArray
    """(A,) q_a."""


@dataclass(frozen=True)
class Moments:
    """Posteriors at G points for A prior scales, in units of R."""

    mean: FloatArray
    """(A, G) μ_a."""
    std: FloatArray
    """(A, G) v_a: the standard deviation, not the variance."""


def data_radius(evidence: SampleEvidence, delta: float) -> float:
    """Return r_n from the evidence at the mixture scales."""
    each = -(evidence.log_det + evidence.quadratic) / 2
    return float(-2 * (np.logaddexp.reduce(each) - np.log(each.size)) - 2 * np.log(delta))


def width(B: FloatArray, scales: FloatArray, radius: float, quadratic: FloatArray) -> FloatArray:
    """Return (rungs, A) multipliers sqrt(r_n + B²/a − q_a) of the standard deviation.

    A negative radicand says that no function of norm ≤ B fits the data; its
    multiplier is NaN, never 0. With one scale a = c this is
    β_n = sqrt(B²/c + ln det(I + cM^½KM^½) + 2 ln(1/δ)).
    """
    radicand = radius + B[:, None] ** 2 / scales - quadratic
    return np.sqrt(np.where(radicand >= 0, radicand, np.nan))


def published_beta(B: FloatArray | float, R: float, log_det: float, delta: float) -> FloatArray:
    """Return β_i of Akella, Ubellacker & Ames, Algorithm 1, line 2, in the unit of the outcome.

    β_i = B + R sqrt(2 ln(sqrt(det((1+η_i)I + K_i))/δ)). It multiplies a standard
    deviation (the paper's σ_n, typed as a variance) of the posterior with ridge
    λ_i = 1 + η_i, η_i = 2/i, and K_i is the Gram matrix of the i points sampled
    before. So read it is valid, at every i at once: docs/explanation/certificate.md.

    Args:
        B: bound on the RKHS norm.
        R: sub-Gaussian proxy.
        log_det: ln det((1+η_i)I + K_i).
        delta: 1 − probability.
    """
    return np.asarray(B + R * np.sqrt(log_det + 2 * np.log(1 / delta)))


def smallest_norm(gram: FloatArray, counts: FloatArray, means: FloatArray, radius: float) -> float:
    """Return B_low, the smallest RKHS norm that the data allow, in units of R.

    Any f with (ȳ−f)ᵀM(ȳ−f) ≤ r_n has ‖f‖² ≥ a (q_a − r_n) for every a > 0;
    the best a is taken from a grid over twelve decades. The grid can only make
    B_low smaller, which is safe.
    """
    root = np.sqrt(counts)
    eigenvalues, vectors = np.linalg.eigh(root[:, None] * gram * root)
    loads = (vectors.T @ (root * means)) ** 2
    scales = np.logspace(-4, 8, 241) / max(float(eigenvalues[-1]), 1e-300)
    quadratic = (loads / (1 + scales[:, None] * np.clip(eigenvalues, 0, None))).sum(axis=1)
    return float(np.sqrt(max(0.0, np.max(scales * (quadratic - radius)))))


def norm_free_lower(counts: FloatArray, means: FloatArray, radius: float) -> float:
    """Return a lower bound of max_i J(z_i) over the u tests that needs neither B nor the kernel, in units of R.

    If J < t at every test, then (ȳ−J)ᵀM(ȳ−J) > Σ_i m_i max(ȳ_i − t, 0)². So on the event of the data-fit set the
    maximum is at least the t at which this sum is r_n; it is the only root, because the sum falls with t.

    Args:
        counts: (u,) rollouts per test.
        means: (u,) mean outcomes, in units of R.
        radius: r_n > 0.
    """
    order = np.argsort(-means)
    m, y = counts[order], means[order] - means[order[0]]
    number, first, second = np.cumsum(m), np.cumsum(m * y), np.cumsum(m * y**2)
    # The sum at t = y_k, over the tests above it: those before the first sum of at least r_n lie above the root.
    sums = second - 2 * y * first + y**2 * number
    last = int(np.searchsorted(np.maximum.accumulate(sums), radius)) - 1
    centre = first[last] / number[last]
    scatter = max(0.0, float(second[last] - first[last] * centre))
    return float(means[order[0]] + centre - np.sqrt(max(0.0, radius - scatter) / number[last]))


def noise_e_value(scatter: float, degrees: int) -> float:
    """Return the logarithm of an e-value against "the noise is R-sub-Gaussian".

    Args:
        scatter: Σ (y − ȳ)² within replicated queries, in units of R².
        degrees: number of rollouts minus number of replicated queries.

    For an R-sub-Gaussian noise vector ξ and a projection A of rank r,
    E exp(s ξᵀAξ/2R²) ≤ (1−s)^{−r/2}; so (1−s)^{r/2} exp(s·scatter/2) is an
    e-value for every s in (0, 1), and so is their average. By Ville's
    inequality it ever exceeds 1/δ with probability ≤ δ when R is right.
    """
    s = R_TEST_SCALES
    logs = degrees / 2 * np.log1p(-s) + s * scatter / 2
    return float(np.logaddexp.reduce(logs) - np.log(s.size))


def least_proxy(history: Iterable[tuple[float, int]], delta: float) -> float:
    """Return the smallest R' ≥ R that no e-value of a search refutes at the level δ, in units of R.

    Args:
        history: (scatter, degrees) after each query, as :func:`noise_e_value` takes them.
        delta: level of the test.
    """
    rows = list(history)
    low, high = 1.0, 1e6
    if not any(noise_e_value(scatter, degrees) >= -np.log(delta) for scatter, degrees in rows):
        return low
    for _ in range(60):  # an e-value falls as R' grows
        middle = np.sqrt(low * high)
        refuted = any(
            noise_e_value(scatter / middle**2, degrees) >= -np.log(delta) for scatter, degrees in rows
        )
        low, high = (middle, high) if refuted else (low, middle)
    return float(high)
