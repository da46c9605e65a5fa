"""``s2r plan``: the rollouts that a certificate takes, and the ε that a budget reaches, before anything runs."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from s2r_spec.cli.common import cores, sentences
from s2r_spec.cli.options import Quiet
from s2r_spec.cli.terminal import console, say
from s2r_spec.json_values import line


def plan(
    spec: Annotated[
        Path | None,
        typer.Argument(help="Specification, an .stl file, whose certify line gives the settings."),
    ] = None,
    requirement: Annotated[
        str | None,
        typer.Option("--requirement", "-r", help="Requirement of the spec.", show_default="the only one"),
    ] = None,
    R: Annotated[
        float | None,
        typer.Option(
            "--R",
            help="Sub-Gaussian bound on the noise of one rollout, in ρ's unit.",
            show_default="the spec's",
        ),
    ] = None,
    eps: Annotated[
        float | None, typer.Option(help="Width ε of the interval, in ρ's unit.", show_default="the spec's")
    ] = None,
    delta: Annotated[
        float | None,
        typer.Option(help="Probability δ that the interval is wrong.", show_default="the spec's"),
    ] = None,
    B: Annotated[
        float | None,
        typer.Option("--B", help="Bound on the RKHS norm of E ρ, in ρ's unit.", show_default="the spec's"),
    ] = None,
    dim: Annotated[
        int,
        typer.Option(
            min=1, max=4, help="Number of test parameters, each with a range of width 1; without a spec."
        ),
    ] = 1,
    kernel: Annotated[
        str, typer.Option(help="Kernel if the spec declares none: rbf, matern52 or matern32.")
    ] = "matern52",
    lengthscale: Annotated[
        float, typer.Option(help="Lengthscale of that kernel, as a part of each parameter's range.")
    ] = 0.4,
    mode: Annotated[
        str, typer.Option(help="Method of the bound: rigorous, rigorous-simple or paper.")
    ] = "rigorous",
    budget: Annotated[
        list[int] | None,
        typer.Option(min=8, help="Number of rollouts; prints the ε that they reach. May be repeated."),
    ] = None,
    backend: Annotated[
        str | None, typer.Option("--backend", "-b", help="Backend whose declared cost gives the times.")
    ] = None,
    time: Annotated[
        str | None,
        typer.Option(
            help="Time available on --backend, such as 30min; prints the ε that can be reached in this time.",
            show_default=False,
        ),
    ] = None,
    bounds: Annotated[
        tuple[float, float] | None,
        typer.Option("--range", help="Proven least and greatest ρ; R is half the width."),
    ] = None,
    pilot: Annotated[
        Path | None,
        typer.Option(help="Folder of a pilot run from which to judge R. Do not certify with its rollouts."),
    ] = None,
    quiet: Quiet = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")] = False,
) -> None:
    """Estimate the rollouts that a certificate takes, and the ε that a budget reaches."""
    with sentences(as_json):
        from s2r_spec.backend import is_exclusive, load_backend
        from s2r_spec.certify import plan as planning
        from s2r_spec.certify.from_spec import only_requirement
        from s2r_spec.certify.kernels import Kernel
        from s2r_spec.certify.pilot import read_pilot
        from s2r_spec.certify.settings import Declared
        from s2r_spec.cli.stages import Stages
        from s2r_spec.errors import UsageError
        from s2r_spec.json_objects.plan import PlanObject
        from s2r_spec.json_values import extended
        from s2r_spec.rollouts.journal import Journal
        from s2r_spec.space import Space
        from s2r_spec.spec import load_spec

        noise = None
        if pilot is not None:
            groups: dict[int, list[float]] = {}
            for record in Journal.read(_pilot_run(pilot, requirement)).records():
                groups.setdefault(record.query, []).append(record.rho)
            noise = read_pilot(list(groups.values()))
        if bounds is not None:
            if R is not None or not bounds[0] < bounds[1]:
                raise UsageError("--range takes the least and the greatest ρ, in this order, in place of --R")
            R = (bounds[1] - bounds[0]) / 2
        space = Space.of({f"d{i + 1}": (0.0, 1.0) for i in range(dim)})
        shape = Kernel(kernel, lengthscale)
        if spec is not None:
            parsed = load_spec(spec)
            declared = parsed.certify.get(requirement or only_requirement(parsed))
            if declared is not None:
                R, eps = R or declared.R, eps or declared.epsilon
                delta, B = delta or declared.delta, B or declared.B
                if declared.kernel is not None:
                    shape = Kernel(declared.kernel.name, declared.kernel.lengthscales)
            space = parsed.space
        settings = {"--R": R, "--eps": eps, "--delta": delta, "--B": B}
        missing = [name for name, value in settings.items() if value is None]
        if R is None or eps is None or delta is None or B is None:
            if noise is None:
                raise UsageError(f"give {', '.join(missing)}, or a spec whose certify line declares them")
            _print_pilot(noise, as_json)
            return
        machine = load_backend(backend) if backend is not None else None
        # A machine runs one rollout at a time; a simulator runs one on each core.
        at_once = 1 if is_exclusive(machine) else cores()
        seconds = machine.cost / at_once if machine is not None else None
        afforded = _afforded(time, seconds)
        declaration: Declared = {
            "kernel": shape,
            "B": B,
            "R": R,
            "delta": delta,
            "epsilon": eps,
            "mode": mode,
        }
        budgets = (*(budget or ()), *afforded)
        least = planning.floors(planning.settings_of(space, budgets, planning.MOST, **declaration))
        cost = Cost(seconds, "" if is_exclusive(machine) else f" on {cores()} cores")
        if not as_json:  # what needs no estimate is printed before the estimates
            plural = "" if space.dim == 1 else "s"
            say(
                f"R = {R:g}, ε = {eps:g}, δ = {delta:g}, B = {B:g}, {shape.name} over {space.dim} parameter{plural}"
            )
            say(f"  impossible below      {cost.words(least.floor)}, on average, by any method")
            say(
                f"  at one known test     {cost.words(least.minimax)} (fixed width, Gaussian noise of deviation R)"
            )
        with Stages(console(stderr=True), quiet) as stages:
            result = planning.plan(space, budgets=budgets, real=afforded, progress=stages, **declaration)
        if as_json:
            values = {"R": R, "epsilon": eps, "delta": delta, "B": B}
            print(line(extended(PlanObject, result, **values, seconds_per_rollout=seconds, pilot=noise)))
            return
        low, high = cost.count(result.peaked), cost.count(result.flat)
        say(f"  expected              {cost.between(result.peaked, result.flat)}:")
        say(f"                        {low} if E ρ varies by {planning.VARIATION:g} ε over the test space,")
        say(f"                        {high} if every test is nearly the worst one")
        for rollouts, narrow, wide in result.reachable_range:
            say(f"  with {rollouts} rollouts: ε = {narrow:.2g} … {wide:.2g}")
        for rollouts, width in result.gaps:
            say(
                f"  {time} of {backend} ({rollouts} rollouts of {seconds:.3g} s): ε = {width:.2g} for the gap"
            )
        if noise is not None:
            _print_pilot(noise, as_json=False)


@dataclass(frozen=True)
class Cost:
    """Words for numbers of rollouts and their time.

    Attributes:
        seconds: duration of a rollout [s]; None without a backend.
        where: the place of the rollouts, for the time.
    """

    seconds: float | None
    where: str

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


def _afforded(time: str | None, seconds: float | None) -> tuple[int, ...]:
    """Return the number of rollouts that fit in a time; () if no time is given.

    Args:
        time: such as "30min"; a number alone is in seconds.
        seconds: duration of a rollout [s]; None without a backend.

    Raises:
        UsageError: the text is not a time, there is no backend, or the time is too short for a search.
    """
    from s2r_spec.errors import UsageError
    from s2r_spec.lang.units import UnknownUnitError, parse_unit

    if time is None:
        return ()
    if not seconds:
        raise UsageError("--time needs a --backend that declares its cost")
    found = re.fullmatch(r"\s*([0-9]+(?:\.[0-9]*)?)\s*([a-zA-Z]*)\s*", time)
    try:
        unit, of = parse_unit(found[2] or "s") if found else None, parse_unit("s")
    except UnknownUnitError:
        unit = None
    if found is None or unit is None or not unit.fits(of):
        raise UsageError(f"--time {time} is not a time such as 30min or 1.5h")
    rollouts = int(unit.to(of)(float(found[1])) / seconds + 1e-9)
    if rollouts < 8:
        raise UsageError(
            f"--time {time} allows {rollouts} rollouts of {seconds:.3g} s; a search needs at least 8"
        )
    return (rollouts,)


def _pilot_run(folder: Path, requirement: str | None) -> Path:
    """Return the folder of the journal in a run's folder.

    Raises:
        UsageError: the folder has no journal, or the journals of several requirements.
    """
    from s2r_spec.errors import UsageError, one_of
    from s2r_spec.report.recompute import runs_in

    found = {path.name: path for path in runs_in(folder)}
    if len(found) == 1:
        return next(iter(found.values()))
    if requirement not in found:
        raise UsageError(
            f"{folder} holds runs of {one_of(found)}: choose one with --requirement, or give its folder"
        )
    return found[requirement]


def _print_pilot(noise: object, as_json: bool) -> None:
    from s2r_spec.certify.pilot import Pilot
    from s2r_spec.json_objects.plan import PilotObject

    assert isinstance(noise, Pilot)
    if as_json:
        print(line(PilotObject(pilot=noise)))
        return
    say(
        f"pilot of {noise.rollouts} rollouts: standard deviation {noise.std:.3g}, "
        f"every R below {noise.refuted:.3g} is refuted"
    )
    say(noise.warning or "  no heavy tail seen; declare R with a margin, usually three standard deviations")
    say("  use this pilot only to choose R; certify with another seed, on new rollouts")
