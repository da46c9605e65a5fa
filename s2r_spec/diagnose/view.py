"""Real less nominal as one array of coefficients, and all that a fit to it needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.catalogue import Catalogue
from s2r_spec.diagnose.evidence import believed
from s2r_spec.diagnose.layout import Layout
from s2r_spec.diagnose.models import Surrogate
from s2r_spec.diagnose.signatures import Signatures

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """The data, seen through the functions of a layout.

    Attributes:
        layout: of the real tests.
        surrogate: the bank at these.
        nuisances: (v, q, k) what is no effect's doing.
        data: (q, k) coefficients of real less nominal.
        variance: (q, k) of these, as it is believed.
    """

    layout: Layout
    surrogate: Surrogate
    nuisances: FloatArray
    data: FloatArray
    variance: FloatArray

    @classmethod
    def of(
        cls,
        signatures: Signatures,
        catalogue: Catalogue,
        layout: Layout,
        data: FloatArray,
        machine: FloatArray,
        simulator: FloatArray,
    ) -> View:
        """Set up, from coefficients; the last are (k,) variances of one rollout of the machine and the simulator."""
        return cls(
            layout,
            Surrogate(catalogue, layout.through),
            np.einsum("qm,vmk->vqk", layout.through, signatures.numerics),
            data,
            believed(layout.variance(machine, simulator), layout.level(data)),
        )
