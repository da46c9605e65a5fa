"""ρ of simulated runs, read while their traces are there and kept beside their observables (:mod:`.runs`).

Observables serve every requirement; ρ serves one. So rows of ρ are kept by requirement, and a library that was
simulated for another one runs its single effects once more.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import S2RError
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.runs.compatibility import Interface
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

UNKNOWN = np.array([np.nan, np.nan])
"""Definition: the row of a run without a score."""


@dataclass(frozen=True)
class Score:
    """Reads ρ of one requirement from runs of the tests.

    Attributes:
        spec, requirement: what is required.
        matched: how the backend's parameters become a test of the spec.
    """

    spec: Spec = field(repr=False)
    requirement: str
    matched: Interface = field(repr=False)

    @cached_property
    def key(self) -> str:
        """Name of the requirement in a file of runs."""
        return hashlib.sha256(f"{self.spec.hash} {self.requirement}".encode()).hexdigest()[:16]

    def row(self, trace: Trace, experiment: Experiment) -> FloatArray:
        """Return (2,) ρ of a run, NaN where the spec gives it none, and 1 if it ended early; NaN for a protocol."""
        test = None if experiment.protocol else self.matched.to_spec(experiment.values)
        if test is None:
            return UNKNOWN
        try:
            rho = self.spec.robustness(trace, params=test, only=self.requirement)[self.requirement]
        except S2RError:  # no ρ is declared for an early end, or a sample is missing
            rho = math.nan
        return np.array([rho, float(trace.failure is not None)])
