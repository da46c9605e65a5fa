"""Real rollouts for a diagnosis: from a folder of recordings, or asked of a machine, each on disk before the next."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec import logs
from s2r_spec.backend import Backend, HasDuration, HasRecordings, is_exclusive, load_backend
from s2r_spec.diagnose.notes import CUT, READ_AT
from s2r_spec.diagnose.simulate import Bench, Test, blamed
from s2r_spec.errors import SamplingError, TraceError, UsageError
from s2r_spec.lang.units import UnknownUnitError, parse_unit
from s2r_spec.rollouts.compatibility import check_compatibility
from s2r_spec.rollouts.recorded import refuse_hidden, tests_of
from s2r_spec.rollouts.seeds import Stream, rollout_seed
from s2r_spec.trace import Trace, between

FloatArray = NDArray[np.float64]
Rollout = tuple[dict[str, float], Trace]
Rollouts = Sequence[tuple[Mapping[str, float], Trace]]

TABLE = "rollouts.csv"
TIMES = {1e3: "ms", 1e6: "us", 1e9: "ns"}
"""Units of time, by how many there are to a second."""
LONG, APART = 100.0, 30.0
"""A recording has its times in one of these if it lasts so many times as long as the simulator's rollouts, with samples
so many times as far apart."""
BUDGET = 30
"""Real rollouts that are asked of a machine when nobody says how many."""
FEWEST = 6
DISTINCT = 0.6
"""Part of the budget that goes to distinct tests; the rest repeats the first of them."""


def real_rollouts(
    bench: Bench,
    real: Rollouts | Backend | str,
    budget: int | None,
    seed: int,
    folder: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Rollout]:
    """Return (test in the spec's units, trace with channels in the simulator's) of every real rollout.

    Raises:
        UsageError: a rollout does not say its test, or that is outside the spec's ranges, or there are fewer
            than six, or a channel is in a unit that does not convert, or ρ cannot be told of a rollout, or its times
            are no seconds, or a parameter varies that the simulator has and the spec does not declare.
    """
    names = bench.spec.space.names
    if isinstance(real, str):
        real = load_backend(real)
    if isinstance(real, HasRecordings) and isinstance(real, Backend):
        matched = check_compatibility(bench.spec, bench.requirement, real)
        simulated = {parameter.name for parameter in bench.backend.parameters}
        pairs = [
            (test, r) for r in tests_of(real.recordings) if (test := matched.to_spec(r.params)) is not None
        ]
        refuse_hidden(bench.spec, real, [recording for _, recording in pairs], simulated)
        given = [(dict(test), r.trace, str(r.source)) for test, r in pairs]
    elif isinstance(real, Backend):
        ran = ask(bench, real, BUDGET if budget is None else budget, seed, folder, progress)
        given = [(test, trace, f"real rollout {n}") for n, (test, trace) in enumerate(ran)]
    else:
        given = [
            ({name: float(value) for name, value in params.items()}, trace, f"real rollout {n}")
            for n, (params, trace) in enumerate(_items(real))
        ]
    for test, _, source in given:
        if missing := [name for name in names if name not in test]:
            raise UsageError(
                f"{source} has no value of {missing[0]!r}; every test parameter of the spec needs one"
            )
    # A test outside of the space is refused now, and not when all is simulated.
    inside = [(_inside(bench, test, source), trace, source) for test, trace, source in given[:budget]]
    for test, trace, source in inside:
        _in_seconds(bench, test, trace, source)
    found = [
        (
            test,
            cut(_decided(bench, test, as_simulated(trace, bench.backend), source), bench.backend.duration),
        )
        for test, trace, source in inside
    ]
    if len(found) < FEWEST:
        raise UsageError(
            f"{len(found)} real rollouts are too few to separate a cause from scatter; at least {FEWEST} are needed"
        )
    return found


def _in_seconds(bench: Bench, test: Test, trace: Trace, source: str) -> None:
    """Refuse times that are no seconds.

    Raises:
        UsageError: the recording is far too long, and its samples far apart.
    """
    times = trace.duration / bench.backend.duration
    if times < LONG or float(np.median(np.diff(trace.times))) < APART * _step(bench, test):
        return
    unit = TIMES[min(TIMES, key=lambda known: abs(math.log(times / known)))]
    raise UsageError(
        f"{source} lasts {trace.duration:.4g} s, {times:.3g} times as long as a rollout of the simulator. "
        f"Its times seem to be in {unit}; convert them to s"
    )


def read_at(trace: Trace, step: float, until: float = 0.0) -> Trace:
    """Return the trace on samples ``step`` seconds apart: straight lines between its own; of a flag the last one.

    One that ends less than one of its own periods before ``until`` [s] keeps its last values until then.
    """
    own = trace.times - trace.times[0]
    end = until if own[-1] < until < 2.0 * own[-1] - own[-2] else own[-1]
    # As many as there are periods, not one less by a rounding.
    times = step * np.arange(math.floor(end / step * (1.0 + 1e-9)) + 1)
    before = np.clip(np.searchsorted(own, times * (1.0 + 1e-9), "right") - 1, 0, len(own) - 1)

    def read(values: FloatArray) -> FloatArray:
        flag = np.isin(values[np.isfinite(values)], (0.0, 1.0)).all()
        return values[before] if flag else between(times, own, values)

    channels = {name: read(np.asarray(values, dtype=np.float64)) for name, values in trace.channels.items()}
    return Trace(times, channels, trace.units, dict(trace.meta) | {READ_AT: step})


def cut(trace: Trace, duration: float) -> Trace:
    """Return what a trace has of its first ``duration`` seconds: what comes after has no like in the simulator.

    One that failed stays as it is, for when it failed is part of what it says.
    """
    since = trace.times - trace.times[0]
    # A sample's own time must not fall out by a rounding, nor one sample more be a longer recording.
    step = trace.duration / max(len(trace) - 1, 1)
    kept = since <= duration + 0.5 * step
    if trace.failure is not None or since[-1] <= duration + 1.5 * step:
        return trace
    return Trace(
        trace.times[kept],
        {name: values[kept] for name, values in trace.channels.items()},
        trace.units,
        dict(trace.meta) | {CUT: duration},
    )


def as_simulated(trace: Trace, simulator: Backend) -> Trace:
    """Return the trace with every channel in the unit that the simulator has for it, and NaN for what is no number.

    A channel without a unit is taken to be in the simulator's.

    Raises:
        UsageError: a unit of the trace does not convert, or is none.
    """
    channels, units = dict(trace.channels), dict(trace.units)
    for channel in simulator.channels:
        name, recorded = channel.name, units.get(channel.name, "")
        if name not in channels:
            continue
        values = channels[name]
        if recorded and channel.unit and recorded != channel.unit:
            values = _converted(values, name, recorded, channel.unit, simulator.name)
            units[name] = channel.unit
        channels[name] = (
            values if np.isfinite(values).all() else np.where(np.isfinite(values), values, np.nan)
        )
    return replace(trace, channels=channels, units=units)


def _converted(values: FloatArray, name: str, recorded: str, wanted: str, simulator: str) -> FloatArray:
    try:
        there, here = parse_unit(recorded), parse_unit(wanted)
    except UnknownUnitError as error:
        raise UsageError(
            f"the channel {name!r} is recorded in {recorded!r}, and s2r does not know the unit {error}"
        ) from None
    if not here.fits(there):
        raise UsageError(
            f"the channel {name!r} is recorded in {recorded}, which does not convert to the {wanted} of backend "
            f"{simulator!r}. Correct the unit in the recording, or leave the channel out"
        )
    factor, offset = there.to(here)
    return values if (factor, offset) == (1.0, 0.0) else factor * values + offset


def _inside(bench: Bench, test: Mapping[str, float], source: str) -> dict[str, float]:
    """Return the test within the spec's ranges.

    Raises:
        UsageError: it is outside; the sentence says of which recording, or rollout.
    """
    space = bench.spec.space
    try:
        return space.point(space.vector({name: test[name] for name in space.names}))
    except UsageError as error:
        raise UsageError(f"{source}: {error}; leave it out, or widen the spec's range") from None


def _decided(bench: Bench, test: Mapping[str, float], trace: Trace, source: str) -> Trace:
    """Return a trace that decides ρ: where a window is shorter than the time between samples, at the simulator's.

    Raises:
        UsageError: it cannot; the sentence says of which recording, or rollout.
    """
    try:
        try:
            bench.rho(trace, test)
            return trace
        except SamplingError:
            read = read_at(trace, _step(bench, test), bench.spec.horizon(bench.requirement))
            bench.rho(read, test)
            return read
    except TraceError as error:
        why = str(error).partition(";")[0]
        horizon = bench.spec.horizon(bench.requirement)
        if "is NaN" in why:
            what = f"{why}; fill in the missing samples, or leave the rollout out"
        elif trace.duration < horizon < math.inf:
            what = f"{why}; leave it out, or, if the machine fell, set 'failure' in the trace's metadata"
        else:
            what = str(error)
        raise UsageError(f"{source}: {what}") from None


def _step(bench: Bench, test: Test) -> float:
    """Return how far apart the simulator's samples are [s]."""
    with blamed(bench, {}, test, 0):
        simulated = bench.run({}, test, 0)
    return float(np.median(np.diff(simulated.times)))


