"""A ``certify`` line from a pilot, and the reason for each of its numbers.

Data: outcomes y_ij at n tests, a few at each; those of a failed rollout are ``fall``. Unknown: noise, kernel and norm
of the functions that the line must cover: E ρ for a check, E ρ of the simulator and E Δ for a gap. The models are those
of :mod:`~s2r_spec.certify.pilot.noise` and :mod:`~s2r_spec.certify.pilot.surface`. Rules, in the unit of ρ:

    fall     −2 max |ρ|, if the line declares none
    epsilon  half of the distance of the worst mean from 0, for a gap a third; at least its standard error
    R        3 × the upper limit of one rollout's deviation; at least the largest deviation seen, and epsilon/100
             with falls: half of the range from fall to the largest ρ, which bounds any noise in it (Hoeffding)
    B        3 × the smallest norm that fits the means

Every number is rounded to two digits, to its safe side.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.bound.rounding import at_least, at_most
from s2r_spec.certify.bound.sample_complexity import sequential_lower_bound
from s2r_spec.certify.bound.settings import SearchSettings
from s2r_spec.certify.pilot.noise import Noise, noise_of
from s2r_spec.certify.pilot.surface import LONGEST, Means, Surface, fit_kernel
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
        noisy: name → outcomes whose noise R must cover.
        bounded: name → outcomes whose mean B and the kernel must cover.
        worst: the name among ``noisy`` whose worst mean the interval must tell from 0.
        averaged: proxy of the noise of the searched outcome over R.
        intervals: intervals whose widths add up in the one that must exclude 0: 1 for a check, 2 for a gap.
        unit: the unit of ρ.
    """

    space: Space
    points: FloatArray
    spacing: FloatArray
    noisy: Mapping[str, Outcomes]
    bounded: Mapping[str, Outcomes]
    worst: str
    averaged: float
    intervals: int
    unit: str


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
        expected: low and high end of the rollouts until the interval is ε wide.
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
    noises = {name: one.noise for name, one in seen.noisy.items()}
    means = seen.noisy[seen.worst].means
    place = int(means.argmin())
    epsilon, epsilon_words, unsure = _epsilon(seen, place, noises[seen.worst])
    R, R_words = _proxy(seen, noises, epsilon, fall)
    functions = {
        name: Means(seen.points, one.means, one.counts, one.noise.std or R / DEVIATIONS)
        for name, one in seen.bounded.items()
    }
    surface = fit_kernel(seen.space, [*functions.values()], seen.spacing)
    kernel = _rounded(surface.kernel)
    norm, largest = max((one.norm(kernel), name) for name, one in functions.items())
    B = float(at_most(NORMS * norm, 2))
    delta = DELTA if declared.delta is None else declared.delta
    search = SearchSettings(
        space=seen.space, kernel=kernel, B=B, R=R * seen.averaged, delta=delta, epsilon=epsilon
    )
    low, high = rollouts(search)
    fit = _amount(norm, seen.unit) + (f" for {largest}" if len(functions) > 1 else "")
    reasons = {
        "delta": _delta_words(declared.delta, R, epsilon),
        "epsilon": epsilon_words,
        "B": f"{NORMS:g} × the norm of the fit, {fit}; a certificate refuses 2 × the norm that it sees",
        "R": R_words,
        "kernel": _kernel_words(surface, seen),
        "fall": _fall_words(declared.fall, fall),
    }
    within = np.minimum(2 * kernel.lengthscales(seen.space.dim), seen.space.upper - seen.space.lower)
    longer = Kernel(kernel.name, tuple(within.tolist()))
    B_longer = NORMS * max(one.norm(longer) for one in functions.values())
    for name, words, changed in (
        ("B", "half of it", replace(search, B=B / 2)),
        ("R", "half of it", replace(search, R=search.R / 2)),
        ("kernel", "up to twice as long", replace(search, kernel=longer, B=B_longer)),
    ):
        fewer = math.sqrt(low * high / math.prod(rollouts(changed)))
        reasons[name] += f"; {words}: {fewer:.1f} times fewer rollouts" if fewer >= 1.05 else ""
    return Proposal(
        CertifySettings(delta, epsilon, B, R, _choice(kernel), fall),
        reasons,
        tuple(filter(None, (unsure, *_warnings(seen, noises, surface)))),
        seen.space.point(seen.points[place]),
        float(means.min()),
        float(means.max()),
        (round(low), round(high)),
    )


def _amount(value: float, unit: str) -> str:
    """Return an upper bound of an amount with its unit, in two digits."""
    return f"{at_most(value, 2)} {unit}".rstrip()


def _epsilon(seen: Evidence, place: int, noise: Noise) -> tuple[float, str, str]:
    """Return ε, its reason, and a warning if the sign of the worst mean is not known."""
    group = seen.noisy[seen.worst].groups[place]
    mean, error = float(group.mean()), noise.std / math.sqrt(len(group))
    if not max(abs(mean), error):
        raise UsageError(
            "the worst mean of the pilot is 0: no epsilon can tell it from 0; change the requirement"
        )
    test = ", ".join(
        f"{axis.name} = {value:.3g} {axis.unit}".rstrip()
        for axis, value in zip(seen.space.axes, seen.points[place], strict=True)
    )
    about = f"the worst mean {seen.worst}, {mean:+.3g} {seen.unit}".rstrip() + f" at {test}"
    share = f"{'half' if seen.intervals == 1 else 'a third'} of {about}"
    epsilon = abs(mean) / (seen.intervals + 1)
    # The lowest of n means is below its expectation.
    if abs(mean) >= NormalDist().inv_cdf(1 - UNSURE / 2 / len(seen.points)) * error:
        return float(at_least(epsilon, 2)), f"{share}; half of it: 4 times the rollouts", ""
    return (
        float(at_least(max(epsilon, error), 2)),
        share if epsilon > error else f"the standard error of {about}",
        "the pilot does not tell the worst mean from 0, so that a check may end without a verdict",
    )


def _proxy(seen: Evidence, noises: Mapping[str, Noise], epsilon: float, fall: float) -> tuple[float, str]:
    """Return R and its reason."""
    noiseless = not any(noise.std for noise in noises.values())
    words = "all replicates are equal, so there is no noise" if noiseless else "there is hardly any noise"
    found = {"": (epsilon / NOISELESS, f"epsilon/{NOISELESS:g}: {words}")}
    for name, noise in noises.items():
        outcomes = seen.noisy[name]
        limit = f"the deviation of one {name}, at most {_amount(noise.upper, seen.unit)}"
        if outcomes.failures:
            highest = max(float(group.max()) for group in outcomes.groups)
            found[name] = (highest - fall) / 2, f"half of the range from fall to the largest {name}"
        elif DEVIATIONS * noise.upper >= noise.largest:
            found[name] = DEVIATIONS * noise.upper, f"{DEVIATIONS:g} × {limit}"
        else:
            found[name] = noise.largest, f"the largest deviation seen, above {DEVIATIONS:g} × {limit}"
    R, words = max(found.values())
    return float(at_most(R, 2)), words


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


def _warnings(seen: Evidence, noises: Mapping[str, Noise], surface: Surface) -> list[str]:
    found = []
    for name, noise in noises.items():
        failures = seen.noisy[name].failures
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
    if surface.short:
        found.append(
            f"the means change within the distance of two tests along {', '.join(surface.short)}; run a pilot with a "
            f"larger --budget"
        )
    return found
