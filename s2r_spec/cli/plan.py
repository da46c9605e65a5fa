"""``s2r plan``: the rollouts that a certificate takes, and the ε that a budget reaches, before anything runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from s2r_spec.base.json_values import line
from s2r_spec.cli.options.groups import group_options, options, search_option
from s2r_spec.cli.options.search import AsJson, Mode, OneRequirement, Quiet
from s2r_spec.cli.terminal.common import sentences
from s2r_spec.cli.terminal.terminal import console, say

if TYPE_CHECKING:
    from s2r_spec.certify.bound.kernels import Kernel
    from s2r_spec.certify.search.pilot import Pilot
    from s2r_spec.certify.search.plan import Plan
    from s2r_spec.certify.search.plan_request import PlanRequest

SpecOfPlan = Annotated[
    Path | None, typer.Argument(help="Specification, an .stl file, whose certify line gives the settings.")
]


Budgets = Annotated[
    list[int] | None,
    typer.Option(min=8, help="Number of rollouts; prints the ε that they reach. May be repeated."),
]
Costly = Annotated[
    str | None, typer.Option("--backend", "-b", help="Backend whose declared cost gives the times.")
]
Time = Annotated[
    str | None,
    typer.Option(
        help="Time available on --backend, such as 30min; prints the ε that can be reached in this time.",
        show_default=False,
    ),
]
PilotRun = Annotated[
    Path | None,
    typer.Option(help="Folder of a pilot run from which to judge R. Do not certify with its rollouts."),
]


@options
class Declaration:
    """The settings that a certify line declares; each field is an option, which goes before the spec's."""

    R: float | None = search_option(
        None,
        "--R",
        help="Sub-Gaussian bound on the noise of one rollout, in ρ's unit.",
        show_default="the spec's",
    )
    eps: float | None = search_option(
        None, help="Width ε of the interval, in ρ's unit.", show_default="the spec's"
    )
    delta: float | None = search_option(
        None, help="Probability δ that the interval is wrong.", show_default="the spec's"
    )
    B: float | None = search_option(
        None, "--B", help="Bound on the RKHS norm of E ρ, in ρ's unit.", show_default="the spec's"
    )
    dim: int = search_option(
        1, min=1, max=4, help="Number of test parameters, each with a range of width 1; without a spec."
    )
    kernel: str = search_option(
        "matern52", help="Kernel if the spec declares none: rbf, matern52 or matern32."
    )
    lengthscale: float = search_option(
        0.4, help="Lengthscale of that kernel, as a part of each parameter's range."
    )
    mode: Mode = "rigorous"
    bounds: tuple[float, float] | None = search_option(
        None, "--range", help="Proven least and greatest ρ; R is half the width."
    )

    @property
    def shape(self) -> Kernel:
        """The kernel of a spec that declares none."""
        from s2r_spec.certify.bound.kernels import Kernel

        return Kernel(self.kernel, self.lengthscale)


