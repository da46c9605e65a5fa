"""The next experiment: the one that best separates the most probable sets of effects.

Data: the posterior over sets (:mod:`..inference.model_search`) and the response library. Unknown: the experiment whose
run says most about the set. Criterion, by the distances D_ij of :mod:`.identifiability`:

    Σ_{i<j} p_i p_j min(D²_ij, 25) / cost          (Box & Hill, without their term for the sizes)

A design that is chosen under a wrong model gets stuck, so a campaign runs a screen of all experiments before.

Units: D in standard deviations per run, cost in seconds, entropy in bits.
Source: Box & Hill, *Technometrics* 9 (1967) 57.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.json_values import DIGITS, Shown
from s2r_spec.diagnose.experiment_design.identifiability import Candidate, InformationForecast

ENOUGH = 25.0
"""Level: D² beyond which two sets are separated. Higher, pairs that any run separates count more."""
LEAST = 1.0
"""Level: distance of two sets below which no run is worth its cost, in standard deviations."""
DRAWS = 200
"""Budget: simulated outcomes behind the expected entropy, which they give to about 0.05 bit."""


@dataclass(frozen=True)
class NextTest(Shown):
    """The experiment to run next.

    Attributes:
        candidate: the experiment.
        protocol: the name of the protocol; "" for a test of the specification.
        params: its parameters.
        separates: the two sets of effects that it separates.
        sigma: their distance in standard deviations per run.
        entropy: expected fall of the entropy of the set, in bits.
    """

    candidate: Candidate
    separates: tuple[tuple[str, ...], tuple[str, ...]]
    sigma: float = field(metadata={DIGITS: 2})
    entropy: float = field(metadata={DIGITS: 3})

    JSON = "protocol=candidate.shown.protocol params=candidate.shown.values separates sigma entropy"


def next_test(forecast: InformationForecast, candidates: Sequence[Candidate]) -> NextTest | None:
    """Return the allowed experiment that separates the sets best for its cost; None where none separates them.

    Candidates that the library does not have are left out.
    """
    estimate = forecast.estimate
    p = estimate.posterior.probability[: len(forecast.names)]
    different = np.array([[a != b for a in forecast.names] for b in forecast.names])
    weight = np.where(different, np.outer(p, p), 0.0)
    known = estimate.library.experiments
    best, chosen = 0.0, None
    for one in candidates:
        if not one.allowed or one.experiment not in known:
            continue
        gained = forecast.gained(one)
        distance = forecast.apart(gained)
        gains = weight * np.minimum(distance**2, ENOUGH)
        worth = 0.5 * float(gains.sum()) / one.cost
        first, second = sorted(divmod(int(gains.argmax()), len(p)))
        if worth > best and distance[first, second] >= LEAST:
            pair = forecast.names[first], forecast.names[second]
            best, chosen = worth, (one, pair, float(distance[first, second]), gained)
    if chosen is None:
        return None
    candidate, pair, sigma, gained = chosen
    return NextTest(candidate, pair, sigma, entropy_fall(forecast, gained, p))


def entropy_fall(forecast: InformationForecast, gained: FloatArray, probability: FloatArray) -> float:
    """Return the expected fall of the entropy of the set [bit], by draws of what data of this information may show."""
    size, vectors = np.linalg.eigh(gained)
    kept = size > 1e-6 * max(float(size[-1]), 1e-12)
    basis = vectors[:, kept]
    mean = forecast.mean @ basis
    factor = [
        np.linalg.cholesky(basis.T @ c @ basis + np.diag(1.0 / size[kept])) for c in forecast.covariance
    ]
    p = probability / probability.sum()
    rng = np.random.default_rng(np.random.SeedSequence(0))
    truth = rng.choice(len(p), size=DRAWS, p=p)
    noise = rng.normal(size=(DRAWS, int(kept.sum())))
    data = np.array([mean[i] + factor[i] @ e for i, e in zip(truth, noise, strict=True)])
    logs = np.empty((DRAWS, len(p)))
    for j, lower in enumerate(factor):
        white = np.linalg.solve(lower, (data - mean[j]).T)
        logs[:, j] = np.log(p[j]) - 0.5 * (white**2).sum(axis=0) - np.log(np.diag(lower)).sum()
    after = np.exp(logs - logs.max(axis=1, keepdims=True))
    after /= after.sum(axis=1, keepdims=True)
    return max(_entropy(p) - float(np.mean([_entropy(row) for row in after])), 0.0)


def _entropy(p: FloatArray) -> float:
    return float(-(p * np.log2(np.maximum(p, 1e-300))).sum())
