"""How much of each effect the equations of motion ask for: a regression of residuals, rollout by rollout.

A simulator whose residuals know the effects that were added to it says of any recorded
motion what each would have explained there, at every instant and without a rollout. The
nominal residual is regressed on all of these at once. What comes out is no estimate to be
believed, for laws differ; it is a feature like any other, of which the bank says what every
effect makes of it. But two effects that are the same in the means of a rollout seldom are at
every instant.

In a closed loop regressors are of the same noise as what is regressed on them: least squares
finds less mass and less motor gain on every machine, for without both there would be no
residual at all. Where nominal rollouts of one test, of other random numbers, hold most of each
other's regressors, they serve the machine's as instruments: two-stage least squares is nearly
free of that (A. Janot, P.-O. Vandanjon, M. Gautier, "A generic instrumental variable approach for
industrial robot identification", IEEE Trans. Control Systems Technology 22(1), 2014). What shows
in no nominal motion, as the friction of feet that do not slide, has no instruments: it is asked
with its own regressor, which is there where a machine's motion has it.

Where effects scale all that a model has, a model without mass and without motors explains every
motion: that is asked for of any machine whose laws are not ours, whatever its causes, and no
instrument helps. With v the coordinates of that model, which a bank finds, and g·v = 1, the
residual r of coordinates x is

    (r − T x) / (1 − g·x) = r − (T − r gᵀ) z,    z = x / (1 − g·x)

and z is what is asked for: for no model at all it would have to be infinite. How much is left of
a machine that is weaker *and* lighter no motion says; what a regression leaves is told as if all
were. A residual that shares effects with others is regressed as it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import cast

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend, HasEffects, HasResiduals
from s2r_spec.errors import BackendError, TraceError
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

SHRINKAGE = 0.1
"""Ridge of the regression, a mean square in the residuals' units: a smaller regressor is hardly asked for."""
LITTLE = 1e-3
"""Ridge of the projection on instruments, the same: there is no probe without one."""


@dataclass(frozen=True)
class Probe:
    """One parameter of an effect at one value, and the coordinate of that.

    Attributes:
        effect: name.
        parameter: of it.
        value: of that.
        coordinate: of the value.
        idle: whether it shows in no nominal motion.
    """

    effect: str
    parameter: str
    value: float
    coordinate: float
    idle: bool = False

    @property
    def name(self) -> str:
        """Return what the feature is called."""
        return f"{self.effect}.{self.parameter}"


@dataclass(frozen=True)
class Instruments:
    """Regressors of the nominal simulator at one test, of random numbers that no machine's rollout has.

    Attributes:
        times: (m,) since the rollout began [s].
        taken: (probes, m, columns) of every residual, in the order of its units.
        none: (probes,) of which there are none, for no nominal motion shows them.
    """

    times: FloatArray
    taken: tuple[FloatArray, ...]
    none: NDArray[np.bool_]

    def at(self, times: FloatArray) -> tuple[FloatArray, ...]:
        """Return ``taken`` at other times; NaN before the first and after the last."""
        if np.array_equal(times, self.times):
            return self.taken
        # A sample's own time must not fall out by a rounding.
        slack = 0.5 * (self.times[-1] - self.times[0]) / max(len(self.times) - 1, 1)
        inside = (times >= self.times[0] - slack) & (times <= self.times[-1] + slack)
        return tuple(
            np.where(inside[:, np.newaxis], _interpolated(times, self.times, each), np.nan)
            for each in self.taken
        )

    @property
    def weight(self) -> FloatArray:
        """Return (probes, probes) by which coordinates at this test count beside those at others."""
        whole = np.concatenate([each.reshape(len(each), -1) for each in self.taken], axis=1)
        recorded = whole[:, np.isfinite(whole).all(axis=0)]
        gram: FloatArray = recorded @ recorded.T / max(recorded.shape[1], 1)
        return gram + SHRINKAGE * np.eye(len(whole))


