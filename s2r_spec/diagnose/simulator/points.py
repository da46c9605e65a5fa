"""The sizes at which the response to a parameter is simulated, and which parameters need more of them.

Every parameter has a first point on either side, at its typical size. Its response is then a straight line on a side of
the range. That is wrong in two cases, in which a parameter has all points:

- The smallest point lies far from this line, as for a limit, whose effect begins only at some size. This is tried in
  the one experiment that shows the parameter best.
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
from s2r_spec.diagnose.simulator.response import Response, ResponseLibrary, replicates

POINTS = (0.3, 1.0, 2.0)
"""Definition: coordinates of a response on either side, as far as the range reaches. An effect with a threshold between
two of them is interpolated; more points cost a run of every experiment each."""
QUARTERS = (-0.5, 0.5, 1.0)
"""Definition: coordinates of the response to an angle that may be any: the quarters of a turn."""
BEND = 0.5
"""Tolerance: an effect is no straight line if its response at the smallest point differs by this part from one."""
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


def curved(first: ResponseLibrary, tried: ResponseLibrary) -> frozenset[str]:
    """Return the names of the parameters whose response is no straight line, wherever it has all points."""
    return frozenset(
        axis.name
        for one, more in zip(first.responses, tried.responses, strict=True)
        for k, axis in enumerate(first.parameters)
        if not axis.is_phase and is_curved(more.curves[k], *_noise(one, more, k))
    )


def _noise(first: Response, tried: Response, k: int) -> tuple[FloatArray, FloatArray]:
    """Return (m,) the variance of a mean response for a coordinate of 1, at the first points and at all others.

    Variances for a coordinate of 1 are sums over points by sums of squared coordinates, so those of the other points
    follow from both.
    """
    few, many = (float((one.curves[k].coordinates ** 2).sum()) for one in (first, tried))
    near = first.spread[k]
    other = near if many == few else np.maximum(many * tried.spread[k] - few * near, 0.0) / (many - few)
    return near / 2.0, other / replicates(first.experiment)


def is_curved(curve: ResponseCurve, near_noise: FloatArray, other_noise: FloatArray) -> bool:
    """Return whether the smallest point of a side lies far from the line between nominal and the point nearest to ±1.

    The (m,) variances for a coordinate of 1 are taken off. A curve with one point on either side is a line.
    """
    for sign in (-1.0, 1.0):
        side = np.flatnonzero(curve.coordinates * sign > 0.0)
        if side.size < 2:
            continue
        sizes = np.abs(curve.coordinates[side])
        small, near = int(np.argmin(sizes)), int(np.argmin(np.abs(sizes - 1.0)))
        line = curve.values[side[near]] * sizes[small] / sizes[near]
        away = curve.values[side[small]] - line
        on_line, beside = sizes[small] ** 2 * near_noise, sizes[small] ** 2 * (near_noise + other_noise)
        known = np.isfinite(away) & np.isfinite(beside)
        energy = float((line**2 - on_line)[known].sum())
        if float((away**2 - beside)[known].sum()) > BEND**2 * max(energy, 0.0):
            return True
    return False


def _has_more(axis: EffectAxis) -> bool:
    return points_of(axis, refined=True) != points_of(axis)


def _visible(response: Response, k: int) -> float:
    """Return the size of a response in units of the scatter of a run, which is not less than what counts as nothing."""
    values = np.nan_to_num(response.curves[k].values)
    noise = np.sqrt(np.nan_to_num(response.scatter) ** 2 + NEGLIGIBLE**2)
    return float(np.sqrt(((values / noise) ** 2).mean()))
