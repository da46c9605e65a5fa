"""Times of stance and swing of each foot: a clock-driven trot."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from s2r_sim.controller.gains import RATE, Gains

Progress = tuple[float | None, ...]
"""Swing phase of each leg, in [0, 1), or None in stance."""

OFFSETS = (0.0, 0.5, 0.5, 0.0)
"""Phase offsets of FR, FL, RR, RL, as fractions of the period: diagonal legs move together."""


@dataclass(frozen=True)
class Gait:
    """A clock that counts whole ticks, so that it stays exact in a rollout of any length."""

    period: int
    stance: int

    @classmethod
    def of(cls, gains: Gains) -> Gait:
        """Round the gains' period and duty to ticks."""
        period = round(gains.period * RATE)
        return cls(period, round(gains.duty * period))

    @cached_property
    def stance_time(self) -> float:
        """Duration of a stance [s]."""
        return self.stance / RATE

    @cached_property
    def swing_time(self) -> float:
        """Duration of a swing [s]."""
        return (self.period - self.stance) / RATE

    def progress(self, tick: int) -> Progress:
        """Return each leg's swing phase in [0, 1) at this tick; None in stance."""
        phases = [(tick + round(offset * self.period)) % self.period - self.stance for offset in OFFSETS]
        return tuple(None if phase < 0 else phase / (self.period - self.stance) for phase in phases)
