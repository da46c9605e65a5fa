"""Simulate what a machine is held against, and tell where most is left."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.attribution.place import Place, cause_first, visited
from s2r_spec.backend import Channel, HasResiduals, HasVariants
from s2r_spec.diagnose.axes import Line, Values
from s2r_spec.diagnose.gap.body import named
from s2r_spec.diagnose.remainder import channels
from s2r_spec.diagnose.remainder.cells import FEWEST_ROLLOUTS, Cells, quantities_of
from s2r_spec.diagnose.remainder.found import Remainder
from s2r_spec.diagnose.simulate import Bench, Job, Test, run_jobs
from s2r_spec.diagnose.simulator.experiments import RESIDUAL
from s2r_spec.rollouts.seeds import Stream, rollout_seed
from s2r_spec.space import key_of
from s2r_spec.trace import Trace, thinned

FloatArray = NDArray[np.float64]

TESTS = 3
"""At which the nominal simulator and its variants run."""
REPORTED = 5
"""Largest ones that are kept."""


def remainders(
    bench: Bench,
    lines: Sequence[Line],
    rollouts: Sequence[tuple[Test, Trace]],
    improved: Values,
    seed: int = 0,
    executor: Callable[[], Executor] | None = None,
    progress: Callable[[int, int], None] | None = None,
    named: Values | None = None,
) -> tuple[Remainder, ...]:
    """Return where most is left beyond what is allowed for, one cell a quantity's column, the cause's place first.

    Nothing where too few rollouts reached their end: no equation here is of a fall.

    Args:
        bench: the simulator.
        lines: of its catalogue.
        rollouts: (test, trace) of the machine.
        improved: effects with which the simulator should be nearest to it: the likeliest, and a little of all others.
        seed: of the simulated rollouts.
        executor: makes a pool for these; None runs them here.
        progress: called with (done, of).
        named: the likeliest alone, with which it may be nearer: what is left of channels is what both leave.
    """
    whole = [(test, trace) for test, trace in rollouts if trace.failure is None]
    if len(whole) < FEWEST_ROLLOUTS:
        return ()
    traces = [trace for _, trace in whole]
    tests = [dict(key) for key in dict.fromkeys(key_of(test) for test, _ in whole)]
    seeds = [[rollout_seed(seed, n, again, Stream.REMAINDER) for n in range(len(tests))] for again in (0, 1)]
    nominal = [
        bench.seen(bench.run({}, test, seed), test) for test, seed in zip(tests, seeds[1], strict=True)
    ]
    widths = quantities_of([trace for trace in nominal if trace.failure is None] or nominal)
    beside = [Job(improved, (run,)) for run in zip(tests, seeds[1], strict=True)]
    apart = named is not None and named != improved
    tell = _Stages(progress, len(tests) * (3 if apart else 2) + 1 + len(_variants(bench)) + len(lines))
    paths = np.concatenate(run_jobs(bench, beside, executor, tell, channels.Path(widths)))
    step = float(np.median([np.median(np.diff(trace.times)) for trace in traces]))
    read = _Read(channels.Beside.of(bench.backend.duration, widths, tests, list(paths)), step)
    runs = tuple(zip(tests, seeds[0], strict=True))
    ran = _Ran.of(bench, read, whole, runs, improved, executor, tell)
    # How much of a channel is a little of everything is an average over the rollout: one test is enough for it.
    once = len(ran.few) // 2
    typical = [Job(line.at(line.at_typical()), (runs[ran.few[once]],)) for line in lines]
    changes = [rows - ran.nominal[[once]] for rows in run_jobs(bench, typical, executor, tell, read)]
    simulated = [ran.simulated]
    if named is not None and apart:
        jobs = [Job(named, (run,)) for run in runs]
        simulated.append(np.concatenate(run_jobs(bench, jobs, executor, tell, read)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of cells into which no rollout reaches
        each = [_largest_of(bench, read, replace(ran, simulated=rows), changes, whole) for rows in simulated]
        out = min(each, key=lambda found: max((one.surplus for one in found), default=0.0))
    largest = sorted(out, key=lambda each: -each.surplus)[:REPORTED]
    return ordered([_with_times(each, traces) for each in largest])


def ordered(found: Sequence[Remainder]) -> tuple[Remainder, ...]:
    """Return remainders with the cause's place first.

    A residual of the equations of motion shows where a cause acts. A recorded channel also shows the controller's
    reaction. So beside a material residual the time of a recorded channel does not count.
    """
    acts = any(each.material and not each.recorded for each in found)
    return tuple(
        cause_first(
            found,
            lambda one: Place() if acts and one.recorded else one.place,
            lambda one: one.surplus if one.material else 0.0,
        )
    )


def _with_times(one: Remainder, traces: Sequence[Trace]) -> Remainder:
    """Return a remainder along a channel with the times at which the channel is in its cell, and with its range."""
    if not one.along:
        return one
    time, values = visited(traces, one.along, one.column, one.low, one.high)
    times = None if time is None or time.everything else (time.low, time.high)
    return replace(
        one, times=times, extent=(values.lowest, values.highest) if np.isfinite(values.extent) else None
    )


class _Stages:
    """Tells of jobs that run in several stages as of one."""

    def __init__(self, progress: Callable[[int, int], None] | None, of: int) -> None:
        self._progress, self._of, self._before = progress, of, 0

    def __call__(self, done: int, of: int) -> None:
        if self._progress is not None:
            self._progress(self._before + done, self._of)
        if done == of:
            self._before += of


def _variants(bench: Bench) -> list[str]:
    return list(bench.backend.variants()) if isinstance(bench.backend, HasVariants) else []


@dataclass(frozen=True)
class _Read:
    """Reads the cells of a rollout's channels and residuals; NaN for one that ended early.

    Of one with more samples than the machine's only as many are read, so that a mean is of the same times.
    """

    channels: channels.Beside
    step: float

    def __call__(self, bench: Bench, trace: Trace, test: Test) -> FloatArray:
        row = self.channels.averaged(bench.seen(thinned(trace, self.step), test), test)
        return row if trace.failure is None else np.full_like(row, np.nan)


@dataclass(frozen=True)
class _Ran:
    """Rows that were read, one a rollout.

    Attributes:
        machine: of the machine.
        simulated: of the improved simulator, at every different test.
        at: which of these each of the machine's is beside.
        few: which of these the others are beside, in the same noise.
        nominal: of the nominal simulator.
        variants: of each of its variants.
    """

    machine: FloatArray
    simulated: FloatArray
    at: NDArray[np.intp]
    few: NDArray[np.intp]
    nominal: FloatArray
    variants: Sequence[FloatArray]

    @classmethod
    def of(
        cls,
        bench: Bench,
        read: _Read,
        machine: Sequence[tuple[Test, Trace]],
        runs: Sequence[tuple[Test, int]],
        improved: Values,
        executor: Callable[[], Executor] | None,
        progress: Callable[[int, int], None],
    ) -> _Ran:
        """Simulate; ``runs`` are the different tests of the machine, each with a seed."""
        few = np.linspace(0, len(runs) - 1, min(TESTS, len(runs))).round().astype(int)
        of_few = tuple(runs[int(n)] for n in few)
        jobs = [Job(improved, (run,)) for run in runs]
        jobs += [Job({}, of_few), *(Job({}, of_few, name) for name in _variants(bench))]
        *simulated, nominal = (blocks := run_jobs(bench, jobs, executor, progress, read))[: len(runs) + 1]
        places = {key_of(test): n for n, (test, _) in enumerate(runs)}
        return cls(
            np.array([read(bench, trace, test) for test, trace in machine]),
            np.concatenate(simulated),
            np.array([places[key_of(test)] for test, _ in machine]),
            few,
            nominal,
            blocks[len(runs) + 1 :],
        )


def _largest_of(
    bench: Bench,
    read: _Read,
    ran: _Ran,
    effects: Sequence[FloatArray],
    rollouts: Sequence[tuple[Test, Trace]],
) -> list[Remainder]:
    cells = read.channels.cells
    size, surplus = channels.left_over(
        ran.machine,
        ran.simulated[ran.at],
        ran.nominal,
        ran.simulated[ran.few] - ran.nominal,
        effects,
        [block - ran.nominal for block in ran.variants],
        cells,
    )
    places = cells.places()
    residual = np.array([name.startswith(RESIDUAL) for name, *_ in places])
    seen = residual & np.isfinite(ran.machine).any(axis=0)
    surplus = channels.begin(places, np.where(residual | ~seen.any(), 1.0, channels.BESIDE) * surplus)
    units, of = _units([trace for _, trace in rollouts]), columns(bench.backend.channels, cells.widths)
    if isinstance(bench.backend, HasResiduals) and seen.any():
        test, trace = next(
            (test, trace)
            for (test, trace), row in zip(rollouts, ran.machine, strict=True)
            if np.isfinite(row[seen]).any()
        )
        found = bench.backend.residuals(trace, bench.matched.to_backend(test))
        widths = {
            name.removeprefix(RESIDUAL): width
            for name, width in cells.widths.items()
            if name.startswith(RESIDUAL)
        }
        of |= {(RESIDUAL + name, column): part for (name, column), part in parts(found, widths).items()}
        units |= {RESIDUAL + name: unit for name, unit in found.units.items()}
    return [
        replace(
            each,
            quantity=each.quantity.removeprefix(RESIDUAL),
            recorded=not each.quantity.startswith(RESIDUAL),
        )
        for each in _largest(cells, size, surplus, units, of)
    ]


def _units(traces: Sequence[Trace]) -> dict[str, str]:
    return {name: unit for trace in traces for name, unit in trace.units.items()}


def parts(trace: Trace, widths: Mapping[str, int]) -> dict[tuple[str, int], str]:
    """Return what each column of residuals belongs to, or its number; "" where there is but one."""
    of = {name: named(trace, name, width) for name, width in widths.items()}
    return _column_names({name: parts if parts[0] != name else () for name, parts in of.items()}, widths)


def columns(channels: Sequence[Channel], widths: Mapping[str, int]) -> dict[tuple[str, int], str]:
    """Return the name of each column of what is recorded, or its number; "" where there is but one."""
    return _column_names({channel.name: channel.columns for channel in channels}, widths)


def _column_names(
    names: Mapping[str, Sequence[str]], widths: Mapping[str, int]
) -> dict[tuple[str, int], str]:
    out = {}
    for name, width in widths.items():
        of = names.get(name, ())
        for column in range(width):
            label = of[column] if len(of) == width else f"column {column}"
            out[name, column] = "" if width == 1 else label
    return out


def _largest(
    cells: Cells,
    size: FloatArray,
    surplus: FloatArray,
    units: Mapping[str, str],
    part: Mapping[tuple[str, int], str],
) -> list[Remainder]:
    """Return the cell of the largest surplus of every column, the :data:`REPORTED` largest of these."""
    out: dict[tuple[str, int], Remainder] = {}
    places = cells.places()
    for k in np.argsort(-surplus, kind="stable"):
        name, column, along, low, high = places[k]
        if (name, column) not in out and surplus[k] > 0.0:
            unit, along_unit = units.get(name, ""), units.get(along, "") if along else "s"
            out[name, column] = Remainder(
                name,
                column,
                part[name, column],
                along,
                low,
                high,
                float(size[k]),
                unit,
                along_unit,
                float(surplus[k]),
            )
        if len(out) == REPORTED:
            break
    return list(out.values())
