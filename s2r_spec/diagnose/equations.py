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

    def regressors(self, trace: Trace, params: Mapping[str, float]) -> tuple[FloatArray, FloatArray] | None:
        """Return (n,) nominal residuals in their units, and (probes, n) what one coordinate of each takes off them.

        None where a residual cannot be computed, or not at a single instant: an effect that shows in it alone would be
        taken for absent.

        Raises:
            BackendError: with an effect a residual has other instants than without.
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
        coordinates = np.array([p.coordinate for p in self.probes])[:, np.newaxis]
        blocks = []
        for bare, *with_effect in zip(rest, *others, strict=True):
            own = bare.ravel()
            taken = (own - np.array(with_effect).reshape(len(self.probes), own.size)) / coordinates
            block = np.vstack([own, taken])
            # A sample that was not recorded is left out of all of them.
            blocks.append(block[:, np.isfinite(block).all(axis=0)])
        if any(block.shape[1] == 0 for block in blocks):
            return None
        whole = np.hstack(blocks)
        return whole[0], whole[1:]

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


def _ridge(rest: FloatArray, x: FloatArray) -> FloatArray:
    """Return (probes,) by how much of each of (probes, n) the (n,) are explained."""
    gram = x @ x.T / rest.size + SHRINKAGE * np.eye(len(x))
    return np.asarray(np.linalg.solve(gram, x @ rest / rest.size), dtype=np.float64)
