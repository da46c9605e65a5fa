"""The sizes at which the response to a parameter is simulated, and which parameters need more of them.

Every parameter has a first point on either side, at its typical size. Its response is then a straight line on a side of
the range. That is wrong in two cases, in which a parameter has all points:

- A smaller point lies far from this line, as for a limit, whose effect begins only at some size, or a delay by a part
  of a sample. This is tried in the one experiment that shows the parameter best.
- The real machine may lie near or beyond the smallest point, by the first estimate.

Units: coordinates are in typical sizes (:mod:`.axes`). Shapes: K parameters, m observables.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.simulator.axes import EffectAxis
from s2r_spec.diagnose.simulator.curve import ResponseCurve
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.observables import NEGLIGIBLE
from s2r_spec.diagnose.simulator.response import Response, ResponseLibrary

POINTS = (0.3, 1.0, 2.0)
"""Definition: coordinates of a response on either side, as far as the range reaches. An effect with a threshold between
two of them is interpolated; more points cost a run of every experiment each."""
QUARTERS = (-0.5, 0.5, 1.0)
"""Definition: coordinates of the response to an angle that may be any: the quarters of a turn."""
BEND = 0.5
"""Tolerance: an effect is no straight line if its response at a small point differs by this part from one."""
QUANTILE = 3.0
"""Level: a parameter lies nearer to nominal than the smallest point if so many standard deviations of its estimate do;
99.7 % of a normal distribution."""


def points_of(axis: EffectAxis, refined: bool = False) -> tuple[float, ...]:
    """Return the coordinates of a response, rising, without 0: the one nearest to ±1 on either side, or all of them."""
    if axis.is_phase:
        return QUARTERS
    points = set()
    for sign in (-1.0, 1.0):
        reach = max(sign * end for end in axis.ends)
        side = [sign * min(point, reach) for point in POINTS if reach > 1e-9 and point < 1.5 * reach]
        points |= set(side if refined else sorted(side, key=lambda c: abs(abs(c) - 1.0))[:1])
    return tuple(sorted(points))


def to_refine(parameters: Sequence[EffectAxis], mean: FloatArray, deviation: FloatArray) -> frozenset[str]:
    """Return the names of the parameters that need all points, by (K,) mean and (K,) deviation of a first estimate."""
    reach = np.abs(mean) + QUANTILE * deviation
    return frozenset(
        axis.name
        for axis, far in zip(parameters, reach.tolist(), strict=True)
        if far >= min(POINTS) and _has_more(axis)
    )


def all_points(parameters: Sequence[EffectAxis], response: Response) -> frozenset[str]:
    """Return the names of the parameters that have more than the first points in a response."""
    pairs = zip(parameters, response.curves, strict=True)
    return frozenset(axis.name for axis, curve in pairs if curve.coordinates.size - 1 > len(points_of(axis)))


def most_visible(library: ResponseLibrary) -> dict[Experiment, frozenset[str]]:
    """Return experiment → names of the parameters whose response is largest there, beside the scatter of a run."""
    names: dict[Experiment, set[str]] = {}
    for k, axis in enumerate(library.parameters):
        if _has_more(axis):
            best = max(library.responses, key=lambda one: _visible(one, k))
            names.setdefault(best.experiment, set()).add(axis.name)
    return {experiment: frozenset(own) for experiment, own in names.items()}


def curved(tried: ResponseLibrary) -> frozenset[str]:
    """Return the names of the parameters whose response is no straight line, wherever it has all points."""
    return frozenset(
        axis.name
        for one in tried.responses
        for axis, curve in zip(tried.parameters, one.curves, strict=True)
        if not axis.is_phase and is_curved(curve)
    )


def is_curved(curve: ResponseCurve) -> bool:
    """Return whether a small point of a side lies far from the line between nominal and the point nearest to ±1.

    The variances of the values are taken off, and numbers that scatter much count little: one run that falls says
    nothing about small sizes. A curve with one point on either side is a line.
    """
    noise = np.broadcast_to(curve.noise, curve.values.shape)
    for sign in (-1.0, 1.0):
        side = np.flatnonzero(curve.coordinates * sign > 0.0)
        sizes = np.abs(curve.coordinates[side])
        near = side[int(np.argmin(np.abs(sizes - 1.0)))] if side.size else 0
        for small in side[sizes < np.abs(curve.coordinates[near])].tolist():
            part = curve.coordinates[small] / curve.coordinates[near]
            line, on_line = part * curve.values[near], part**2 * noise[near]
            away, beside = curve.values[small] - line, on_line + noise[small]
            weight = 1.0 / (beside + NEGLIGIBLE**2)
            known = np.isfinite(away) & np.isfinite(beside)
            energy = float((weight * (line**2 - on_line))[known].sum())
            if float((weight * (away**2 - beside))[known].sum()) > BEND**2 * max(energy, 0.0):
                return True
    return False


def _has_more(axis: EffectAxis) -> bool:
    return points_of(axis, refined=True) != points_of(axis)


def _visible(response: Response, k: int) -> float:
    """Return the size of a response in units of the scatter of a run, which is not less than what counts as nothing."""
    values = np.nan_to_num(response.curves[k].values)
    noise = np.sqrt(np.nan_to_num(response.scatter) ** 2 + NEGLIGIBLE**2)
    return float(np.sqrt(((values / noise) ** 2).mean()))
