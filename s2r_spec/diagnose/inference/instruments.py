"""Noise of the real runs: of the instruments, from their highest frequencies, and from run to run, from replicates.

Data: samples x of a channel, at equal times. Model: x is a smooth motion plus white noise of variance v. The third
difference of a motion that is sampled well is nearly nothing, and that of the noise has the variance 20 v. Estimator:

    v = median (Δ³x)² / (0.455 · 20)            0.455: median of χ² with one degree of freedom

The median leaves out steps and impacts. Only what exceeds the same estimate of a simulated run counts. A mean over n
samples then has the further variance v/n. The ripple, log(scatter + FLOOR), is larger by a known amount, of which the
square counts as variance.

White noise moves innovations by a known amount, of which the square counts as variance. Their scatter follows from each
trace itself (:meth:`..innovations.Innovations.scatter`), in parts of that of a simulated trace.

Where tests were repeated, the variance of the observables exceeds that of the simulator by a factor f ≥ 1, one ratio of
sums over tests for all groups of one kind (:mod:`.kinds`).

Units: those of the observables. Shapes: m observables.
Source: Hall, Kay & Titterington, *Biometrika* 77 (1990) 521 (differences).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.simulator.observables import BINS, FLOOR, WINDOWS, Observables
from s2r_spec.trace import Trace

_THIRD = 20.0 * 0.4549
"""Definition: median of the squared third difference of white noise of variance 1."""


def white_noise(observables: Observables, traces: Sequence[Trace]) -> dict[str, FloatArray]:
    """Return quantity → (columns,) variance of the white noise in a sample, the mean over some traces."""
    found = {}
    for quantity in observables.quantities:
        each = [np.diff(quantity.of(trace), n=3, axis=0) for trace in traces if len(trace) > 3]
        rows = [np.median(x**2, axis=0) / _THIRD for x in each]
        found[quantity.name] = np.nan_to_num(np.mean(rows, axis=0)) if rows else np.zeros(quantity.scale.size)
    return found


def instrument_variance(
    observables: Observables,
    nominal: FloatArray,
    noise: Mapping[str, FloatArray],
    samples: int,
    trace: Trace | None = None,
) -> FloatArray:
    """Return (m,) the variance that noise in the samples adds to the observables of one run.

    Args:
        observables: of the experiment.
        nominal: (m,) observables of a simulated run.
        noise: quantity → (columns,) variance in a sample, beyond that of a simulated run.
        samples: in a run.
        trace: a simulated run, for the innovations.
    """
    variance = np.zeros(nominal.size)
    shift = observables.innovation_shift(trace, noise) if trace is not None else {}
    for group in observables.groups:
        own = noise[group.quantity]
        places = slice(group.start, group.stop)
        each = np.resize(own, group.stop - group.start)
        if group.statistic == "bin":
            variance[places] = each * BINS / samples
        elif group.statistic == "mean":
            variance[places] = each / (samples * np.repeat(np.diff(WINDOWS), own.size))
        elif group.statistic == "ripple":
            scatter = np.maximum(np.exp(nominal[places]) - FLOOR, 0.0)
            variance[places] = (np.log(np.sqrt(scatter**2 + each) + FLOOR) - nominal[places]) ** 2
        elif group.statistic == "innovation" and shift:
            variance[places] = shift[group.quantity] ** 2
    return np.nan_to_num(variance)
