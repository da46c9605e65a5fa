"""The bank in whitened components: what each effect looks like, in units of what is not its doing.

A feature is measured in units of its scatter from run to run, and of a tenth of
what the effects of the catalogue do to it: below that a simulator is not to be
believed. Principal components of all signatures keep what the catalogue can say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.bank import Bank
from s2r_spec.errors import UsageError

FloatArray = NDArray[np.float64]

COMPONENTS = 160
STEPS = 8
"""Points of a line on either side of nominal."""
BELIEVED = 0.1
"""Part of the effects' typical size below which a feature's change is not to be believed."""
LEVEL = 0.03
"""Error of any mean that other numerics and other sensors make, as a part of how much the channel varies."""
RIPPLE = 0.2
"""The same for ripple and spread, as a part of themselves: a machine's noise is never quite the simulator's."""


@dataclass(frozen=True)
class Curve:
    """One line of the catalogue in components.

    Attributes:
        line: of the catalogue.
        coordinates: (g,) distances from nominal, as parts of the typical one; 0 is left out.
        change: (g, m, k) change of the components at the bank's tests; of a line with a base, from what
            its effect does there.
        rho: (g, m) change of ρ.
    """

    line: Line
    coordinates: FloatArray
    change: FloatArray
    rho: FloatArray


@dataclass(frozen=True)
class Signatures:
    """A bank, reduced.

    Attributes:
        bank: where it comes from.
        kept: (1 + p,) which columns are used: those that the real traces have.
        scale: (kept,) units of the columns.
        axes: (k, kept) orthonormal components of columns in these units.
        noise: (k, k) covariance of one nominal rollout.
        curves: one a line.
        interactions: (pairs, pair tests, k).
        numerics: (variants, m, k) change when the same physics is computed otherwise.
    """

    bank: Bank
    kept: NDArray[np.bool_]
    scale: FloatArray
    axes: FloatArray
    noise: FloatArray
    curves: tuple[Curve, ...]
    interactions: FloatArray
    numerics: FloatArray

    @classmethod
    def of(
        cls, bank: Bank, available: NDArray[np.bool_] | None = None, asked_error: float = LEVEL
    ) -> Signatures:
        """Reduce a bank to the columns that are finite there and, if given, available in the data.

        ``asked_error`` is that of a coordinate which the equations of motion ask for.
        """
        from sklearn.covariance import ledoit_wolf

        kept = np.array(np.isfinite(bank.nominal).all(axis=(0, 1)), dtype=np.bool_)
        if available is not None:
            kept = kept & available
        nominal = bank.nominal[..., kept]
        scatter = (nominal - nominal.mean(axis=1)[:, None]).reshape(-1, kept.sum())
        free = max(nominal.shape[1] - 1, 1) / nominal.shape[1]
        changes = _relative(
            bank.lines,
            [_filled(line, change[..., kept]) for line, change in zip(bank.lines, bank.changes, strict=True)],
        )
        typical = np.sqrt(
            np.mean(
                [
                    (_at(line, change, line.coordinate(line.at_typical())) ** 2).mean(axis=0)
                    for line, change in zip(bank.lines, changes, strict=True)
                ],
                axis=0,
            )
        )
        sd = np.sqrt((scatter**2).mean(axis=0) / free)
        scale = np.sqrt(sd**2 + (BELIEVED * typical) ** 2 + _doubt(bank, asked_error)[kept] ** 2)
        # What neither scatters nor changes says nothing; it is left out by an infinite unit.
        scale = np.where(scale > 1e-12, scale, np.inf)
        rows = np.concatenate([c.reshape(-1, c.shape[-1]) / scale for c in changes])
        size = np.linalg.norm(rows, axis=1, keepdims=True)
        if not (size > 1e-9).any():
            raise UsageError(
                "no effect of the catalogue changes a recorded channel of these rollouts, so no cause can be found"
            )
        rows = rows[size[:, 0] > 1e-9] / np.maximum(size[size[:, 0] > 1e-9], 1.0) ** 0.75
        _, strength, right = np.linalg.svd(rows, full_matrices=False)
        count = min(COMPONENTS, int((strength > 1e-6 * strength[0]).sum()))
        axes = right[:count]
        noise, _ = ledoit_wolf(scatter / scale @ axes.T, assume_centered=True)
        curves = tuple(
            _curve(line, change, scale, axes) for line, change in zip(bank.lines, changes, strict=True)
        )
        interactions = np.nan_to_num(bank.interactions[..., kept]) / scale @ axes.T
        numerics = np.nan_to_num(bank.variants[..., kept]) / scale @ axes.T
        return cls(bank, kept, scale, axes, noise / free, curves, interactions, numerics)

    @property
    def size(self) -> int:
        """Number of components."""
        return len(self.axes)

    def components(self, rows: FloatArray, nominal: FloatArray) -> FloatArray:
        """Return (n, k) of rows (n, 1 + p), less the nominal (n, kept); what is missing counts as nominal."""
        difference = (rows[:, self.kept] - nominal) / self.scale
        found: FloatArray = np.nan_to_num(difference) @ self.axes.T
        return found


def _doubt(bank: Bank, asked_error: float) -> FloatArray:
    """Return (1 + p,) by how much each column may be off with nothing of the catalogue to blame."""
    names = bank.features.names()
    mean = bank.nominal[..., 1:].mean(axis=(0, 1))
    varies = {
        (f.block, f.column): float(np.exp(value))
        for f, value in zip(names, mean, strict=True)
        if f.statistic == "spread"
    }
    out = [0.0]
    for f, usual in zip(names, mean, strict=True):
        if f.statistic in ("survived", "equation"):
            out.append(LEVEL if f.statistic == "survived" else asked_error)
            continue
        reference = LEVEL * bank.features.referred(f)
        own = LEVEL * varies[f.block, f.column]
        if f.statistic in ("ripple", "spread"):
            # A difference that is nothing in the simulator is something in any machine.
            out.append(RIPPLE + float(np.log1p(reference / np.exp(usual))))
        elif f.statistic.startswith("times"):
            out.append(max(LEVEL, own, reference))
        else:
            out.append(max(own, reference))
    return np.array(out)


def _filled(line: Line, change: FloatArray) -> FloatArray:
    """Fill what a fall left open with the change at the next value towards nominal."""
    filled = change.copy()
    far = np.array(line.values) - line.nominal
    for sign in (-1, 1):
        before = np.zeros_like(change[0])
        for place in sorted(np.flatnonzero(far * sign > 0), key=lambda i: abs(far[i])):
            missing = ~np.isfinite(filled[place])
            filled[place][missing] = before[missing]
            before = filled[place]
    return filled


def _relative(found: tuple[Line, ...], changes: list[FloatArray]) -> list[FloatArray]:
    """Of lines that only say how an effect acts, return the change per unit of that effect.

    They were simulated with it at its typical size, which has a sign: what it does by itself is taken off.
    """
    out = []
    for line, change in zip(found, changes, strict=True):
        if line.base:
            first = next(i for i, other in enumerate(found) if other.effect == line.effect)
            held = found[first].coordinate(line.base[found[first].parameter])
            change = (change - _at(found[first], changes[first], held)) / held
        out.append(change)
    return out


def _knots(line: Line, change: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return coordinates and changes with the nominal one among them, rising."""
    at = np.array([line.coordinate(v) for v in line.values] + [0.0])
    values = np.concatenate([change, np.zeros_like(change[:1])])
    order = np.argsort(at)
    return at[order], values[order]


def _at(line: Line, change: FloatArray, coordinates: float | FloatArray) -> FloatArray:
    """Interpolate monotonically along the line."""
    from scipy.interpolate import PchipInterpolator

    at, values = _knots(line, change)
    found: FloatArray = PchipInterpolator(at, values, axis=0)(coordinates)
    return found


def _curve(line: Line, change: FloatArray, scale: FloatArray, axes: FloatArray) -> Curve:
    ends = [line.coordinate(line.values[0]), line.coordinate(line.values[-1])]
    coordinates = np.concatenate(
        [end * (np.arange(1, STEPS + 1) / STEPS) ** 1.5 for end in ends if end != 0 and _outermost(end, ends)]
    )
    rho = _at(line, change[..., 0], coordinates)
    return Curve(line, coordinates, _at(line, change / scale @ axes.T, coordinates), rho)


def _outermost(end: float, ends: list[float]) -> bool:
    """Whether a line's end is the furthest on its side of nominal."""
    return abs(end) == max(abs(e) for e in ends if np.sign(e) == np.sign(end))
