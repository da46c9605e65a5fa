"""How much of each effect the equations of motion ask for: a regression of residuals, rollout by rollout.

A simulator whose residuals know the effects that were added to it says of any recorded
motion what each would have explained there, at every instant and without a rollout. The
nominal residuals are regressed on all of these at once, each of them believed as far as this
explains it. What comes out is no estimate to be believed, for laws differ and noise in a
regressor draws it towards nothing; it is a feature like any other, of which the bank says
what every effect makes of it. But two effects that are the same in the means of a rollout
seldom are at every instant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend, HasEffects, HasResiduals
from s2r_spec.errors import TraceError
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

SHRINKAGE = 0.1
"""Ridge of the regression, a mean square in the residuals' units: a smaller regressor is hardly asked for."""
ROUNDS = 4
"""Of weighing every residual by what the round before left of it."""


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
        return np.full(len(self.probes), np.nan) if found is None else found.weighed()

    def unexplained(self, trace: Trace, params: Mapping[str, float]) -> float:
        """Return the mean square of the residuals that the regression leaves, in their units; NaN as above."""
        found = self.regressors(trace, params)
        if found is None or not found.rest.size:
            return float("nan")
        return float(np.mean((found.rest - found.weighed() @ found.taken) ** 2))

    def regressors(self, trace: Trace, params: Mapping[str, float]) -> Regression | None:
        """Return what is regressed on what; None where a residual cannot be computed."""
        try:
            rest, of = self._residuals({}, trace, params)
            others = [
                self._residuals({p.effect: {p.parameter: p.value}}, trace, params)[0] for p in self.probes
            ]
        except TraceError:
            return None
        coordinates = np.array([p.coordinate for p in self.probes])
        taken = (rest - np.array(others).reshape(len(others), rest.size)) / coordinates[:, np.newaxis]
        # A sample that was not recorded is left out of all of them.
        there = np.isfinite(rest) & np.isfinite(taken).all(axis=0)
        return Regression(rest[there], taken[:, there], of[there])

    def _residuals(
        self, values: Mapping[str, Mapping[str, float]], trace: Trace, params: Mapping[str, float]
    ) -> tuple[FloatArray, NDArray[np.intp]]:
        """Return (n,) all columns of all residuals of the simulator with these effects, and of which each is.

        Raises:
            TraceError: one of them is missing.
        """
        assert isinstance(self.backend, HasEffects)
        machine: Backend = self.backend.with_effects(values) if values else self.backend
        assert isinstance(machine, HasResiduals)
        found = machine.residuals(trace, params)
        if missing := [name for name in self.units if name not in found.channels]:
            raise TraceError(f"the residual {missing[0]!r} cannot be computed of this trace")
        columns = [(found[name].reshape(len(found), -1) / unit).ravel() for name, unit in self.units.items()]
        return np.concatenate(columns), np.repeat(np.arange(len(columns)), [c.size for c in columns])


@dataclass(frozen=True)
class Regression:
    """Nominal residuals of a motion, and what effects would have explained of them.

    Attributes:
        rest: (n,) residuals, in their units.
        taken: (probes, n) what one coordinate of each takes off them.
        of: (n,) which residual each is of.
    """

    rest: FloatArray
    taken: FloatArray
    of: NDArray[np.intp]

    def weighed(self) -> FloatArray:
        """Return (probes,) by how much of each the residuals are explained.

        A residual of which more than its unit is left, in the mean square, is believed so much less: what is missing
        there is no reason to blame an effect that shows elsewhere.
        """
        if not self.rest.size:
            return np.zeros(len(self.taken))
        kinds = np.unique(self.of)
        share = [self.of == kind for kind in kinds]
        grams = np.array([self.taken[:, mine] @ self.taken[:, mine].T for mine in share])
        towards = np.array([self.taken[:, mine] @ self.rest[mine] for mine in share])
        energy = np.array([self.rest[mine] @ self.rest[mine] for mine in share])
        counts = np.array([mine.sum() for mine in share])
        ridge = SHRINKAGE * self.rest.size * np.eye(len(self.taken))
        weights = np.ones(len(kinds))
        for _ in range(ROUNDS):
            found = np.linalg.solve(np.tensordot(weights, grams, 1) + ridge, weights @ towards)
            left = energy - 2.0 * towards @ found + np.einsum("i,kij,j->k", found, grams, found)
            weights = 1.0 / np.maximum(left / counts, 1.0)
        return np.asarray(found, dtype=np.float64)