@dataclass(frozen=True)
class Equations:
    """A simulator whose residuals know its effects, and what it is asked about a recorded motion.

    Attributes:
        backend: nominal.
        probes: what its residuals are regressed on.
        units: residual → (columns,) in which it is measured.
        voids: residual → g (probes,), of those that no model at all would explain.
    """

    backend: Backend
    probes: Sequence[Probe]
    units: Mapping[str, FloatArray]
    voids: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def regressed(
        self, trace: Trace, params: Mapping[str, float], instruments: Instruments | None = None
    ) -> FloatArray:
        """Return (probes,) coordinates, by ridge regression of nominal residuals; NaN where one of these is missing.

        Args:
            trace: of any machine.
            params: of the test, as the backend takes them.
            instruments: at that test; None for least squares.
        """
        found = self._columns(trace, params, instruments)
        return np.full(len(self.probes), np.nan) if found is None else found.coordinates

    def unexplained(
        self, trace: Trace, params: Mapping[str, float], instruments: Instruments | None = None
    ) -> float:
        """Return the mean square of the residuals that the regression leaves, in their units; NaN as above."""
        found = self._columns(trace, params, instruments)
        if found is None:
            return float("nan")
        return float(np.mean((found.rest - found.coordinates @ found.taken) ** 2))

    def left(self, trace: Trace, params: Mapping[str, float]) -> dict[str, FloatArray] | None:
        """Return residual → (columns,) rms of what least squares leaves of it, in its unit; None as below."""
        found = self.motion(trace, params)
        if found is None:
            return None
        x = _flat(found).coordinates
        out = {}
        for name, bare, taken in zip(self.units, found.rest, found.taken, strict=True):
            squares = (bare - np.tensordot(x, taken, 1)) ** 2
            counts = np.isfinite(squares).sum(axis=0)
            out[name] = np.sqrt(np.nansum(squares, axis=0) / np.maximum(counts, 1))
        return out

    def regressors(self, trace: Trace, params: Mapping[str, float]) -> tuple[FloatArray, FloatArray] | None:
        """Return (n,) nominal residuals in their units, and (probes, n) what one coordinate of each takes off them.

        None, and raises, as :meth:`motion`.
        """
        found = self._columns(trace, params, None)
        return None if found is None else (found.rest, found.taken)

    def instruments(self, traces: Sequence[Trace], params: Mapping[str, float]) -> Instruments | None:
        """Return the mean regressors of nominal rollouts of one test, as far as all of them go; None as above."""
        found = [self.motion(trace, params) for trace in traces]
        blocks = [each for each in found if each is not None]
        if not blocks or len(blocks) < len(found):
            return None
        times = blocks[0].times
        none = np.array([probe.idle for probe in self.probes])
        each = [Instruments(block.times, block.taken, none).at(times) for block in blocks]
        return Instruments(times, tuple(np.mean(of, axis=0) for of in zip(*each, strict=True)), none)

    def strength(
        self, trace: Trace, params: Mapping[str, float], instruments: Instruments
    ) -> tuple[FloatArray, FloatArray]:
        """Return (probes,) mean squares of the regressors, and of what instruments hold of them."""
        found = self._columns(trace, params, instruments)
        if found is None:
            nothing = np.zeros(len(self.probes))
            return nothing, nothing
        return (found.taken**2).mean(axis=1), (found.held**2).mean(axis=1)

    def _columns(
        self, trace: Trace, params: Mapping[str, float], instruments: Instruments | None
    ) -> _Columns | None:
        found = self.motion(trace, params)
        if found is None:
            return None
        columns = _flat(found, instruments)
        return columns if columns.rest.size else None

    def motion(self, trace: Trace, params: Mapping[str, float]) -> Motion | None:
        """Return every residual, and what a coordinate of each effect takes off it.

        None where a residual cannot be computed, or not at a single instant: an effect that shows in it alone would be
        taken for absent.

        Raises:
            BackendError: with an effect a residual has other instants than without.
        """
        try:
            times, rest = self._residuals({}, trace, params)
            others = [
                self._residuals({p.effect: {p.parameter: p.value}}, trace, params)[1] for p in self.probes
            ]
        except TraceError:
            return None
        for probe, other in zip(self.probes, others, strict=True):
            if [x.shape for x in other] != [x.shape for x in rest]:
                raise BackendError(
                    f"the residuals of backend {self.backend.name!r} with the effect {probe.effect!r} have other "
                    f"instants than without it; an effect must not change the instants"
                )
        coordinates = np.array([p.coordinate for p in self.probes])[:, np.newaxis, np.newaxis]
        bares, takens = [], []
        for name, bare, *with_effect in zip(self.units, rest, *others, strict=True):
            taken = (bare - np.array(with_effect).reshape(len(self.probes), *bare.shape)) / coordinates
            if name in self.voids:
                taken = taken - np.multiply.outer(np.asarray(self.voids[name]), bare)
            recorded = np.isfinite(bare) & np.isfinite(taken).all(axis=0)
            if not recorded.any():
                return None
            whole = bool(recorded.all())
            bares.append(bare if whole else np.where(recorded, bare, np.nan))
            takens.append(taken if whole else np.where(recorded, taken, np.nan))
        return Motion(times - trace.times[0], tuple(bares), tuple(takens))

    def _residuals(
        self, values: Mapping[str, Mapping[str, float]], trace: Trace, params: Mapping[str, float]
    ) -> tuple[FloatArray, list[FloatArray]]:
        """Return (m,) times and every residual (m, columns) of the simulator with these effects, in its units.

        Raises:
            TraceError: one of them is missing.
        """
        # Not asserted: this is asked some ten thousand times, and to look whether a class has methods takes a while.
        machine = cast(HasEffects, self.backend).with_effects(values) if values else self.backend
        found = cast(HasResiduals, machine).residuals(trace, params)
        if missing := [name for name in self.units if name not in found.channels]:
            raise TraceError(f"the residual {missing[0]!r} cannot be computed from this trace")
        return found.times, [found[name].reshape(len(found), -1) / unit for name, unit in self.units.items()]


