"""What the simulator does in every experiment: without effects, with each of them, and with several.

A response is a difference of runs with equal seeds: to every parameter at a few coordinates, and to every variant of
the simulator. *Practice machines* are the simulator with random sizes of all effects and a random variant. Their runs
show how well the sum of responses predicts a machine.

A parameter that does nothing while the rest of its effect is nominal, such as the place of a payload, is *dependent*:
its response was simulated with the first parameter of the effect at its typical size, and grows in proportion to it.

Units: parameters are in coordinates, distances from nominal in units of the typical size (see :mod:`.axes`). Shapes: m
observables, K parameters, V variants, M practice machines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.simulator.axes import EffectAxis, Values
from s2r_spec.diagnose.simulator.curve import ResponseCurve
from s2r_spec.diagnose.simulator.experiments import RESIDUAL, Experiment
from s2r_spec.diagnose.simulator.observables import ObservableGroup, Observables
from s2r_spec.diagnose.simulator.score import Score

REPLICATES = {"test": 2, "protocol": 1}
"""Budget: runs of a response. A test's controller has a clock of its own, so that its runs differ more."""


@dataclass(frozen=True)
class Dependence:
    """Which responses are in proportion to another parameter: (K,) that one, or −1, and its coordinate in the runs."""

    base: NDArray[np.int64]
    at: FloatArray

    @classmethod
    def of(cls, parameters: Sequence[EffectAxis]) -> Dependence:
        """Return that of a catalogue's parameters."""
        base, at = np.full(len(parameters), -1), np.ones(len(parameters))
        for k, axis in enumerate(parameters):
            if axis.base:
                base[k] = next(j for j, p in enumerate(parameters) if axis.stands_beside(p))
                at[k] = parameters[base[k]].coordinate(parameters[base[k]].at_typical())
        return cls(base, at)

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """(dependent parameter, its base) of every dependent one."""
        return [(int(k), int(self.base[k])) for k in np.flatnonzero(self.base >= 0)]

    def factors(self, theta: FloatArray) -> FloatArray:
        """Return (K,) what every response is multiplied by at (K,) coordinates."""
        return np.where(self.base >= 0, theta[self.base] / self.at, 1.0)


@dataclass(frozen=True)
class Practice:
    """Runs of random machines: (M, K) coordinates, (M, V) 1 for their variant, and (M, m) observables of a run."""

    theta: FloatArray
    variant: FloatArray
    values: FloatArray


@dataclass(frozen=True, eq=False)
class RobustnessCurve:
    """Mean ρ of the runs with one parameter off nominal, at p sizes.

    Attributes:
        coordinates: (p,) rising, with 0 for nominal.
        rho: (p,) mean over runs with the same seeds at every size; −∞ where a run ended early and has no ρ.
        ended: (p,) whether a run ended early.
    """

    coordinates: FloatArray
    rho: FloatArray
    ended: NDArray[np.bool_]

    @classmethod
    def of(cls, scores: Mapping[float, FloatArray]) -> RobustnessCurve:
        """Return that of coordinate → (runs, 2) scores; a run without ρ that went on to its end shows nothing."""
        known = {}
        for at, rows in scores.items():
            ended = rows[:, 1] > 0.0
            rho = np.where(ended & np.isnan(rows[:, 0]), -np.inf, rows[:, 0])
            if not np.isnan(rho).any():
                known[at] = rho.mean(), ended.any()
        order = sorted(known)
        rho, ended = (np.array([known[at][n] for at in order]) for n in (0, 1))
        return cls(np.array(order), rho.astype(float), ended.astype(bool))