def _items(real: Iterable[Any]) -> Iterable[tuple[Mapping[str, float], Trace]]:
    for item in real:
        if not (isinstance(item, tuple | list) and len(item) == 2 and isinstance(item[1], Trace)):
            raise UsageError(f"real rollouts are (params, Trace) pairs, not {type(item).__name__}")
        yield item[0], item[1]


def refuse_machine(backend: object) -> None:
    """Refuse a machine whose rollouts need an operator: a diagnosis is of those that are recorded.

    Raises:
        UsageError: it is one.
    """
    if is_exclusive(backend):
        name = getattr(backend, "name", "this backend")
        raise UsageError(
            f"{name} is a machine, and its rollouts need an operator; diagnose its recordings with --real log:FOLDER"
        )


def plan(bench: Bench, budget: int, seed: int) -> list[tuple[int, dict[str, float]]]:
    """Return (place, test) of each rollout: tests that fill the space evenly, the first of them three times."""
    from scipy.stats import qmc

    space = bench.spec.space
    distinct = max(min(FEWEST, budget), round(budget * DISTINCT)) if space.dim else 1
    points = np.zeros((distinct, 0))
    if space.dim:
        power = max(distinct - 1, 1).bit_length()
        points = qmc.Sobol(space.dim, scramble=True, rng=seed).random_base2(power)[:distinct]
    tests = [space.point(p) for p in space.at(points)]
    places = [i if i < distinct else (i - distinct) // 2 % distinct for i in range(budget)]
    return [(place, tests[place]) for place in places]


def ask(
    bench: Bench,
    machine: Backend,
    budget: int,
    seed: int,
    folder: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Rollout]:
    """Run the planned tests on a machine; what the folder already holds is not run again.

    The folder has the form that ``log:FOLDER`` reads.

    Raises:
        UsageError: what it holds are rollouts of other tests than those planned, or the machine needs an operator.
    """
    refuse_machine(machine)
    if isinstance(machine, HasDuration):
        machine = machine.with_duration(bench.backend.duration)
    matched = check_compatibility(bench.spec, bench.requirement, machine)
    units = {p.name: p.unit for p in machine.parameters}
    rows = {} if folder is None else _rows(folder / TABLE)
    out: list[Rollout] = []
    for i, (place, test) in enumerate(plan(bench, budget, seed)):
        params = matched.to_backend(test)
        name = f"{i:04d}"
        kept = None if folder is None else folder / f"{name}.npz"
        if kept is not None and kept.exists():
            _same(kept, rows.get(name), params)
            trace = logs.read(kept)
        else:
            trace = machine.rollout(params, rollout_seed(seed, place, i, Stream.GAP_REAL))
            if kept is not None:
                _keep(kept, trace)
        if folder is not None and name not in rows:
            # Of a run that was killed between trace and row the row is still to be written.
            _note(folder / TABLE, name, params, units)
        out.append((test, trace))
        if progress is not None:
            progress(i + 1, budget)
    return out


def _rows(table: Path) -> dict[str, dict[str, float]]:
    """Return name of a kept rollout → its params.

    Raises:
        UsageError: a row is not whole.
    """
    if not table.exists():
        return {}
    found = {}
    with table.open(newline="", encoding="utf-8") as stream:
        reader = csv.DictReader(stream)
        for row in reader:
            try:
                name = row.pop("id")
                found[name] = {column.partition(" [")[0]: float(value) for column, value in row.items()}
            except (KeyError, TypeError, ValueError):
                raise UsageError(
                    f"{table}:{reader.line_num}: this row is incomplete; delete it, and s2r writes it again from the "
                    f"kept trace"
                ) from None
    return found


def _same(kept: Path, recorded: Mapping[str, float] | None, params: Mapping[str, float]) -> None:
    """Refuse a kept rollout of another test: another budget, seed or spec plans other ones."""
    if recorded is None:
        return
    if recorded.keys() != params.keys() or not all(
        math.isclose(recorded[name], value, rel_tol=1e-9, abs_tol=1e-12) for name, value in params.items()
    ):
        there, here = (
            ", ".join(f"{name} = {value:.4g}" for name, value in of.items()) or "no parameter"
            for of in (recorded, params)
        )
        raise UsageError(
            f"{kept} was recorded with {there}, but this run plans {here} in its place. Use the spec, budget and "
            f"seed of the first run, or diagnose its recordings with --real log:{kept.parent}"
        )


def _keep(path: Path, trace: Trace) -> None:
    """Put a trace on disk, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part.npz")
    logs.write(trace, part)
    part.replace(path)


def _note(table: Path, name: str, params: Mapping[str, float], units: Mapping[str, str]) -> None:
    """Put a rollout's row on disk: after its trace, so that a row always has one."""
    new = not table.exists()
    with table.open("a", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        if new:
            writer.writerow(["id", *(f"{n} [{units[n]}]" if units.get(n) else n for n in params)])
        writer.writerow([name, *(repr(float(v)) for v in params.values())])
        stream.flush()
        os.fsync(stream.fileno())
