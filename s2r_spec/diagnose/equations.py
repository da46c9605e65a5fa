"""How much of each effect the equations of motion ask for: a regression of residuals, rollout by rollout.

A simulator whose residuals know the effects that were added to it says of any recorded
motion what each would have explained there, at every instant and without a rollout. The
nominal residual is regressed on all of these at once. What comes out is no estimate to be
believed, for laws differ and noise in a regressor draws it towards nothing; it is a feature
like any other, of which the bank says what every effect makes of it. But two effects that
are the same in the means of a rollout seldom are at every instant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend, HasEffects, HasResiduals
from s2r_spec.errors import BackendError, TraceError
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

SHRINKAGE = 0.1
"""Ridge of the regression, a mean square in the residuals' units: a smaller regressor is hardly asked for."""


@dataclass(frozen=True)
class Probe:
    """One parameter of an effect at one value, and the coordinate of that."""

    effect: str
    parameter: str
    value: float
    coordinate: float

    @property
    def name(self) -> str:
        """Return what the feature is called."""
        return f"{self.effect}.{self.parameter}"


@dataclass(frozen=True)
class Equations:
    """A simulator whose residuals know its effects, and what it is asked about a recorded motion.

    Attributes:
        backend: nominal.
        probes: what its residuals are regressed on.
        units: residual → (columns,) in which it is measured.
    """

    backend: Backend
    probes: Sequence[Probe]
    units: Mapping[str, FloatArray]

    def regressed(self, trace: Trace, params: Mapping[str, float]) -> FloatArray:
        """Return (probes,) coordinates, by ridge regression of nominal residuals; NaN where one of these is missing.

        ``params`` are those of the test, as the backend takes them.
        """
        found = self.regressors(trace, params)
        return np.full(len(self.probes), np.nan) if found is None else _ridge(*found)

    def unexplained(self, trace: Trace, params: Mapping[str, float]) -> float:
        """Return the mean square of the residuals that the regression leaves, in their units; NaN as above."""
        found = self.regressors(trace, params)
        if found is None:
            return float("nan")
        rest, x = found
        return float(np.mean((rest - _ridge(rest, x) @ x) ** 2))

    def left(self, trace: Trace, params: Mapping[str, float]) -> dict[str, FloatArray] | None:
        """Return residual → (columns,) rms of what the regression leaves of it, in its unit; None as below."""
        found = self._blocks(trace, params)
        if found is None:
            return None
        x = _ridge(*_flat(found))
        out = {}
        for name, (bare, taken) in zip(self.units, found, strict=True):
            squares = (bare - np.tensordot(x, taken, 1)) ** 2
            counts = np.isfinite(squares).sum(axis=0)
            out[name] = np.sqrt(np.nansum(squares, axis=0) / np.maximum(counts, 1))
        return out

    def regressors(self, trace: Trace, params: Mapping[str, float]) -> tuple[FloatArray, FloatArray] | None:
        """Return (n,) nominal residuals in their units, and (probes, n) what one coordinate of each takes off them.

        None where a residual cannot be computed, or not at a single instant: an effect that shows in it alone would be
        taken for absent.

        Raises:
            BackendError: with an effect a residual has other instants than without.
        """
        found = self._blocks(trace, params)
        return None if found is None else _flat(found)

    def _blocks(
        self, trace: Trace, params: Mapping[str, float]
    ) -> list[tuple[FloatArray, FloatArray]] | None:
        """Return of every residual (m, columns) itself and (probes, m, columns) what a coordinate takes off it.

        A sample that was not recorded is NaN in all of them.
        """
        try:
            rest = self._residuals({}, trace, params)
            others = [self._residuals({p.effect: {p.parameter: p.value}}, trace, params) for p in self.probes]
        except TraceError:
            return None
        for probe, other in zip(self.probes, others, strict=True):
            if [x.shape for x in other] != [x.shape for x in rest]:
                raise BackendError(
                    f"residuals of the backend {self.backend.name!r} with {probe.effect!r} are at other instants than "
                    f"without; they must be at the same ones, whatever is added"
                )
        coordinates = np.array([p.coordinate for p in self.probes])[:, np.newaxis, np.newaxis]
        blocks = []
        for bare, *with_effect in zip(rest, *others, strict=True):
            taken = (bare - np.array(with_effect).reshape(len(self.probes), *bare.shape)) / coordinates
            recorded = np.isfinite(bare) & np.isfinite(taken).all(axis=0)
            if not recorded.any():
                return None
            blocks.append((np.where(recorded, bare, np.nan), np.where(recorded, taken, np.nan)))
        return blocks

    def _residuals(
        self, values: Mapping[str, Mapping[str, float]], trace: Trace, params: Mapping[str, float]
    ) -> list[FloatArray]:
        """Return every residual (m, columns) of the simulator with these effects, in its units.

        Raises:
            TraceError: one of them is missing.
        """
        assert isinstance(self.backend, HasEffects)
        machine: Backend = self.backend.with_effects(values) if values else self.backend
        assert isinstance(machine, HasResiduals)
        found = machine.residuals(trace, params)
        if missing := [name for name in self.units if name not in found.channels]:
            raise TraceError(f"the residual {missing[0]!r} cannot be computed of this trace")
        return [found[name].reshape(len(found), -1) / unit for name, unit in self.units.items()]


def _flat(blocks: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Return (n,) and (probes, n) of all residuals, of the samples that were recorded."""
    rest, taken = [], []
    for bare, each in blocks:
        recorded = np.isfinite(bare)
        rest.append(bare[recorded])
        taken.append(each[:, recorded])
    return np.concatenate(rest), np.hstack(taken)


def _ridge(rest: FloatArray, x: FloatArray) -> FloatArray:
    """Return (probes,) by how much of each of (probes, n) the (n,) are explained."""
    gram = x @ x.T / rest.size + SHRINKAGE * np.eye(len(x))
    return np.asarray(np.linalg.solve(gram, x @ rest / rest.size), dtype=np.float64)
