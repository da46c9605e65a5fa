"""``s2r plan``: what a budget can certify, before anything runs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from s2r_spec.cli.common import cores, sentences
from s2r_spec.cli.options import Quiet
from s2r_spec.cli.terminal import console, say
from s2r_spec.plain import line


def plan(
    spec: Annotated[
        Path | None, typer.Argument(help="Take the settings from this spec's certify line.")
    ] = None,
    requirement: Annotated[str | None, typer.Option("--requirement", "-r", help="Of the spec.")] = None,
    R: Annotated[float | None, typer.Option("--R", help="Sub-Gaussian proxy of one rollout's noise.")] = None,
    eps: Annotated[float | None, typer.Option(help="Width of the interval that is wanted.")] = None,
    delta: Annotated[float | None, typer.Option(help="1 − probability.")] = None,
    B: Annotated[float | None, typer.Option("--B", help="Bound on the RKHS norm.")] = None,
    dim: Annotated[int, typer.Option(min=1, max=4, help="Test parameters, each with a range of 1.")] = 1,
    kernel: Annotated[str, typer.Option(help="rbf, matern52 or matern32.")] = "matern52",
    lengthscale: Annotated[float, typer.Option(help="As a share of each range.")] = 0.4,
    mode: Annotated[str, typer.Option(help="rigorous, rigorous-simple or paper.")] = "rigorous",
    budget: Annotated[
        list[int] | None, typer.Option(min=8, help="What ε do so many rollouts reach? (may be repeated)")
    ] = None,
    backend: Annotated[
        str | None, typer.Option("--backend", "-b", help="Give times, from its declared cost.")
    ] = None,
    time: Annotated[
        str | None,
        typer.Option(
            help="What ε does so much time of --backend reach? For example 30min.", show_default=False
        ),
    ] = None,
    bounds: Annotated[
        tuple[float, float] | None, typer.Option("--range", help="A proven range of ρ: R is half its width.")
    ] = None,
    pilot: Annotated[
        Path | None, typer.Option(help="Judge R from this run, which must then not be used again.")
    ] = None,
    quiet: Quiet = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Say how many rollouts a certificate takes, what a budget reaches, and what is impossible."""
    with sentences(as_json):
        from s2r_spec.backend import is_exclusive, load_backend
        from s2r_spec.certify import plan as planning
        from s2r_spec.certify.check import only_requirement
        from s2r_spec.certify.kernels import Kernel
        from s2r_spec.cli.stages import Stages
        from s2r_spec.errors import UsageError
        from s2r_spec.json_objects.parts import extended
        from s2r_spec.json_objects.plan import PlanObject
        from s2r_spec.rollouts.journal import Journal
        from s2r_spec.space import Space
        from s2r_spec.spec import load_spec

        noise = None
        if pilot is not None:
            groups: dict[int, list[float]] = {}
            for record in Journal.read(_pilot_run(pilot, requirement)).records():
                groups.setdefault(record.query, []).append(record.rho)
            noise = planning.read_pilot(list(groups.values()))
        if bounds is not None:
            if R is not None or not bounds[0] < bounds[1]:
                raise UsageError("--range takes the two ends of ρ, the lower one first, in place of --R")
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
        wanted = {"--R": R, "--eps": eps, "--delta": delta, "--B": B}
        lacking = [name for name, value in wanted.items() if value is None]
        if R is None or eps is None or delta is None or B is None:
            if noise is None:
                raise UsageError(f"give {', '.join(lacking)}, or a spec whose certify line declares them")
            _print_pilot(noise, as_json)
            return
        machine = load_backend(backend) if backend is not None else None
        # A machine runs one rollout after the other; a simulator one on each core.
        at_once = 1 if is_exclusive(machine) else cores()
        seconds = machine.cost / at_once if machine is not None else None
        afforded = _afforded(time, seconds)
        with Stages(console(stderr=True), quiet) as stages:
            result = planning.plan(
                space,
                kernel=shape,
                B=B,
                R=R,
                delta=delta,
                epsilon=eps,
                mode=mode,
                budgets=(*(budget or ()), *afforded),
                real=afforded,
                progress=stages,
            )
        if as_json:
            settings = {"R": R, "epsilon": eps, "delta": delta, "B": B}
            print(line(extended(PlanObject, result, **settings, seconds_per_rollout=seconds, pilot=noise)))
            return

        def cost(rollouts: float | None) -> str:
            if rollouts is None:
                return "more than 2000000 rollouts"
            where = "" if is_exclusive(machine) else f" on {cores()} cores"
            time = f", about {rollouts * seconds:.0f} s{where}" if seconds is not None else ""
            count = f"{rollouts:.0f}" if rollouts < 1e12 else f"{rollouts:.0e}"
            return f"{count} rollouts{time}"

        say(f"R = {R:g}, ε = {eps:g}, δ = {delta:g}, B = {B:g}, {shape.name} over {space.dim} parameter(s)")
        say(f"  impossible below      {cost(result.floor)}, on average, by any method")
        say(f"  at one known test     {cost(result.minimax)} (fixed width, Gaussian noise of deviation R)")
        say(f"  expected, peaked ρ    {cost(result.peaked)} (median of {result.runs} simulated searches)")
        say(f"  expected, flat ρ      {cost(result.flat)} (every test is nearly the worst: the hardest case)")
        for rollouts, width in result.reachable:
            say(f"  with {rollouts} rollouts: ε = {width:.3g}")
        for rollouts, width in result.gaps:
            say(
                f"  {time} of {backend} ({rollouts} rollouts of {seconds:.3g} s): ε = {width:.3g} for the gap"
            )
        if noise is not None:
            _print_pilot(noise, as_json=False)


