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
from s2r_spec.errors import TraceError
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

RIDGE = 0.1
"""Mean square, in units of the nominal residual's, by which a regressor must be larger to be asked for."""


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


def regressed(
    trace: Trace,
    backend: Backend,
    params: Mapping[str, float],
    probes: Sequence[Probe],
    units: Mapping[str, FloatArray],
) -> FloatArray:
    """Return (probes,) coordinates, by ridge regression of the nominal residuals; NaN where one of these is missing.

    Args:
        trace: recorded.
        backend: nominal.
        params: of the test, as the backend takes them.
        probes: what is regressed on.
        units: residual → (columns,) in which it is measured.
    """
    found = regressors(trace, backend, params, probes, units)
    if found is None:
        return np.full(len(probes), np.nan)
    rest, x = found
    gram = x @ x.T / rest.size + RIDGE * np.eye(len(x))
    return np.asarray(np.linalg.solve(gram, x @ rest / rest.size), dtype=np.float64)


def regressors(
    trace: Trace,
    backend: Backend,
    params: Mapping[str, float],
    probes: Sequence[Probe],
    units: Mapping[str, FloatArray],
) -> tuple[FloatArray, FloatArray] | None:
    """Return (n,) nominal residuals in their units, and (probes, n) what one coordinate of each takes off them.

    None where a residual cannot be computed; the arguments are those of :func:`regressed`.
    """
    assert isinstance(backend, HasResiduals)
    assert isinstance(backend, HasEffects)
    try:
        rest = _stacked(backend.residuals(trace, params), units)
        others = [
            _stacked(backend.with_effects({p.effect: {p.parameter: p.value}}).residuals(trace, params), units)
            for p in probes
        ]
    except TraceError:
        return None
    return rest, np.array(
        [(rest - other) / p.coordinate for p, other in zip(probes, others, strict=True)]
    ).reshape(len(probes), rest.size)


def _stacked(residuals: Trace, units: Mapping[str, FloatArray]) -> FloatArray:
    """Return (n,): all columns of all residuals.

    Raises:
        TraceError: one of them is missing.
    """
    if missing := [name for name in units if name not in residuals.channels]:
        raise TraceError(f"the residual {missing[0]!r} cannot be computed of this trace")
    columns = [residuals[name].reshape(len(residuals), -1) / unit for name, unit in units.items()]
    return np.asarray(np.nan_to_num(np.concatenate([c.ravel() for c in columns])), dtype=np.float64)
