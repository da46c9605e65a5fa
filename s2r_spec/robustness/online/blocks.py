"""ρ at every sample of a trace that arrives in blocks of samples.

Data: the samples from the first one that a formula still reads; the memory is bounded by its windows and by the block.
Model: with a period, ρ at an instant depends on the samples from ``back`` before it to ``ahead`` after it. So every
instant with ``ahead`` samples after it is decided. The operations on whole arrays (:mod:`s2r_spec.robustness.sampled`)
give its ρ, bit for bit, and cost less than a tenth of those on single samples where a block is as long as the windows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.lang import formula as f
from s2r_spec.robustness.grid import Grid
from s2r_spec.robustness.horizon import samples_before, samples_read
from s2r_spec.robustness.numbers import SampledSignals
from s2r_spec.robustness.sampled import walk_samples
from s2r_spec.robustness.ties import restore_zeros

Decided = dict[str, list[tuple[float, float]]]


@dataclass(frozen=True)
class _LaterGrid(Grid):
    """A grid that begins at a later instant of its trace, for the words of errors."""

    first: int = 0

    def place(self, sample: int) -> str:
        """See :class:`Grid`."""
        return super().place(self.first + sample)


def fits(formula: f.Formula, period: Fraction | None) -> bool:
    """Return whether the ρ of a formula depends on a bounded number of samples."""
    return period is not None and math.isfinite(
        samples_before(formula, period) + samples_read(formula, period)
    )


class Blocks:
    """The samples that are still needed, and the instants whose ρ was returned.

    Args:
        formulas: requirement → its formula, each of which :func:`fits`.
        period: sample period [s].
        samples: parameters, and the semantics of until; its signals and clock do not count.
    """

    def __init__(self, formulas: Mapping[str, f.Formula], period: Fraction, samples: SampledSignals) -> None:
        self.formulas, self.period, self.samples = formulas, period, samples
        self.first = self.count = 0
        self.times = np.empty(0)
        self.signals: dict[str, FloatArray] = {}
        self.sent = dict.fromkeys(formulas, 0)

    def take(self, times: FloatArray, signals: Mapping[str, FloatArray]) -> Decided:
        """Take (m,) times [s] and name → (dim, m) samples, and return ρ of the instants that they decide.

        Raises:
            TraceError: a predicate is undefined, which ends the trace.
        """
        self.times = np.concatenate((self.times, times))
        self.signals = {
            name: np.concatenate((self.signals[name], block), axis=1) if self.signals else block
            for name, block in signals.items()
        }
        self.count += times.size
        return self._decided(ended=False)

    def finish(self) -> Decided:
        """Return ρ at the remaining instants, with windows cut at the end of the trace."""
        return self._decided(ended=True)

    def _decided(self, ended: bool) -> Decided:
        if not self.times.size:
            return {name: [] for name in self.formulas}
        grid = _LaterGrid(self.times.size, self.period, first=self.first)
        walk = walk_samples(replace(self.samples, clock=grid, signals=self.signals))
        values: Decided = {}
        for name, formula in self.formulas.items():
            ahead = 0 if ended else int(samples_read(formula, self.period))
            begin = self.sent[name]
            stop = self.sent[name] = max(begin, self.count - ahead)
            part = slice(begin - self.first, stop - self.first)
            rho = restore_zeros(walk(formula)[part])
            values[name] = list(zip(self.times[part].tolist(), rho.tolist(), strict=True))
        self._forget()
        return values

    def _forget(self) -> None:
        """Drop the samples that no instant to come reads."""
        oldest = min(
            self.sent[name] - int(samples_before(formula, self.period))
            for name, formula in self.formulas.items()
        )
        drop = min(max(oldest - self.first, 0), self.times.size)
        self.first += drop
        self.times = self.times[drop:].copy()
        self.signals = {name: rows[:, drop:].copy() for name, rows in self.signals.items()}
