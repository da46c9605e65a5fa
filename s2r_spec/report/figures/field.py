"""The data of a band picture: bounds of ρ in simulation, of the gap, or of ρ on the machine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.certify.result.check_result import Tested
from s2r_spec.space import Space

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Field:
    """An expected value over the test space.

    Attributes:
        space: the test space.
        bounds: from (n, dim) points to its (n,) lower and upper bounds, which hold at all points at once.
        tests: the tests that were run.
        mark: the test to mark; slices go through it.
        height: value at the mark [unit].
        pointed: name of the mark, "worst test".
        lower: lower bound of the worst expected value [unit].
        upper: upper bound of the same [unit].
        symbol: "ρ" or "Δ".
        name: "expected robustness".
        unit: the unit of the value.
        title: the title of the picture.
        dots: the meaning of a dot: "means over a test's rollouts".
        remark: one more sentence under the picture, or "".
    """

    space: Space
    bounds: Callable[[FloatArray], tuple[FloatArray, FloatArray]]
    tests: tuple[Tested, ...]
    mark: Mapping[str, float]
    height: float
    pointed: str
    lower: float
    upper: float
    symbol: str
    name: str
    unit: str
    title: str
    dots: str
    remark: str
