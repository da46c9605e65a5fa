"""Robustness with a sign everywhere: the truth of a predicate at a margin of 0.

Data: the margin m of a predicate, in its unit. ``x <= c`` and ``x < c`` have the same margin c − x, and at
x = c one is true and the other false. STL is sound, ρ > 0 ⇒ true and ρ < 0 ⇒ false (Fainekos and Pappas,
*Robustness of temporal logic specifications for continuous-time signals*, 2009, Prop. 16), and silent at ρ = 0.

Model: margins are numbers extended by one infinitesimal, TIE. A margin of 0 is written +TIE where the predicate is
true and −TIE where it is false; no margin is 0. Minimum, maximum and negation are and, or and not of the signs, so
the sign of ρ is the Boolean semantics, and |ρ| ≤ TIE is a robustness of 0. A result is given as
:func:`restore_zeros` ρ, with the Boolean ρ > 0 beside it.
"""

from __future__ import annotations

import math

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.lang.formula import CompareOp

TIE = 2.0**-1000
"""Definition: the size of a robustness of 0, in any unit (9.3e-302).

Any positive number below every realistic margin would do, such as twice this one. It is far from the subnormal
numbers, which some libraries flush to 0.
"""


def tie(operator: CompareOp) -> float:
    """Return the robustness of a comparison of equal numbers: ±TIE."""
    return TIE if operator in ("<=", ">=", "==") else -TIE


def break_ties(margin: FloatArray, operator: CompareOp) -> FloatArray:
    """Return margins of any shape with each 0 replaced by ±TIE; the same array if there is no 0."""
    zero = margin == 0.0
    return np.where(zero, tie(operator), margin) if zero.any() else margin


def break_tie(margin: float, operator: CompareOp) -> float:
    """Return :func:`break_ties` of one margin."""
    return tie(operator) if margin == 0.0 else margin


def rescale(rho: FloatArray, factor: float) -> FloatArray:
    """Return factor · ρ, factor > 0, of any shape: a robustness of 0 is 0 in every unit."""
    result = factor * rho
    small = (np.abs(rho) <= TIE) | (np.abs(result) < TIE)
    return np.where(small, np.copysign(TIE, rho), result) if small.any() else result


def rescale_number(rho: float, factor: float) -> float:
    """Return :func:`rescale` of one robustness."""
    result = factor * rho
    return math.copysign(TIE, rho) if abs(rho) <= TIE or abs(result) < TIE else result


def restore_zeros(rho: FloatArray) -> FloatArray:
    """Return ρ of any shape with each ±TIE replaced by 0."""
    zero = np.abs(rho) <= TIE
    return np.where(zero, 0.0, rho) if zero.any() else rho


def restore_zero(rho: float) -> float:
    """Return :func:`restore_zeros` of one robustness."""
    return 0.0 if abs(rho) <= TIE else rho
