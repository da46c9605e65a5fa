"""What is left in one cell, in words and numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from s2r_spec.printable import spelled


@dataclass(frozen=True)
class Remainder:
    """What is left in one cell.

    Attributes:
        quantity: of which: a residual, or a channel.
        column: of it.
        part: of the machine that the column is of, where the quantity is of several; else "".
        along: channel whose values bound the cell; "" for time.
        low: where the cell begins, in the channel's unit [or s]; -inf if nowhere.
        high: where it ends.
        size: mean of what is left, in the quantity's unit.
        unit: of the quantity.
        along_unit: of the channel, or of time.
        surplus: size in units of what is allowed for.
        recorded: whether the quantity is a channel, and what is left a difference from the simulator's.
    """

    quantity: str
    column: int
    part: str
    along: str
    low: float
    high: float
    size: float
    unit: str
    along_unit: str
    surplus: float
    recorded: bool = False

    @property
    def material(self) -> bool:
        """Whether it is more than what is allowed for."""
        return self.surplus > 1.0

    def __str__(self) -> str:
        """Return it in words."""
        what = f"{_minus(f'{self.size:+.3g}')} {spelled(self.unit)}".strip()
        what = f"a difference of {what} in {self.quantity}" if self.recorded else f"{what} of {self.quantity}"
        what += f" at {self.part}" if self.part else ""
        low, high = map(_minus, _apart(self.low, self.high))
        ends = f"{low} and {high} {spelled(self.along_unit)}".strip()
        if not self.along:
            return f"{what} between {ends}"
        if np.isinf(self.low):
            return f"{what} where {self.along} is below {_minus(f'{self.high:.3g}')} {spelled(self.along_unit)}".strip()
        if np.isinf(self.high):
            return f"{what} where {self.along} is above {_minus(f'{self.low:.3g}')} {spelled(self.along_unit)}".strip()
        return f"{what} where {self.along} is between {ends}"

    def to_json(self) -> dict[str, Any]:
        """Return the fields; None for an end that is nowhere."""
        ends = {
            name: value if np.isfinite(value) else None
            for name, value in (("low", self.low), ("high", self.high))
        }
        return dict(vars(self)) | ends


def _minus(number: str) -> str:
    """Return a number with a minus sign in place of a leading hyphen."""
    return "−" + number[1:] if number.startswith("-") else number


def _apart(low: float, high: float) -> tuple[str, str]:
    """Return two numbers with as many digits as it takes to see that they are two."""
    for digits in range(3, 8):
        told = f"{low:.{digits}g}", f"{high:.{digits}g}"
        if told[0] != told[1]:
            break
    return told