@dataclass(frozen=True, eq=False)
class Response:
    """What the simulator does in one experiment.

    Attributes:
        observables: of its traces.
        nominal, scatter: (m,) mean of the nominal runs, and standard deviation of one run.
        reference: (m,) mean of the nominal runs with the seeds of the responses.
        curves: the response to every parameter.
        spread: (K, m) variance of the response from run to run, for a coordinate of 1; it grows with its square.
        variants: V responses to the simulator's variants, with the whole variant at 1.
        practice: runs of practice machines.
        runs: (R, m) nominal runs, the first seed first; they need not be made again.
        robustness: ρ over every parameter that acts alone, by its place; none without a requirement.
    """

    experiment: Experiment
    observables: Observables
    nominal: FloatArray
    scatter: FloatArray
    reference: FloatArray
    curves: tuple[ResponseCurve, ...]
    spread: FloatArray
    variants: tuple[ResponseCurve, ...]
    practice: Practice
    runs: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    robustness: Mapping[int, RobustnessCurve] = field(default_factory=dict)

    @cached_property
    def calibrated(self) -> dict[tuple[object, ...], Any]:
        """The calibrated observations without data, by the observables and the number of runs of their data."""
        return {}

    def groups_of(self, measured: NDArray[np.bool_]) -> tuple[ObservableGroup, ...]:
        """Return the groups to use of (m,) observables that were measured.

        Where every residual was measured, the channels themselves are left out: they show the same causes through the
        machine's closed loop.
        """
        every = self.observables.groups
        residuals = tuple(g for g in every if g.quantity.startswith(RESIDUAL))
        known = [g for g in residuals if np.isfinite(self.nominal[g.start : g.stop]).any()]
        whole = all(measured[g.start : g.stop].any() for g in known)
        return residuals if residuals and whole else every

    @property
    def bins(self) -> NDArray[np.int64]:
        """Places of the means over parts of the trace; they have values as long as a run lasts."""
        parts = [g for g in self.observables.groups if g.statistic in ("bin", "mean")]
        bins = np.array([place for g in parts for place in range(g.start, g.stop)], dtype=np.int64)
        return bins[np.isfinite(self.nominal[bins])]


def replicates(experiment: Experiment) -> int:
    """Return the number of runs of a response."""
    return REPLICATES["protocol" if experiment.protocol else "test"]


@dataclass(frozen=True)
class ResponseLibrary:
    """Responses of every experiment to every parameter of the catalogue, in its order.

    Attributes:
        score: the requirement of which the tests have ρ; None for none.
    """

    parameters: tuple[EffectAxis, ...]
    responses: tuple[Response, ...]
    score: Score | None = None

    @property
    def experiments(self) -> tuple[Experiment, ...]:
        """The experiments of the responses, in order."""
        return tuple(each.experiment for each in self.responses)

    @cached_property
    def dependence(self) -> Dependence:
        """Which responses are in proportion to another parameter."""
        return Dependence.of(self.parameters)

    def response(self, experiment: Experiment) -> Response:
        """Return the response of an experiment that the library has."""
        return {each.experiment: each for each in self.responses}[experiment]

    @property
    def idle(self) -> list[str]:
        """The effects that change no experiment."""
        acting = {
            axis.effect
            for response in self.responses
            for axis, curve in zip(self.parameters, response.curves, strict=True)
            if np.any(np.nan_to_num(curve.values))
        }
        return [e for e in dict.fromkeys(axis.effect for axis in self.parameters) if e not in acting]

    def values(self, theta: FloatArray) -> dict[str, dict[str, float]]:
        """Return effect → parameter → value at (K,) coordinates, without parameters at nominal."""
        return values_at(self.parameters, theta)

    def coordinates(self, values: Values) -> FloatArray:
        """Return (K,) the coordinates of values; a parameter without a value is nominal."""
        known = [values.get(axis.effect, {}).get(axis.parameter, axis.nominal) for axis in self.parameters]
        return np.array([axis.coordinate(x) for axis, x in zip(self.parameters, known, strict=True)])


def values_at(parameters: Sequence[EffectAxis], theta: FloatArray) -> dict[str, dict[str, float]]:
    """Return effect → parameter → value at (K,) coordinates, without parameters at nominal."""
    values: dict[str, dict[str, float]] = {}
    for axis, coordinate in zip(parameters, theta.tolist(), strict=True):
        if coordinate:
            values.setdefault(axis.effect, {})[axis.parameter] = axis.value(coordinate)
    return values
