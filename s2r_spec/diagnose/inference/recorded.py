"""Experiments of the real machine beside the simulator: the difference of both, and what scatters in it.

Data: observables of the real runs of each experiment, and of runs of the simulator at some sizes. The variance of their
difference is that of the mean of the real runs and that of the mean of the simulated ones. Instruments and repeated
runs of the machine add to the first (:mod:`.instruments`). Effects may make runs of the simulator scatter more.

Units: sizes in typical sizes. Shapes: K parameters; of each experiment m observables, of which n are used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from s2r_spec.backend import Backend
from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.inference.hierarchical import DEGREES
from s2r_spec.diagnose.inference.instruments import instrument_variance, white_noise
from s2r_spec.diagnose.inference.observation import Observation
from s2r_spec.diagnose.inference.prior import BACKGROUND
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.response import ResponseLibrary, replicates
from s2r_spec.diagnose.simulator.runs import SEED
from s2r_spec.trace import Trace


@dataclass(frozen=True)
class Recorded:
    """The experiments of the real machine beside the simulator.

    Attributes:
        observations: of every experiment, without the errors of sums of responses.
        machine: (n,) variance of the mean of its real runs.
        scatter: (n,) variance of a run of the nominal simulator.
        runs: number of its real runs.
    """

    observations: tuple[Observation, ...]
    machine: tuple[FloatArray, ...]
    scatter: tuple[FloatArray, ...]
    runs: tuple[int, ...]

    @classmethod
    def of(
        cls,
        backend: Backend,
        library: ResponseLibrary,
        runs: Mapping[Experiment, Sequence[Trace]],
    ) -> Recorded:
        """Return those of experiment → real runs, with residuals, that have something to show."""
        every, parts = [], []
        for experiment, traces in runs.items():
            response = library.response(experiment)
            vectors = [response.observables.vector(trace) for trace in traces]
            one = Observation.of(response, vectors, library.dependence)
            whole = [each for each in vectors if np.isfinite(each[response.bins]).all()] or vectors
            if one.parts:
                nominal = experiment.with_residuals(experiment.run(backend, SEED), backend)
                real, simulated = (white_noise(response.observables, each) for each in (traces, [nominal]))
                beyond = {name: np.maximum(own - simulated[name], 0.0) for name, own in real.items()}
                extra = instrument_variance(
                    response.observables, response.nominal, beyond, max(map(len, traces)), nominal
                )
                every.append((one, np.array(whole)[:, one.kept], extra[one.kept]))
                parts.append((_innovations(one, traces), _innovations(one, [nominal])))
        ratios = _replicate_ratios(every)
        for key, ratio in _innovation_ratios(every, parts).items():
            ratios[key] = max(ratios.get(key, 1.0), ratio)
        observations, machine, scatter = [], [], []
        for one, rows, extra in every:
            own = one.response.scatter[one.kept] ** 2
            variance = own + extra
            for name, places in one.parts:
                ratio = ratios[one.response.experiment.protocol, name]
                if name[1] == "innovation":
                    variance[places] = own[places] * ratio + extra[places]
                else:
                    variance[places] *= ratio
            plain = replace(one, law=0.0, form=np.zeros_like(one.form), spread=np.zeros_like(one.spread))
            observations.append(plain)
            scatter.append(own)
            machine.append(variance / len(rows) + (one.variants**2).sum(axis=0) + 1e-12)
        number = tuple(len(rows) for _, rows, _ in every)
        return cls(tuple(observations), tuple(machine), tuple(scatter), number)

    @property
    def background(self) -> list[FloatArray]:
        """The (n,) variance by σ_bg of every parameter, in each experiment."""
        return [background(one) for one in self.observations]

    def near(self, theta: FloatArray, rows: Sequence[FloatArray]) -> list[Observation]:
        """Return the observations, corrected by (R, m) runs of every experiment at (K,) sizes.

        As many runs as the library has of a response have its seeds. All begin with the seeds of the nominal runs.
        """
        found = []
        for one, machine, scatter, real, own in zip(
            self.observations, self.machine, self.scatter, self.runs, rows, strict=True
        ):
            same = len(own) == replicates(one.response.experiment)
            correction = own.mean(axis=0) - (one.response.reference if same else one.response.nominal)
            correction[one.kept] -= one.moved(theta)
            beyond = np.zeros_like(scatter)
            if len(own) > 1:
                beyond = np.nan_to_num(own[:, one.kept].var(axis=0, ddof=1))
                for _, places in one.parts:  # two runs say little about a single observable
                    beyond[places] = 0.5 * (beyond[places] + beyond[places].mean())
                beyond = np.maximum(beyond - scatter, 0.0)
            noise = machine + beyond / real + (scatter + beyond) / len(own)
            found.append(replace(one.corrected(correction, theta), noise=noise))
        return found


def _replicate_ratios(
    every: Sequence[tuple[Observation, FloatArray, FloatArray]],
) -> dict[tuple[str, tuple[str, str]], float]:
    """Return protocol and group → f_g, by which repeated real runs scatter more than simulated ones; at least 1."""
    total: dict[tuple[str, tuple[str, str]], float] = {}
    free: dict[tuple[str, tuple[str, str]], float] = {}
    for one, vectors, extra in every:
        for (group, places), size in zip(one.parts, one.effective.tolist(), strict=True):
            name = one.response.experiment.protocol, group
            total.setdefault(name, DEGREES)
            free.setdefault(name, DEGREES)
            if len(vectors) > 1:
                variance = one.response.scatter[one.kept][places] ** 2 + extra[places] + 1e-12
                ratio = vectors[:, places].var(axis=0, ddof=1) / variance
                if np.isfinite(ratio).any():
                    number = (len(vectors) - 1) * size
                    total[name] += number * float(np.nanmean(ratio))
                    free[name] += number
    return {name: max(value / free[name], 1.0) for name, value in total.items()}


def _innovations(one: Observation, traces: Sequence[Trace]) -> dict[str, float]:
    """Return channel → mean variance of its innovations in some traces."""
    each = [one.response.observables.innovation_scatter(trace) for trace in traces]
    names = dict.fromkeys(name for own in each for name in own)
    return {name: float(np.mean([own[name].mean() for own in each if name in own])) for name in names}


def _innovation_ratios(
    every: Sequence[tuple[Observation, FloatArray, FloatArray]],
    means: Sequence[tuple[dict[str, float], dict[str, float]]],
) -> dict[tuple[str, tuple[str, str]], float]:
    """Return protocol and group of innovations → by which they scatter more in real traces; at least 1."""
    total: dict[tuple[str, tuple[str, str]], list[tuple[float, float]]] = {}
    for (one, _, _), (real, simulated) in zip(every, means, strict=True):
        for name in real.keys() & simulated.keys():
            key = one.response.experiment.protocol, (name, "innovation")
            total.setdefault(key, []).append((real[name], simulated[name]))
    sums = {key: np.sum(pairs, axis=0) for key, pairs in total.items()}
    return {key: max(float(own[0] / max(own[1], 1e-12)), 1.0) for key, own in sums.items()}


def background(one: Observation) -> FloatArray:
    """Return (n,) the variance by σ_bg of every parameter."""
    low, high = (one.curves.at(np.full(len(one.curves), end)) for end in (-BACKGROUND, BACKGROUND))
    return np.asarray(((low**2 + high**2) / 2.0)[one.dependence.base < 0].sum(axis=0))
