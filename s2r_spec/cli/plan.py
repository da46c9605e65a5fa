"""``s2r plan``: the rollouts that a certificate takes, and the ε that a budget reaches, before anything runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from s2r_spec.base.json_values import line
from s2r_spec.cli.options.groups import group_options, options, search_option
from s2r_spec.cli.options.search import AsJson, Mode, OneRequirement, Quiet
from s2r_spec.cli.terminal.common import sentences
from s2r_spec.cli.terminal.terminal import console, say

if TYPE_CHECKING:
    from s2r_spec.certify.search.plan import Plan
    from s2r_spec.certify.search.plan_request import PlanRequest

SpecOfPlan = Annotated[
    Path | None, typer.Argument(help="Specification, an .stl file, whose certify line gives the settings.")
]


@options
class Declaration:
    """The settings of a plan, which go before those of the spec's certify line; each field is an option."""

    budgets: list[int] | None = typer.Option(
        None, "--budget", min=8, help="Number of rollouts; prints the ε that they reach. May be repeated."
    )
    backend: str | None = typer.Option(
        None, "--backend", "-b", help="Backend whose declared cost gives the times."
    )
    time: str | None = typer.Option(
        None,
        help="Time available on --backend, such as 30min; prints the ε that can be reached in this time.",
        show_default=False,
    )
    R: float | None = search_option(
        None,
        "--R",
        help="Sub-Gaussian bound on the noise of one rollout, in ρ's unit.",
        show_default="the spec's",
    )
    epsilon: float | None = search_option(
        None, "--eps", help="Width ε of the interval, in ρ's unit.", show_default="the spec's"
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

    def request(self, spec: Path | None, requirement: str | None) -> PlanRequest:
        """Return the plan with complete settings."""
        from s2r_spec.certify.bound.kernels import Kernel
        from s2r_spec.certify.search.plan_request import PlanOptions, plan_request
        from s2r_spec.space import Space
        from s2r_spec.spec import load_spec

        given = {name: value for name, value in vars(self).items() if name not in ("dim", "lengthscale")}
        kernel, budgets = Kernel(self.kernel, self.lengthscale), tuple(self.budgets or ())
        box = Space.of({f"d{i + 1}": (0.0, 1.0) for i in range(self.dim)})
        how = PlanOptions(**given | {"requirement": requirement, "kernel": kernel, "budgets": budgets})
        return plan_request(box if spec is None else load_spec(spec), how)


@group_options
def plan(
    spec: SpecOfPlan = None,
    requirement: OneRequirement = None,
    *,
    declared: Declaration,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Estimate the rollouts that a certificate takes, and the ε that a budget reaches."""
    with sentences(as_json):
        from s2r_spec.cli.terminal.stages import Stages

        request = declared.request(spec, requirement)
        if not as_json:  # what needs no estimate is printed before the estimates
            _print_request(request)
        with Stages(console(stderr=True), quiet) as stages:
            result = request.plan(stages)
        if as_json:
            _print_json(request, result)
            return
        _print_plan(request, result)
        for rollouts, width in result.gaps:
            each = f"{rollouts} rollouts of {request.seconds:.3g} s"
            say(f"  {declared.time} of {declared.backend} ({each}): ε = {width:.2g} for the gap")


def _print_json(request: PlanRequest, result: Plan) -> None:
    from s2r_spec.base.json_values import extend
    from s2r_spec.report.records.plan import PlanObject

    of = request.settings
    values = {"R": of.R, "epsilon": of.epsilon, "delta": of.delta, "B": of.B}
    print(line(extend(PlanObject, result, **values, seconds_per_rollout=request.seconds)))


def _print_request(request: PlanRequest) -> None:
    from s2r_spec.certify.search.plan import floors

    of, least = request.settings, floors(request.settings)
    where = f"{of.kernel.name} over {of.space.dim} parameter{'' if of.space.dim == 1 else 's'}"
    say(f"R = {of.R:g}, ε = {of.epsilon:g}, δ = {of.delta:g}, B = {of.B:g}, {where}")
    say(f"  impossible below      {_words(request, least.floor)}, on average, by any method")
    say(
        f"  at one known test     {_words(request, least.minimax)} (fixed width, Gaussian noise of deviation R)"
    )


def _print_plan(request: PlanRequest, result: Plan) -> None:
    from s2r_spec.certify.search.plan import VARIATION

    low, high = _count(result.peaked), _count(result.flat)
    say(f"  expected              {_words(request, result.peaked, result.flat)}:")
    say(f"                        {low} if E ρ varies by {VARIATION:g} ε over the test space,")
    say(f"                        {high} if every test is nearly the worst one")
    for rollouts, narrow, wide in result.reachable_range:
        say(f"  with {rollouts} rollouts: ε = {narrow:.2g} … {wide:.2g}")


def _count(rollouts: float | None) -> str:
    """Return a number of rollouts; None is beyond the most that a plan has."""
    if rollouts is None:
        return "more than 2000000"
    return f"{rollouts:.0f}" if rollouts < 1e12 else f"{rollouts:.0e}"


def _words(request: PlanRequest, least: float | None, *most: float | None) -> str:
    """Return a number of rollouts, or the ends of a range of them, with their time."""
    ends = [least] if least is None else [least, *most]
    known = [end for end in ends if end is not None]
    words = f"{' … '.join(map(_count, ends))} rollouts"
    if request.seconds is None or len(known) < len(ends):
        return words
    times = " … ".join(f"{end * request.seconds:.0f}" for end in known)
    return f"{words}, about {times} s{'' if request.at_once == 1 else f' on {request.at_once} cores'}"
