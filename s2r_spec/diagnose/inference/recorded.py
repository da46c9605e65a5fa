"""Experiments of the real machine beside the simulator: the difference of both, and what scatters in it.

Data: observables of R_m real runs of each experiment, of R runs of the simulator at some sizes, and of n nominal ones,
the first with the same seeds. Unknown: μ, the simulator's mean at these sizes, and v, the variance of a run there. S is
the nominal mean with the sum of responses; it has the variance v_S = v₀/n + Σ_k θ_k² (that of response k), with v₀ of a
nominal run. Model and estimator:

    μ = S + b D,   D = mean of the R runs − c (mean of the nominal runs of the same seeds − that of all) − S
    v = f · (variance of the R runs, pooled with the nominal variance)
    Var(real mean − μ) = (m + max(v − v₀, 0))/R_m + b² v_1 + (1 − b)² v_S + b (1 − b) v_D
    v_1 = v/R + c² (v₀ − 2 √(v v₀)) (1/R − 1/n),   v_D = v_1 − c² v₀/n + (1 − c)² v₀/n + Σ_k θ_k² (that of response k)

b is the part of the energy of D, in a group, that is no noise of the variance v_D (:mod:`.calibration`). A few runs of
a chaotic gait scatter more than a sum of responses is wrong; then b is 0. Instruments and repeated runs of the machine
add to its variance m (:mod:`.instruments`). An effect may make runs of the simulator scatter more, or less: f is one
number for a kind of group in all tests (:mod:`.kinds`), so the luck of a few runs decides no score. c is the
correlation of two runs of one seed, with an effect and without: a gait that is chaotic forgets its seed. It is the
median over parameters of 1 − spread/(2 nominal variance), at typical sizes.

Units: sizes in typical sizes. Shapes: K parameters; of each experiment m observables, of which n_p are used.
Source: Glasserman, *Monte Carlo Methods in Financial Engineering* (2003), §4.1 (c, a control variate).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from s2r_spec.backend import Backend
from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.inference.calibration import share_of_signal
from s2r_spec.diagnose.inference.independence import independent_numbers
from s2r_spec.diagnose.inference.instruments import instrument_variance, white_noise
from s2r_spec.diagnose.inference.kinds import Kinds
from s2r_spec.diagnose.inference.observation import Observation
from s2r_spec.diagnose.inference.prior import BACKGROUND
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.response import ResponseLibrary
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
        scatters = [one.response.scatter[one.kept] ** 2 for one, _, _ in every]
        ratios = Kinds.of([one for one, _, _ in every]).ratios(
            [rows.var(axis=0, ddof=min(1, len(rows) - 1)) for _, rows, _ in every],
            [own + extra + 1e-12 for own, (_, _, extra) in zip(scatters, every, strict=True)],
            [len(rows) - 1.0 for _, rows, _ in every],
        )
        innovations = _innovation_ratios(every, parts)
        observations, machine, scatter = [], [], []
        sizes = independent_numbers([one for one, _, _ in every])
        for (one, rows, extra), own, ratio, size in zip(every, scatters, ratios, sizes, strict=True):
            variance = (own + extra + 1e-12) * np.maximum(ratio, 1.0)
            for name, places in one.parts:
                if (key := (one.response.experiment.protocol, name)) in innovations:
                    most = max(innovations[key], float(ratio[places].max()))
                    variance[places] = own[places] * most + extra[places]
            plain = replace(
                one,
                law=0.0,
                effective=size,
                form=np.zeros_like(one.form),
                spread=np.zeros_like(one.spread),
            )
            observations.append(plain)
            scatter.append(own)
            machine.append(variance / len(rows) + (one.variants**2).sum(axis=0) + 1e-12)
        number = tuple(len(rows) for _, rows, _ in every)
        return cls(tuple(observations), tuple(machine), tuple(scatter), number)

    def counting(self, numbers: Sequence[FloatArray] | None) -> Recorded:
        """Return them with (G,) other independent numbers of the groups of every experiment; None changes nothing."""
        if numbers is None:
            return self
        pairs = zip(self.observations, numbers, strict=True)
        return replace(self, observations=tuple(replace(one, effective=own) for one, own in pairs))

    @property
    def background(self) -> list[FloatArray]:
        """The (n,) variance by σ_bg of every parameter, in each experiment."""
        return [background(one) for one in self.observations]

    def near(self, theta: FloatArray, rows: Sequence[FloatArray]) -> list[Observation]:
        """Return the observations, corrected by (R, m) runs of every experiment at (K,) sizes.

        They begin with the seeds of the nominal runs.
        """
        kinds, free = self.kinds, [len(own) - 1.0 for own in rows]
        own_variances = [
            own[:, one.kept].var(axis=0, ddof=1) if len(own) > 1 else scatter
            for one, scatter, own in zip(self.observations, self.scatter, rows, strict=True)
        ]
        shapes = [
            np.where(np.isfinite(own), (m * np.nan_to_num(own) + n * scatter) / (m + n), scatter)
            for own, scatter, m, n in zip(
                own_variances, self.scatter, free, self.nominal_degrees, strict=True
            )
        ]
        units = [np.maximum(shape, 1e-24) for shape in shapes]
        ratios = kinds.ratios(
            [own / unit for own, unit in zip(own_variances, units, strict=True)],
            [shape / unit for shape, unit in zip(shapes, units, strict=True)],
            free,
        )
        found = []
        for one, machine, scatter, real, shape, ratio, common, own in zip(
            self.observations, self.machine, self.scatter, self.runs, shapes, ratios, self.common, rows,
            strict=True,
        ):  # fmt: skip
            variance = ratio * shape
            corrected, noise = _mean_at(one, theta, own, common, (scatter, variance))
            noise += machine + np.maximum(variance - scatter, 0.0) / real
            found.append(replace(corrected, noise=noise))
        return found

    @cached_property
    def kinds(self) -> Kinds:
        """The kinds of group of the observations."""
        return Kinds.of(self.observations)

    @property
    def nominal_degrees(self) -> list[float]:
        """Degrees of freedom of the nominal scatter of every experiment."""
        return [max(len(one.response.runs) - 1.0, 1.0) for one in self.observations]

    @cached_property
    def common(self) -> list[FloatArray]:
        """(n,) c of the group of every observable, for every experiment."""
        shares = []
        for one, scatter in zip(self.observations, self.scatter, strict=True):
            spread = one.response.spread[:, one.kept]
            acting, share = spread[spread.any(axis=1)], np.ones_like(scatter)
            for _, places in one.parts if len(acting) else ():
                part = acting[:, places].mean(axis=1) / max(2.0 * float(scatter[places].mean()), 1e-24)
                share[places] = np.median(np.clip(1.0 - part, 0.0, 1.0))
            shares.append(share)
        return self.kinds.means(shares)


def _mean_at(
    one: Observation,
    theta: FloatArray,
    own: FloatArray,
    common: FloatArray,
    scatter: tuple[FloatArray, FloatArray],
) -> tuple[Observation, FloatArray]:
    """Return the observation around S + b D, and (n,) its variance, from (R, m) runs at (K,) sizes and (n,) c.

    ``scatter`` has the (n,) variances of a run: nominal, and at these sizes.
    """
    nominal, begin = one.response.nominal, one.response.runs[: len(own)]
    apart = own.mean(axis=0) - nominal
    apart[one.kept] -= common * (begin.mean(axis=0) - nominal)[one.kept] + one.moved(theta)
    before, variance = scatter
    mean, responses = before / len(one.response.runs), theta**2 @ one.learned
    seeds = 1.0 / len(begin) - 1.0 / len(one.response.runs)
    of_runs = variance / len(own) + common**2 * (before - 2.0 * np.sqrt(variance * before)) * seeds
    of_apart = np.maximum(of_runs - common**2 * mean, 0.0) + (1.0 - common) ** 2 * mean + responses
    shares = np.ones_like(variance)
    for _, places in one.parts:
        known = places[np.isfinite(apart[one.kept[places]])]
        unit = np.sqrt(of_apart[known].mean() + 1e-24) if known.size else 1.0
        shares[places] = share_of_signal(apart[one.kept[known]] / unit, of_apart[known] / unit**2)
    apart[one.kept] *= shares
    noise = (
        shares**2 * of_runs + (1.0 - shares) ** 2 * (mean + responses) + shares * (1.0 - shares) * of_apart
    )
    return one.corrected(apart, theta), noise


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
