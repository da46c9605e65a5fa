"""The next experiment: the one that best separates the most probable sets of effects.

Data: the posterior over sets (:mod:`..inference.model_search`) and the response library. Unknown: the experiment whose
run says most about the set. Criterion, by the distances D_ij of :mod:`.identifiability`:

    Σ_{i<j} p_i p_j min(D²_ij, 25) / cost          (Box & Hill, without their term for the sizes)

A design that is chosen under a wrong model gets stuck, so a campaign runs a screen of all experiments before.

Units: D in standard deviations per run, cost in seconds.
Source: Box & Hill, *Technometrics* 9 (1967) 57.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from s2r_spec.base.json_values import DIGITS, Shown
from s2r_spec.diagnose.experiment_design.identifiability import Candidate, InformationForecast

ENOUGH = 25.0
"""Level: D² beyond which two sets are separated. Higher, pairs that any run separates count more."""
LEAST = 1.0
"""Level: distance of two sets below which no run is worth its cost, in standard deviations."""


@dataclass(frozen=True)
class NextTest(Shown):
    """The experiment to run next.

    Attributes:
        candidate: the experiment.
        protocol: the name of the protocol; "" for a test of the specification.
        params: its parameters.
        separates: the two sets of effects that it separates.
        sigma: their distance in standard deviations per run.
    """

    candidate: Candidate
    separates: tuple[tuple[str, ...], tuple[str, ...]]
    sigma: float = field(metadata={DIGITS: 2})

    JSON = "protocol=candidate.shown.protocol params=candidate.shown.values separates sigma"


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
        distance = forecast.apart(forecast.gained(one))
        gains = weight * np.minimum(distance**2, ENOUGH)
        worth = 0.5 * float(gains.sum()) / one.cost
        first, second = sorted(divmod(int(gains.argmax()), len(p)))
        if worth > best and distance[first, second] >= LEAST:
            pair = forecast.names[first], forecast.names[second]
            best, chosen = worth, NextTest(one, pair, float(distance[first, second]))
    return chosen
