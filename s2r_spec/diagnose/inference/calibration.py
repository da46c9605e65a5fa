"""Response curves from noisy points: what they show beyond the scatter of their runs.

Data: the response v_p (n_g,) of a group to one parameter at P sizes θ_p, each with the variance n_p of its mean. Model:

    v_p = β θ_p + γ_p + e_p,   e_p ~ N(0, n_p)

Estimator: β is the weighted least-squares line, and γ_p the rest. Both are multiplied by the part of their energy that
is no noise, which is positive-part James–Stein:

    F(θ_p) = a β̂ θ_p + b (v_p − β̂ θ_p),   a, b = max(0, 1 − Σ variance/Σ square)

A fit to a noisy response finds too small a size, and is too sure of it; with F the size is right on average. Where runs
scatter much, as in a gait that is chaotic, the response becomes a straight line through all points. Where they do not,
it goes through every point. The variance of F(θ_p) is that of the line times a, and that of the rest times b.

Units: those of the observables; energies of a group in units of scatter. Shapes: n observables, P points.
Source: Efron & Morris, *JASA* 68 (1973) 117; Carroll et al., *Measurement Error in Nonlinear Models* (2006), ch. 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.simulator.curve import Curves, ResponseCurve, Turn
from s2r_spec.diagnose.simulator.observables import NEGLIGIBLE
from s2r_spec.diagnose.simulator.response import Response

LEAST = 1e-12
"""Tolerance: least variance of a point, in units of scatter, so that a weight is finite."""


def calibrated_curves(
    response: Response,
    curves: Sequence[ResponseCurve],
    used: NDArray[np.int64],
    parts: Sequence[tuple[tuple[str, str], NDArray[np.int64]]],
) -> tuple[Curves, FloatArray]:
    """Return the responses in the (n,) observables that are used, by groups, without the scatter of their runs.

    Also returns (curves, n) the variance that this scatter leaves in each, for a coordinate of 1.
    """
    unit = np.sqrt(response.scatter[used] ** 2 + NEGLIGIBLE**2)
    found, left = [], np.zeros((len(curves), used.size))
    for curve, rest in zip(curves, left, strict=True):
        acts = curve.coordinates != 0.0
        at, values = curve.coordinates[acts], curve.values[:, used].copy()
        noise = np.broadcast_to(curve.noise, curve.values.shape)[:, used]
        moved = values[acts]
        for _, places in parts:
            group, variance = moved[:, places] / unit[places], noise[acts][:, places] / unit[places] ** 2
            if isinstance(curve, Turn):
                group = share_of_signal(group, variance) * group
            elif at.size:
                group, variance = straightened(at, group, variance)
            moved[:, places] = unit[places] * group
            rest[places] = unit[places] ** 2 * variance.sum(axis=0) / max(float(at @ at), LEAST)
        values[acts] = moved
        found.append(replace(curve, values=values, noise=noise))
    return Curves(found), left


def straightened(at: FloatArray, values: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (P, n_g) F at (P,) sizes and its variance, from (P, n_g) values of a variance, in units of scatter."""
    weight = 1.0 / np.maximum(variance.mean(axis=1), LEAST)
    gain = weight * at / (weight @ at**2)
    line, line_variance = np.outer(at, gain @ values), np.outer(at**2, gain**2 @ variance)
    # Of a point that the line goes through it is 0, but for rounding.
    rest_variance = np.maximum(variance * (1.0 - 2.0 * at * gain)[:, None] + line_variance, 0.0)
    rest = values - line
    a = share_of_signal(line, line_variance)
    b = share_of_signal(rest, rest_variance)
    return a * line + b * rest, a * line_variance + b * rest_variance


def share_of_signal(measured: FloatArray, variance: FloatArray) -> float:
    """Return the part of the energy of a measured response that is not noise of this variance."""
    energy = float((measured**2).sum())
    return max(0.0, 1.0 - float(variance.sum()) / energy) if energy > 0.0 else 1.0