@dataclass(frozen=True)
class Motion:
    """A recorded motion, in residuals; a sample that was not recorded is NaN in all of them.

    Attributes:
        times: (m,) since the motion began [s].
        rest: (m, columns) of every residual.
        taken: (probes, m, columns) of every residual: what a coordinate takes off it, as far as that shows in z.
    """

    times: FloatArray
    rest: tuple[FloatArray, ...]
    taken: tuple[FloatArray, ...]

    def asked(self, instruments: Instruments | None) -> tuple[FloatArray, FloatArray]:
        """Return (probes,) coordinates, and (probes, probes) by which these count beside those of other rollouts."""
        columns = _flat(self, instruments)
        if not columns.rest.size:
            nothing = np.full(len(columns.taken), np.nan)
            return nothing, np.full((len(nothing), len(nothing)), np.nan)
        return columns.coordinates, columns.gram if instruments is None else instruments.weight


@dataclass(frozen=True)
class _Columns:
    """The same in one row: (n,) residuals, (probes, n) what is taken off them, and what instruments hold of that."""

    rest: FloatArray
    taken: FloatArray
    held: FloatArray

    @property
    def coordinates(self) -> FloatArray:
        """Return (probes,) by how much of each the residuals are explained."""
        return np.asarray(
            np.linalg.solve(self.gram, self.held @ self.rest / self.rest.size), dtype=np.float64
        )

    @property
    def gram(self) -> FloatArray:
        """Return (probes, probes) mean products of what instruments hold, and the ridge."""
        found: FloatArray = self.held @ self.held.T / self.rest.size + SHRINKAGE * np.eye(len(self.held))
        return found


def _flat(blocks: Motion, instruments: Instruments | None = None) -> _Columns:
    """Return all residuals of the samples that were recorded, and for which there are instruments."""
    rest, taken, beside = [], [], []
    theirs = blocks.taken if instruments is None else instruments.at(blocks.times)
    for bare, each, by in zip(blocks.rest, blocks.taken, theirs, strict=True):
        recorded = np.isfinite(bare)
        if by is not each:
            recorded &= np.isfinite(by).all(axis=0)
        rest.append(bare[recorded])
        taken.append(_chosen(recorded, each))
        beside.append(taken[-1] if by is each else _chosen(recorded, by))
    whole = np.hstack(taken)
    held = whole
    if instruments is not None:
        held = _held(whole, np.where(instruments.none[:, np.newaxis], whole, np.hstack(beside)))
    return _Columns(np.concatenate(rest), whole, held)


def _chosen(recorded: NDArray[np.bool_], values: FloatArray) -> FloatArray:
    """Return (probes, n) of (probes, m, columns) values; where all was recorded nothing is looked up."""
    return values.reshape(len(values), recorded.size) if recorded.all() else values[:, recorded]


def _held(taken: FloatArray, instruments: FloatArray) -> FloatArray:
    """Return (probes, n): the projection of (probes, n) regressors on (probes, n) instruments."""
    n = max(taken.shape[1], 1)
    gram = instruments @ instruments.T / n + LITTLE * np.eye(len(instruments))
    return np.asarray(np.linalg.solve(gram, instruments @ taken.T / n).T @ instruments, dtype=np.float64)


def _interpolated(times: FloatArray, known: FloatArray, values: FloatArray) -> FloatArray:
    """Return (probes, m, columns) at ``times`` of (probes, n, columns) at the ``known`` ones."""
    rows = values.transpose(0, 2, 1).reshape(-1, len(known))
    found = np.array([np.interp(times, known, row) for row in rows])
    return found.reshape(values.shape[0], values.shape[2], len(times)).transpose(0, 2, 1)