@group_options
def plan(
    spec: SpecOfPlan = None,
    requirement: OneRequirement = None,
    budget: Budgets = None,
    backend: Costly = None,
    time: Time = None,
    pilot: PilotRun = None,
    *,
    declared: Declaration,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Estimate the rollouts that a certificate takes, and the ε that a budget reaches."""
    with sentences(as_json):
        from s2r_spec.certify.search.pilot import Pilot
        from s2r_spec.certify.search.plan_request import PlanOptions, plan_request
        from s2r_spec.cli.terminal.stages import Stages
        from s2r_spec.space import Space
        from s2r_spec.spec import load_spec

        box = Space.of({f"d{i + 1}": (0.0, 1.0) for i in range(declared.dim)})
        options = PlanOptions(
            requirement=requirement,
            R=declared.R,
            epsilon=declared.eps,
            delta=declared.delta,
            B=declared.B,
            kernel=declared.shape,
            mode=declared.mode,
            bounds=declared.bounds,
            budgets=tuple(budget or ()),
            backend=backend,
            time=time,
            pilot=pilot,
        )
        request = plan_request(box if spec is None else load_spec(spec), options)
        if isinstance(request, Pilot):
            _print_pilot(request, as_json)
            return
        cost = PlanWords.of(request)
        if not as_json:  # what needs no estimate is printed before the estimates
            _print_request(request, cost)
        with Stages(console(stderr=True), quiet) as stages:
            result = request.plan(stages)
        if as_json:
            _print_json(request, result)
            return
        _print_plan(result, cost)
        for rollouts, width in result.gaps:
            each = f"{rollouts} rollouts of {request.seconds:.3g} s"
            say(f"  {time} of {backend} ({each}): ε = {width:.2g} for the gap")
        if request.pilot is not None:
            _print_pilot(request.pilot, as_json=False)


def _print_json(request: PlanRequest, result: Plan) -> None:
    from s2r_spec.base.json_values import extend
    from s2r_spec.report.records.plan import PlanObject

    of = request.settings
    values = {"R": of.R, "epsilon": of.epsilon, "delta": of.delta, "B": of.B}
    more = {"seconds_per_rollout": request.seconds, "pilot": request.pilot}
    print(line(extend(PlanObject, result, **values, **more)))


def _print_request(request: PlanRequest, cost: PlanWords) -> None:
    of, least = request.settings, request.floors
    where = f"{of.kernel.name} over {of.space.dim} parameter{'' if of.space.dim == 1 else 's'}"
    say(f"R = {of.R:g}, ε = {of.epsilon:g}, δ = {of.delta:g}, B = {of.B:g}, {where}")
    say(f"  impossible below      {cost.words(least.floor)}, on average, by any method")
    say(f"  at one known test     {cost.words(least.minimax)} (fixed width, Gaussian noise of deviation R)")


def _print_plan(result: Plan, cost: PlanWords) -> None:
    from s2r_spec.certify.search.plan import VARIATION

    low, high = cost.count(result.peaked), cost.count(result.flat)
    say(f"  expected              {cost.between(result.peaked, result.flat)}:")
    say(f"                        {low} if E ρ varies by {VARIATION:g} ε over the test space,")
    say(f"                        {high} if every test is nearly the worst one")
    for rollouts, narrow, wide in result.reachable_range:
        say(f"  with {rollouts} rollouts: ε = {narrow:.2g} … {wide:.2g}")


def _print_pilot(noise: Pilot, as_json: bool) -> None:
    if as_json:
        from s2r_spec.report.records.plan import PilotObject

        print(line(PilotObject(pilot=noise)))
        return
    say(
        f"pilot of {noise.rollouts} rollouts: standard deviation {noise.std:.3g}, "
        f"every R below {noise.refuted:.3g} is refuted"
    )
    say(noise.warning or "  no heavy tail seen; declare R with a margin, usually three standard deviations")
    say("  use this pilot only to choose R; certify with another seed, on new rollouts")


@dataclass(frozen=True)
class PlanWords:
    """Words for numbers of rollouts and their time.

    Attributes:
        seconds: duration of a rollout [s]; None without a backend.
        where: the place of the rollouts, for the time.
    """

    seconds: float | None
    where: str

    @classmethod
    def of(cls, request: PlanRequest) -> PlanWords:
        """Return the words for a plan."""
        return cls(request.seconds, "" if request.at_once == 1 else f" on {request.at_once} cores")

    def count(self, rollouts: float | None) -> str:
        """Return a number of rollouts; None is beyond the most that a plan has."""
        if rollouts is None:
            return "more than 2000000"
        return f"{rollouts:.0f}" if rollouts < 1e12 else f"{rollouts:.0e}"

    def words(self, rollouts: float) -> str:
        """Return a number of rollouts, with its time."""
        took = f", about {rollouts * self.seconds:.0f} s{self.where}" if self.seconds is not None else ""
        return f"{self.count(rollouts)} rollouts{took}"

    def between(self, low: float | None, high: float | None) -> str:
        """Return a range of rollouts, with its time."""
        counts = (
            f"{self.count(low)} … {self.count(high)} rollouts"
            if low is not None
            else f"{self.count(low)} rollouts"
        )
        if self.seconds is None or low is None or high is None:
            return counts
        return f"{counts}, about {low * self.seconds:.0f} … {high * self.seconds:.0f} s{self.where}"