def _afforded(time: str | None, seconds: float | None) -> tuple[int, ...]:
    """Return how many rollouts a time is enough for; none if no time is given.

    Args:
        time: such as "30min"; a number alone is in seconds.
        seconds: that a rollout takes [s]; None if nobody knows.

    Raises:
        UsageError: it is no time, there is no backend, or it is too short for a search.
    """
    from s2r_spec.errors import UsageError
    from s2r_spec.lang.units import UnknownUnitError, parse_unit

    if time is None:
        return ()
    if not seconds:
        raise UsageError("--time needs --backend, and that a rollout of it takes time")
    found = re.fullmatch(r"\s*([0-9]+(?:\.[0-9]*)?)\s*([a-zA-Z]*)\s*", time)
    try:
        unit, of = parse_unit(found[2] or "s") if found else None, parse_unit("s")
    except UnknownUnitError:
        unit = None
    if found is None or unit is None or not unit.fits(of):
        raise UsageError(f"--time {time} is no time, for example 30min or 1.5h")
    rollouts = int(float(found[1]) * unit.to(of)[0] / seconds + 1e-9)
    if rollouts < 8:
        raise UsageError(
            f"--time {time} is enough for {rollouts} rollouts of {seconds:.3g} s; a search takes 8 at least"
        )
    return (rollouts,)


def _pilot_run(folder: Path, requirement: str | None) -> Path:
    """Return the folder of the journal in a run's folder.

    Raises:
        UsageError: there is none, or there are those of several requirements.
    """
    from s2r_spec.errors import UsageError, one_of
    from s2r_spec.report.recompute import runs_in

    found = {path.name: path for path in runs_in(folder)}
    if len(found) == 1:
        return next(iter(found.values()))
    if requirement not in found:
        raise UsageError(
            f"{folder} holds runs of {one_of(found)}: say which with --requirement, or give its folder"
        )
    return found[requirement]


def _print_pilot(noise: object, as_json: bool) -> None:
    from s2r_spec.certify.plan import Pilot
    from s2r_spec.json_objects.plan import PilotObject

    assert isinstance(noise, Pilot)
    if as_json:
        print(line(PilotObject(pilot=noise)))
        return
    say(
        f"pilot of {noise.rollouts} rollouts: standard deviation {noise.std:.3g}, "
        f"every R below {noise.refuted:.3g} is refuted"
    )
    say(
        noise.warning
        or "  no heavy tail seen; declare R with a margin (three standard deviations is a usual one)"
    )
    say("  the pilot chose R: certify with another seed, on rollouts that it has not seen")
