"""What is left in one cell, in words and numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from s2r_spec.attribution.place import Place, Range
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
        times: from when until when the channel is in the cell [s]; None for all the time, or for a cell of time.
        extent: lowest and highest value of the channel, in its unit; None if it is not known, or for a cell of time.
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
    times: tuple[float, float] | None = None
    extent: tuple[float, float] | None = None

    @property
    def material(self) -> bool:
        """Whether it is more than what is allowed for."""
        return self.surplus > 1.0

    @property
    def place(self) -> Place:
        """Where it is: in a window of time, or at values of a channel."""
        if not self.along:
            return Place(Range(self.low, self.high), self.part)
        time = None if self.times is None else Range(*self.times)
        lowest, highest = self.extent or (-math.inf, math.inf)
        return Place(
            time,
            self.part,
            values=(Range(self.low, self.high, self.along_unit, self.along, lowest, highest),),
        )

    def __str__(self) -> str:
        """Return it in words."""
        what = f"{f'{self.size:+.3g}'.replace('-', '−')} {spelled(self.unit)}".strip()
        what = f"a difference of {what} in {self.quantity}" if self.recorded else f"{what} of {self.quantity}"
        return f"{what} {self.place}"

    def to_json(self) -> dict[str, Any]:
        """Return the fields; None for an end that is nowhere."""
        ends = {
            name: value if math.isfinite(value) else None
            for name, value in (("low", self.low), ("high", self.high))
        }
        pairs = {
            name: None if (pair := getattr(self, name)) is None else list(pair)
            for name in ("times", "extent")
        }
        return dict(vars(self)) | ends | pairs
