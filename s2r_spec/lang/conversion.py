"""The same quantity in another unit, rounded once: 700 mm are 0.7 m, and 700·0.001 is not.

Data: a number x as people write it, a decimal n/10ᵏ, and a ratio of units. Model: y = (a·x + b)/c with whole a, b
and c. Result: (a·n + b·10ᵏ)/(c·10ᵏ), whose one division rounds, if no term exceeds 2⁵³. Otherwise y is computed from
the double x. An irrational ratio, such as that of degrees and radians, is rounded to a double first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

WHOLE = 2**53
"""Definition: up to here a double holds every whole number."""


@dataclass(frozen=True)
class Conversion:
    """The conversion slope·x + shift of numbers from one unit to another.

    Args:
        slope: size of the first unit in the other one; > 0.
        shift: the zero of the first unit in the other one; not 0 for temperatures alone.
    """

    slope: Fraction = Fraction(1)
    shift: Fraction = Fraction(0)

    @property
    def same(self) -> bool:
        """Whether every number stays as it is."""
        return self.slope == 1 and self.shift == 0

    @cached_property
    def factor(self) -> float:
        """The slope, rounded."""
        return float(self.slope)

    @cached_property
    def _ratio(self) -> tuple[int, int, int] | None:
        """(a, b, c) of y = (a·x + b)/c; None if a double does not hold them."""
        c = math.lcm(self.slope.denominator, self.shift.denominator)
        ratio = int(self.slope * c), int(self.shift * c), c
        return ratio if max(map(abs, ratio)) <= WHOLE else None

    @cached_property
    def _tens(self) -> tuple[float, ...]:
        """The powers of ten 10ᵏ that a decimal n/10ᵏ may have: one for each k from 0."""
        if self._ratio is None:
            return ()
        _, b, c = self._ratio
        return tuple(10.0**k for k in range(16) if max(abs(b), c) * 10**k <= WHOLE)

    def __call__(self, x: float) -> float:
        """Return a number in the other unit."""
        if self.same:
            return x
        for ten in self._tens:
            assert self._ratio is not None
            a, b, c = self._ratio
            if not abs(x) <= WHOLE / (a * ten):
                break
            n = round(x * ten)
            if n and n / ten == x and abs(top := a * n + b * int(ten)) <= WHOLE:
                return top / (c * int(ten))
        return float(self.plain(x))

    def back(self, y: float) -> float:
        """Return a number of the other unit in the first one."""
        return Conversion(1 / self.slope, -self.shift / self.slope)(y)

    def plain(self, x: Any) -> Any:
        """Return numbers, arrays or tensors in the other unit; whole numbers are rounded once."""
        if self._ratio is None:
            return self.factor * x + float(self.shift)
        a, b, c = self._ratio
        y = x if a == 1 else x * float(a)
        y = y if b == 0 else y + float(b)
        return y if c == 1 else y / float(c)

    def each(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return an array of any shape in the other unit; each number as of a call with it alone."""
        import numpy as np

        if self.same:
            return values
        result = np.asarray(self.plain(values), dtype=np.float64)
        x, at = values.reshape(-1), np.arange(values.size)
        flat = result.reshape(-1)
        for ten in self._tens:
            assert self._ratio is not None
            a, b, c = self._ratio
            near = np.abs(x) <= WHOLE / (a * ten)
            x, at = x[near], at[near]
            if not x.size:
                break
            n = np.rint(x * ten)
            top = a * n + b * ten
            exact = (n / ten == x) & (n != 0) & (np.abs(top) <= WHOLE)
            flat[at[exact]] = top[exact] / (c * ten)
            x, at = x[~exact], at[~exact]
        return flat.reshape(values.shape)
