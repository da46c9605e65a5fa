"""A ``certify`` line from a pilot, and the reason for each of its numbers.

Data: outcomes y_ij at n tests, a few at each; those of a failed rollout are ``fall``. Unknown: noise, kernel and norm
of the functions that the line must cover: E ρ, and E Δ for a gap. The models are those of
:mod:`~s2r_spec.certify.pilot.noise` and :mod:`~s2r_spec.certify.pilot.surface`. Rules, in the unit of ρ:

    fall     −2 max |ρ|, if the line declares none
    epsilon  half of the distance of the worst mean from 0, for a gap a third; at least its standard error
    R        3 × the upper limit of one rollout's deviation; at least the largest deviation seen, and epsilon/100
             with falls: half of the range from fall to the largest ρ, which bounds any noise in it (Hoeffding)
    B        3 × the smallest norm of a function that fits the means, gap_B the same for those of Δ
    gap_R    sqrt(r² + R²/2), where r is the R of the machine and R that of the simulator

Every number is rounded to two digits, to its safe side.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.bound.rounding import at_least, at_most
from s2r_spec.certify.bound.sample_complexity import sequential_lower_bound
from s2r_spec.certify.bound.settings import SearchSettings
from s2r_spec.certify.from_spec import of_gap
from s2r_spec.certify.pilot.noise import Noise, noise_of
from s2r_spec.certify.pilot.surface import LONGEST, Means, Surface, fit_kernel
from s2r_spec.certify.search.pairing import SIMULATED_PER_REAL
from s2r_spec.certify.search.plan import rollouts
from s2r_spec.space import Space
from s2r_spec.spec import CertifySettings, KernelChoice

DELTA = 1e-3
"""Level: probability that a certificate is wrong, if the line declares none."""
DEVIATIONS = 3.0
"""Level: R over the upper limit of a rollout's standard deviation: for noise that is not Gaussian, and differs among
tests."""
NORMS = 3.0
"""Level: B over the norm of the pilot's fit. A certificate refuses B below twice the norm that it sees, and it sees
more tests than the pilot. ``benchmarks/certify/pilot.py`` counts the refusals."""
UNSURE = 0.05
"""Level: probability that the lowest of n means of 0 is called different from 0."""
NOISELESS = 100.0
"""Level: largest ε over R. Without noise every R holds; with this one the estimate of the plan is a few batches."""


@dataclass(frozen=True)
class Outcomes:
    """Outcomes of one function at the tests of a pilot: ``groups`` has an array for each test."""

    groups: tuple[FloatArray, ...]
    failures: int = 0

    @property
    def means(self) -> FloatArray:
        """(n,) mean outcomes."""
        return np.array([float(group.mean()) for group in self.groups])

    @property
    def counts(self) -> FloatArray:
        """(n,) numbers of outcomes."""
        return np.array([float(len(group)) for group in self.groups])

    @property
    def noise(self) -> Noise:
        """The noise of one outcome."""
        return noise_of(self.groups)


@dataclass(frozen=True)
class Evidence:
    """What a pilot has seen.

    Attributes:
        points: (n, dim) tests.
        spacing: (dim,) distances of neighbouring tests.
        systems: name → its outcomes: the system that runs, or simulator and machine. B and R cover the first one. The
            interval must tell the worst mean of the last one from 0.
        gaps: the outcomes Δ, which gap_B and gap_R cover; None without a machine.
        unit: the unit of ρ.
    """

    space: Space
    points: FloatArray
    spacing: FloatArray
    systems: Mapping[str, Outcomes]
    gaps: Outcomes | None
    unit: str

    @property
    def judged(self) -> str:
        """The name of the system whose worst mean the interval must tell from 0."""
        return [*self.systems][-1]


@dataclass(frozen=True)
class Proposal:
    """A certify line.

    Attributes:
        settings: its settings.
        reasons: setting → where it comes from and what it costs, in one sentence.
        warnings: what may make the line wrong, each in one sentence.
        worst: the test of the worst mean.
        lowest_mean: the worst mean.
        highest_mean: the largest mean.
        expected: low and high end of the rollouts until the interval is ε wide, of the real ones in a gap.
    """

    settings: CertifySettings
    reasons: dict[str, str]
    warnings: tuple[str, ...]
    worst: dict[str, float]
    lowest_mean: float
    highest_mean: float
    expected: tuple[int, int]


def propose_fall(declared: float | None, rhos: FloatArray) -> float:
    """Return ρ of a failed rollout: the declared one if it is below every (n,) ρ seen, else −2 max |ρ|."""
    if not len(rhos):
        raise UsageError("every rollout of the pilot failed, so there is no ρ to choose settings from")
    if declared is not None and declared < rhos.min():
        return declared
    largest = float(np.abs(rhos).max())
    if not largest:
        raise UsageError("every ρ of the pilot is 0, so there is nothing to choose settings from")
    return -float(at_most(2 * largest, 2))


def propose(seen: Evidence, declared: CertifySettings, fall: float) -> Proposal:
    """Propose a certify line; its δ is the declared one, if there is one.

    Raises:
        UsageError: there are too few replicates, or every mean is 0.
    """
    noises = {name: one.noise for name, one in seen.systems.items()}
    means = seen.systems[seen.judged].means
    place = int(means.argmin())
    epsilon, epsilon_words, unsure = _epsilon(seen, place, noises[seen.judged])
    proxies = [_proxy(seen, name, noise, epsilon, fall) for name, noise in noises.items()]
    R, r = (float(at_most(proxies[place][0], 2)) for place in (0, -1))
    bounded = {"B": next(iter(seen.systems.values()))} | ({"gap_B": seen.gaps} if seen.gaps else {})
    functions = {
        name: Means(seen.points, one.means, one.counts, one.noise.std or R / DEVIATIONS)
        for name, one in bounded.items()
    }
    surface = fit_kernel(seen.space, [*functions.values()], seen.spacing)
    kernel = _rounded(surface.kernel)
    norms = {name: one.norm(kernel) for name, one in functions.items()}
    B, *gap_B = (float(at_most(NORMS * norm, 2)) for norm in norms.values())
    gap_R = float(at_most(math.hypot(r, R / math.sqrt(SIMULATED_PER_REAL)), 2))
    settings = CertifySettings(
        DELTA if declared.delta is None else declared.delta,
        min(epsilon, B),  # without a rollout the interval is 2B wide
        B,
        R,
        _choice(kernel),
        fall,
        *([gap_B[0], gap_R, min(epsilon, gap_B[0])] if gap_B else []),
    )
    reasons = {
        "delta": _delta_words(declared.delta, R, epsilon),
        "epsilon": epsilon_words + (", and at most B" if epsilon > B else ""),
        "B": f"{NORMS:g} × the norm of the fit, {_amount(norms['B'], seen.unit)}; a certificate refuses 2 × the norm "
        f"that it sees",
        "R": proxies[0][1],
        "kernel": _kernel_words(surface, seen),
        "fall": _fall_words(declared.fall, fall),
    }
    if gap_B:
        reasons["gap_B"] = f"{NORMS:g} × the norm of the fit to Δ, {_amount(norms['gap_B'], seen.unit)}"
        reasons["gap_R"] = f"of one real rollout minus two simulated ones; of the real one {proxies[-1][1]}"
        reasons["gap_epsilon"] = "as epsilon, and at most gap_B"
    expected = rollouts(_search(seen, settings))
    for name, saving in _savings(seen, settings, [*functions.values()][-1]).items():
        reasons[name] += saving
    return Proposal(
        settings,
        reasons,
        tuple(filter(None, (unsure, *_warnings(seen, noises, surface), _left_out(seen, declared)))),
        seen.space.point(seen.points[place]),
        float(means.min()),
        float(means.max()),
        (round(expected[0]), round(expected[1])),
    )


def _search(seen: Evidence, line: CertifySettings) -> SearchSettings:
    """Return the settings of the search whose rollouts cost most: of the gap if there is a machine."""
    line = of_gap(line, SIMULATED_PER_REAL) if seen.gaps else line
    assert line.kernel
    assert line.B
    assert line.R
    assert line.delta
    assert line.epsilon
    return SearchSettings(
        space=seen.space,
        kernel=Kernel(line.kernel.name, line.kernel.lengthscales),
        B=line.B,
        R=line.R,
        delta=line.delta,
        epsilon=min(line.epsilon, line.B),
    )


def _savings(seen: Evidence, line: CertifySettings, function: Means) -> dict[str, str]:
    """Return setting → words for the rollouts that a smaller B or R, or a longer kernel, would save."""
    assert line.kernel
    widths = seen.space.upper - seen.space.lower
    longer = np.minimum(2 * np.array(line.kernel.lengthscales), widths)
    kernel = Kernel(line.kernel.name, tuple(longer.tolist()))
    bound, proxy = ("gap_B", "gap_R") if seen.gaps else ("B", "R")
    changes: dict[str, tuple[str, dict[str, Any]]] = {
        bound: ("half of it", {bound: getattr(line, bound) / 2}),
        proxy: ("half of it", {proxy: getattr(line, proxy) / 2}),
        "kernel": ("up to twice as long", {bound: NORMS * function.norm(kernel), "kernel": _choice(kernel)}),
    }
    savings = {}
    for name, (words, changed) in changes.items():
        parts = (rollouts(_search(seen, one)) for one in (line, replace(line, **changed)))
        fewer = math.sqrt(math.prod(next(parts)) / math.prod(next(parts)))
        of = "real rollouts" if seen.gaps else "rollouts"
        savings[name] = f"; {words}: {fewer:.1f} times fewer {of}" if fewer >= 1.05 else ""
    return savings


def _amount(value: float, unit: str) -> str:
    """Return an upper bound of an amount with its unit, in two digits."""
    return f"{at_most(value, 2)} {unit}".rstrip()


def _epsilon(seen: Evidence, place: int, noise: Noise) -> tuple[float, str, str]:
    """Return ε, its reason, and a warning if the sign of the worst mean is not known."""
    group = seen.systems[seen.judged].groups[place]
    mean, error = float(group.mean()), noise.std / math.sqrt(len(group))
    if not max(abs(mean), error):
        raise UsageError(
            "the worst mean of the pilot is 0: no epsilon can tell it from 0; change the requirement"
        )
    test = ", ".join(
        f"{axis.name} = {value:.3g} {axis.unit}".rstrip()
        for axis, value in zip(seen.space.axes, seen.points[place], strict=True)
    )
    about = f"the worst mean {seen.judged}, {mean:+.3g} {seen.unit}".rstrip() + f" at {test}"
    share = f"{'a third' if seen.gaps else 'half'} of {about}"  # of a gap, two intervals add up
    epsilon = abs(mean) / (3 if seen.gaps else 2)
    # The lowest of n means is below its expectation.
    if abs(mean) >= NormalDist().inv_cdf(1 - UNSURE / 2 / len(seen.points)) * error:
        return float(at_least(epsilon, 2)), f"{share}; half of it: 4 times the rollouts", ""
    return (
        float(at_least(max(epsilon, error), 2)),
        share if epsilon > error else f"the standard error of {about}",
        "the pilot does not tell the worst mean from 0, so that a check may end without a verdict",
    )


def _proxy(seen: Evidence, name: str, noise: Noise, epsilon: float, fall: float) -> tuple[float, str]:
    """Return the proxy of the noise of one system, and its reason."""
    outcomes = seen.systems[name]
    limit = f"the deviation of one {name}, at most {_amount(noise.upper, seen.unit)}"
    if outcomes.failures:
        highest = max(float(group.max()) for group in outcomes.groups)
        return (highest - fall) / 2, f"half of the range from fall to the largest {name}"
    words = "there is hardly any noise" if noise.std else "all replicates are equal, so there is no noise"
    return max(
        (epsilon / NOISELESS, f"epsilon/{NOISELESS:g}: {words}"),
        (DEVIATIONS * noise.upper, f"{DEVIATIONS:g} × {limit}"),
        (noise.largest, f"the largest deviation seen, above {DEVIATIONS:g} × {limit}"),
    )


def _rounded(kernel: Kernel) -> Kernel:
    lengthscales = kernel.lengthscale
    assert isinstance(lengthscales, tuple)
    return Kernel(kernel.name, tuple(float(at_least(one, 2)) for one in lengthscales))


def _choice(kernel: Kernel) -> KernelChoice:
    assert isinstance(kernel.lengthscale, tuple)
    return KernelChoice(kernel.name, kernel.lengthscale)  # type: ignore[arg-type]


def _delta_words(declared: float | None, R: float, epsilon: float) -> str:
    if declared is not None:
        return "as declared"
    floors = [sequential_lower_bound(R, epsilon, delta) for delta in (1e-6, DELTA)]
    times = f"1e-6: {floors[0] / floors[1]:.1f} times the rollouts"
    return f"one certificate in {1 / DELTA:.0f} may be wrong; {times}"


def _kernel_words(surface: Surface, seen: Evidence) -> str:
    of = "the most likely family"
    if surface.kernel.name != surface.likely:
        of = f"one step rougher than {surface.likely}, {of}"
    gaps = ", ".join(
        f"{gap:.2g} {axis.unit}".rstrip() + f" of {axis.name}"
        for axis, gap in zip(seen.space.axes, seen.spacing, strict=True)
    )
    return f"{of}; lengthscales at most {LONGEST:g} × the distance of tests ({gaps}) and the range"


def _fall_words(declared: float | None, fall: float) -> str:
    if declared == fall:
        return "as declared, below every ρ seen"
    return "twice the largest |ρ| seen: with one failure in three rollouts a mean is negative"


def _left_out(seen: Evidence, declared: CertifySettings) -> str:
    own = [name for name in ("gap_B", "gap_R", "gap_epsilon") if getattr(declared, name) is not None]
    if seen.gaps or not own:
        return ""
    names = ", ".join(own)
    return f"{names} of the old line belong to its kernel and are left out; a pilot with --real proposes new ones"


def _warnings(seen: Evidence, noises: Mapping[str, Noise], surface: Surface) -> list[str]:
    found = []
    for name, noise in noises.items():
        failures = seen.systems[name].failures
        if failures:
            found.append(
                f"{failures} rollouts of {name} failed and count as fall, so that R is large; a smaller test space "
                f"without them takes fewer rollouts"
            )
        elif noise.warning:
            found.append(noise.warning)
        elif noise.noisiest is not None:
            test = seen.space.point(seen.points[noise.noisiest])
            where = ", ".join(f"{key} = {value:.3g}" for key, value in test.items())
            found.append(f"{name} is noisier at {where} than elsewhere; R allows for it")
    space = seen.space
    if (seen.points.min(axis=0) > space.lower).any() or (seen.points.max(axis=0) < space.upper).any():
        found.append(
            "no test lies at the ends of the ranges, where a robot often fails first: B and R may be too small; run a "
            "pilot with a larger --budget"
        )
    if surface.short:
        found.append(
            f"the means change within the distance of two tests along {', '.join(surface.short)}; run a pilot with a "
            f"larger --budget"
        )
    return found
