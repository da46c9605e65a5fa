"""Simulate what a machine is held against, and tell where most is left."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from s2r_spec.attribution.place import Place, cause_first, visited
from s2r_spec.backend import Channel, HasResiduals, HasVariants
from s2r_spec.diagnose.axes import Line, Values
from s2r_spec.diagnose.gap.body import named
from s2r_spec.diagnose.remainder import channels
from s2r_spec.diagnose.remainder.cells import FEWEST_ROLLOUTS, Cells, quantities_of
from s2r_spec.diagnose.remainder.found import Remainder
from s2r_spec.diagnose.simulate import Bench, Job, Test, evenly, places_of, run_jobs
from s2r_spec.diagnose.simulator.experiments import RESIDUAL
from s2r_spec.rollouts.seeds import Stream, rollout_seed
from s2r_spec.trace import Trace, thinned

FloatArray = NDArray[np.float64]

TESTS = 3
"""Budget: tests at which the nominal simulator and its variants run. Twice as many halve the variance of what effects
and variants do."""
REPORTED = 5
"""Definition: largest remainders that are kept. Doubled, a report may show twice as many."""


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
    tests = [dict(key) for key in places_of([test for test, _ in whole])]
    first, again = (
        [(test, rollout_seed(seed, n, of, Stream.REMAINDER)) for n, test in enumerate(tests)] for of in (0, 1)
    )
    nominal = [(test, bench.seen(bench.run({}, test, own), test)) for test, own in again]
    nominal = [(test, trace) for test, trace in nominal if trace.failure is None] or nominal
    widths = quantities_of([trace for _, trace in nominal])
    few = evenly(len(tests), TESTS)
    # How much of a channel is a little of everything is an average over the rollout: one test is enough for it.
    once = len(few) // 2
    machines = [improved] if named is None or named == improved else [improved, named]
    jobs = [Job({}, tuple(first[n] for n in few), name) for name in ("", *_variants(bench))]
    jobs += [Job(line.at(line.at_typical()), (first[few[once]],)) for line in lines]
    jobs += [Job(values, (run,)) for values in machines for run in first]

    def tell(before: int, done: int, of: int) -> None:
        if progress is not None:
            progress(before + done, len(tests) + len(jobs))

    beside = [Job(improved, (run,)) for run in again]
    paths = np.concatenate(run_jobs(bench, beside, executor, partial(tell, 0), channels.Path(widths)))
    step = float(np.median([np.median(np.diff(trace.times)) for _, trace in whole]))
    cells = channels.Beside.of(bench.backend.duration, widths, tests, list(paths))
    read = _Read(cells, step)
    rows = iter(run_jobs(bench, jobs, executor, partial(tell, len(tests)), read))
    usual = next(rows)
    variants = list(islice(rows, len(_variants(bench))))
    typical = list(islice(rows, len(lines)))
    simulated = np.concatenate(list(rows)).reshape(len(machines), len(tests), -1)
    machine = np.array([read(bench, trace, test) for test, trace in whole])
    at = [tests.index(dict(test)) for test, _ in whole]
    names = _Names.of(bench, whole, nominal[0], widths)
    each = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of cells into which no rollout reaches
        for own in simulated:
            changes = [changed - usual[[once]] for changed in typical]
            size, surplus = channels.left_over(
                machine, own[at], usual, own[few] - usual, changes, [v - usual for v in variants], cells.cells
            )
            each.append(_largest(cells.cells, np.isfinite(machine).any(axis=0), size, surplus, names))
    found = min(each, key=lambda largest: max((one.surplus for one in largest), default=0.0))
    return ordered([_with_times(one, [trace for _, trace in whole]) for one in found])


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
class _Names:
    """What quantities and their columns are called.

    Attributes:
        units: quantity → unit.
        parts: (quantity, column) → the part of the machine that it is of, or its number; "" where there is but one.
    """

    units: Mapping[str, str]
    parts: Mapping[tuple[str, int], str]

    @classmethod
    def of(
        cls,
        bench: Bench,
        rollouts: Sequence[tuple[Test, Trace]],
        nominal: tuple[Test, Trace],
        widths: Mapping[str, int],
    ) -> _Names:
        """Read units of channels in recordings, and all of residuals in a nominal rollout, which has them."""
        units = {name: unit for _, trace in rollouts for name, unit in trace.units.items()}
        of = columns(bench.backend.channels, widths)
        own = {n.removeprefix(RESIDUAL): width for n, width in widths.items() if n.startswith(RESIDUAL)}
        if own and isinstance(bench.backend, HasResiduals):
            found = bench.backend.residuals(nominal[1], bench.matched.to_backend(nominal[0]))
            units |= {RESIDUAL + name: unit for name, unit in found.units.items()}
            of |= {(RESIDUAL + name, column): part for (name, column), part in parts(found, own).items()}
        return cls(units, of)


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
    cells: Cells, known: NDArray[np.bool_], size: FloatArray, surplus: FloatArray, names: _Names
) -> list[Remainder]:
    """Return the cell of the largest surplus of every column, the :data:`REPORTED` largest of these.

    Args:
        cells: where they are.
        known: (cells,) whether any rollout has a value there.
        size: (cells,) what is left.
        surplus: (cells,) that in units of what is allowed for.
        names: of quantities and columns.
    """
    places = cells.places()
    residual = np.array([name.startswith(RESIDUAL) for name, *_ in places])
    shown = (residual & known).any()
    surplus = channels.begin(places, np.where(residual | ~shown, 1.0, channels.BESIDE) * surplus)
    out: dict[tuple[str, int], Remainder] = {}
    for k in np.argsort(-surplus, kind="stable"):
        name, column, along, low, high = places[k]
        if len(out) == REPORTED or surplus[k] <= 0.0:
            break
        if (name, column) in out:
            continue
        out[name, column] = Remainder(
            name.removeprefix(RESIDUAL),
            column,
            names.parts[name, column],
            along,
            low,
            high,
            float(size[k]),
            names.units.get(name, ""),
            names.units.get(along, "") if along else "s",
            float(surplus[k]),
            recorded=not name.startswith(RESIDUAL),
        )
    return list(out.values())
