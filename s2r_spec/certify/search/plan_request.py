"""What a plan is made for: a specification's certify line, and the settings and times that the caller gives."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TypedDict, Unpack

from s2r_spec.backend import Backend, is_exclusive, load_backend
from s2r_spec.base.errors import UsageError
from s2r_spec.base.magnitude import whole
from s2r_spec.certify.arguments import as_backend
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.bound.settings import SearchSettings
from s2r_spec.certify.from_spec import of_gap, only_requirement
from s2r_spec.certify.search.pairing import SIMULATED_PER_REAL
from s2r_spec.certify.search.plan import MOST, Plan, Progress, plan_search
from s2r_spec.certify.search.search import Search
from s2r_spec.lang.units import UnknownUnitError, parse_unit
from s2r_spec.space import Space
from s2r_spec.spec import CertifySettings, Spec
from s2r_spec.workers.pools import cores

USUAL = Kernel("matern52", 0.4)
"""Definition: kernel of a plan without a certify line."""
FEWEST = 8
"""Definition: rollouts of the first batch, without which there is no search."""


class PlanKeywords(TypedDict, total=False):
    """Keywords of :func:`plan`; :class:`PlanOptions` describes them and has their defaults."""

    requirement: str | None
    kernel: Kernel
    B: float | None
    R: float | None
    bounds: tuple[float, float] | None
    delta: float | None
    epsilon: float | None
    mode: str
    budgets: tuple[int, ...]
    most: int
    backend: Backend | str | None
    time: str | None


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """Options of a plan. A setting that is given goes before that of the certify line.

    Args:
        requirement: the name of the requirement; None if the specification has only one.
        kernel: the kernel, if the certify line has none.
        B: bound on the RKHS norm of E ρ, in the unit of ρ.
        R: sub-Gaussian proxy of one rollout's noise, in the unit of ρ.
        bounds: proven least and greatest ρ, in place of R, which is then half the width.
        delta: probability that the interval is wrong.
        epsilon: width of the interval, in the unit of ρ.
        mode: the mode of the confidence set, see :class:`~s2r_spec.certify.bound.settings.SearchSettings`.
        budgets: numbers of rollouts; the plan gives the ε that each reaches.
        most: rollouts beyond which an estimate is None.
        backend: the backend whose declared cost gives the times.
        time: the time available on it, such as "30min"; the plan gives the ε that can be reached in it.
    """

    requirement: str | None = None
    kernel: Kernel = USUAL
    B: float | None = None
    R: float | None = None
    bounds: tuple[float, float] | None = None
    delta: float | None = None
    epsilon: float | None = None
    mode: str = "rigorous"
    budgets: tuple[int, ...] = ()
    most: int = MOST
    backend: Backend | str | None = None
    time: str | None = None


@dataclass(frozen=True)
class PlanRequest:
    """A plan whose settings are complete.

    Attributes:
        gap: the settings of the search of the gap.
        afforded: the number of rollouts that fit in the time, (); if none is given.
        seconds: time of a rollout, with as many at once as the backend allows [s]; None without a backend.
        at_once: rollouts that run at once.
    """

    settings: SearchSettings
    gap: SearchSettings
    budgets: tuple[int, ...]
    afforded: tuple[int, ...]
    seconds: float | None
    at_once: int

    def plan(self, progress: Progress | None = None) -> Plan:
        """Estimate the rollouts."""
        return plan_search(self.settings, (*self.budgets, *self.afforded), self.afforded, progress, self.gap)


def plan(of: Spec | Space, *, progress: Progress | None = None, **keywords: Unpack[PlanKeywords]) -> Plan:
    """Estimate the rollouts that a certificate takes, and the ε that a budget reaches, before anything runs.

    Args:
        of: a specification, whose certify line gives the settings, or a test space.
        progress: receives the stage, the number of finished estimates, and the number of all.
        keywords: see :class:`~s2r_spec.certify.search.plan_request.PlanOptions`.

    Raises:
        UsageError: a setting is missing or out of its range, or no rollouts could give a certificate.
    """
    return plan_request(of, PlanOptions(**keywords)).plan(progress)


def plan_request(of: Spec | Space, options: PlanOptions) -> PlanRequest:
    """Return a plan with complete settings; a UsageError as for :func:`plan`."""
    options = _declared_options(of, _with_proxy(options))
    R, epsilon, delta, B = options.R, options.epsilon, options.delta, options.B
    if R is None or epsilon is None or delta is None or B is None:
        values = {"--R": R, "--eps": epsilon, "--delta": delta, "--B": B}
        missing = [name for name, value in values.items() if value is None]
        raise UsageError(
            f"give {', '.join(missing)}, or a spec whose certify line declares them; `s2r pilot` proposes one"
        )
    backend = None if options.backend is None else as_backend(options.backend)
    machine = load_backend(backend) if isinstance(backend, str) else backend
    # A machine runs one rollout at a time; a simulator runs one on each core.
    at_once = 1 if is_exclusive(machine) else cores()
    seconds = None if machine is None else machine.cost / at_once
    afforded = rollouts_in(options.time, seconds)
    settings = SearchSettings(
        space=of.space if isinstance(of, Spec) else of,
        kernel=options.kernel,
        B=B,
        R=R,
        delta=delta,
        epsilon=epsilon,
        mode=options.mode,
        budget=options.most,  # with a budget too small an ε is an answer of a plan and no error
    )
    Search.of(settings).refuse_hopeless()
    for budget in (*options.budgets, *afforded):
        if whole("budget", budget, 2 * settings.spread) > options.most:
            raise UsageError(f"budget = {budget:g}; a plan has at most {options.most:,} rollouts")
    line = of.certify.get(options.requirement or only_requirement(of)) if isinstance(of, Spec) else None
    declared = CertifySettings(delta, epsilon, B, R).over(line or CertifySettings())
    own = of_gap(declared, SIMULATED_PER_REAL)
    gap = replace(settings, B=own.B or B, R=own.R or R, epsilon=own.epsilon or epsilon)
    return PlanRequest(settings, gap, options.budgets, afforded, seconds, at_once)


def _with_proxy(options: PlanOptions) -> PlanOptions:
    if options.bounds is None:
        return options
    low, high = options.bounds
    if options.R is not None or not low < high:
        raise UsageError("--range takes the least and the greatest ρ, in this order, in place of --R")
    return replace(options, R=(high - low) / 2)


def _declared_options(of: Spec | Space, options: PlanOptions) -> PlanOptions:
    if not isinstance(of, Spec):
        return options
    line = of.certify.get(options.requirement or only_requirement(of))
    if line is None:
        return options
    kernel = options.kernel if line.kernel is None else Kernel(line.kernel.name, line.kernel.lengthscales)
    return replace(
        options,
        R=options.R or line.R,
        epsilon=options.epsilon or line.epsilon,
        delta=options.delta or line.delta,
        B=options.B or line.B,
        kernel=kernel,
    )


def rollouts_in(time: str | None, seconds: float | None) -> tuple[int, ...]:
    """Return the number of rollouts of ``seconds`` that fit in a time such as "30min"; () if no time is given.

    A text that is no time, no backend, or too short a time for a search is a UsageError.
    """
    if time is None:
        return ()
    if not seconds:
        raise UsageError("--time needs a --backend that declares its cost")
    match = re.fullmatch(r"\s*([0-9]+(?:\.[0-9]*)?)\s*([a-zA-Z]*)\s*", time)
    try:
        unit, of = parse_unit(match[2] or "s") if match else None, parse_unit("s")
    except UnknownUnitError:
        unit = None
    if match is None or unit is None or not unit.fits(of):
        raise UsageError(f"--time {time} is not a time such as 30min or 1.5h")
    rollouts = int(unit.to(of)(float(match[1])) / seconds + 1e-9)
    if rollouts < FEWEST:
        raise UsageError(
            f"--time {time} allows {rollouts} rollouts of {seconds:.3g} s; a search needs at least {FEWEST}"
        )
    return (rollouts,)
