"""Real rollouts, checked and converted to the channels, units and duration of the simulator.

Data: traces of tests of the specification, with tests in the spec's units, and traces of protocols, with parameters in
the protocol's units. A trace gets the simulator's units, and ends with the simulator's. Samples that are not finite
become NaN. Bad input gets one sentence with its recording, its channel and its unit.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from s2r_spec.backend import Backend, HasRecordings, Recording
from s2r_spec.backend.protocols import PROTOCOL, protocol_of
from s2r_spec.base.errors import SamplingError, TraceError, UsageError
from s2r_spec.diagnose.data.protocols import canonical
from s2r_spec.diagnose.simulator.bench import Bench, TestRun, name_rollout
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.lang.conversion import Conversion
from s2r_spec.lang.units import UnknownUnitError, parse_unit, unit_in_log
from s2r_spec.recordings.recorded import refuse_hidden, refuse_unstated_times, tests_of
from s2r_spec.runs.compatibility import check_compatibility
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace
from s2r_spec.trace.samples import Rule, period_of

Rollouts = Iterable[tuple[Mapping[str, float], Trace]]

CUT = "cut at"
"""In the metadata of a recording of which only the begin is used: until when [s]."""
READ_AT = "read at samples apart"
"""In the metadata of a recording between whose samples the spec's times fall: how far apart they are now [s]."""
TIMES = {1.0: "s", 1e3: "ms", 1e6: "us", 1e9: "ns"}
"""Definition: units of time, by their number in a second."""
FEWEST = 6
"""Budget: real rollouts that a diagnosis needs."""


@dataclass(frozen=True)
class RealRollouts:
    """Real rollouts in the simulator's channels, units and duration.

    Attributes:
        tests: (test in the spec's units, trace) of each.
        protocols: (experiment, trace) of each run of a protocol.
        notes: a sentence for each kind of run that is not used, or that ended a protocol.
    """

    tests: tuple[TestRun, ...] = ()
    protocols: tuple[tuple[Experiment, Trace], ...] = ()
    notes: tuple[str, ...] = ()

    def plus(self, bench: Bench, run: Recording) -> RealRollouts:
        """Return these and one more; see :func:`comparable_trace`."""
        trace = comparable_trace(bench, run)
        if run.protocol:
            return replace(self, protocols=(*self.protocols, (experiment_of(bench, run), trace)))
        return replace(self, tests=(*self.tests, (dict(run.params), trace)))

    def by_experiment(self, bench: Bench) -> dict[Experiment, list[Trace]]:
        """Return experiment → traces, with the tests in the simulator's units."""
        traces: dict[Experiment, list[Trace]] = {}
        for test, trace in self.tests:
            traces.setdefault(as_experiment(bench, test), []).append(trace)
        for experiment, trace in self.protocols:
            traces.setdefault(experiment, []).append(trace)
        return traces


def as_experiment(bench: Bench, test: Mapping[str, float]) -> Experiment:
    """Return the experiment of a test in the spec's units."""
    return Experiment.test(bench.matched.to_backend(test))


def experiment_of(bench: Bench, run: Recording) -> Experiment:
    """Return the experiment of a recording; values of its row come before those of ``meta["params"]``.

    Raises:
        UsageError: the simulator does not have the protocol or a parameter, or a value is out of range.
    """
    if not run.protocol:
        return as_experiment(bench, run.params)
    protocol = protocol_of(bench.backend, run.protocol)
    of_tests = {p.name for p in bench.backend.parameters} - {p.name for p in protocol.parameters}
    meta = run.trace.meta.get("params")
    values = {**(meta if isinstance(meta, Mapping) else {}), **run.params}
    return canonical(protocol, {name: value for name, value in values.items() if name not in of_tests})


def recorded_rollouts(
    bench: Bench, real: Rollouts | Backend, budget: int | None = None, passive: bool = False
) -> RealRollouts:
    """Return recorded rollouts; a run of a protocol that the simulator does not have becomes a note.

    The params of a test are in the spec's units; a trace with ``meta["protocol"]`` is a run of a protocol. Of a larger
    number than the budget the first are used.

    Raises:
        UsageError: a test lacks a parameter, or is outside the spec's ranges; there are fewer than six rollouts; a
        channel
            is in a unit that does not convert; ρ cannot be evaluated; times are not in seconds; or an undeclared
            parameter of the simulator varies.
    """
    others = 0
    if not isinstance(real, Backend):
        recordings = _of_pairs(real)
    elif isinstance(real, HasRecordings):
        recordings = _of_backend(bench, real)
        others = len(real.recordings) - len(recordings)
    else:
        raise UsageError(f"{real.name} has no recordings")
    recordings = [run for run in recordings if not (passive and run.protocol)]
    joined = sum(bool(run.trace.messages) for run in recordings)
    recordings = [replace(run, trace=run.trace.at_busiest().known()) for run in recordings]
    # A test outside the space is refused before any simulation.
    used = [run if run.protocol else _clip_to_ranges(bench, run) for run in recordings[:budget]]
    rollouts, left_out = RealRollouts(), Counter[str]()
    for run in used:
        try:
            experiment_of(bench, run)
        except UsageError as error:
            left_out[f"of the protocol {run.protocol!r} not used: {error}"] += 1
        else:
            rollouts = rollouts.plus(bench, run)
    if (count := len(rollouts.tests) + len(rollouts.protocols)) < FEWEST:
        raise UsageError(
            f"{count} real rollouts are too few to separate a cause from scatter; at least {FEWEST} are needed"
        )
    notes = [f"{count} run{'s' if count > 1 else ''} {what}" for what, count in left_out.items()]
    if len(used) < len(recordings):
        notes.append(
            f"only the first {len(used)} of {len(recordings)} recorded rollouts were used, because of the budget"
        )
    if joined:
        notes.append(f"{joined} logs of several topics are read at the stamps of the busiest one")
    if others:
        fixed = ", ".join(bench.matched.fixed)
        notes.append(
            f"{others} recorded rollouts were not used: they have another value of {fixed} than the spec"
        )
    return replace(rollouts, notes=tuple(notes))


def recorded_inputs(
    spec: Spec, requirement: str, simulator: Backend, real: Rollouts | Backend
) -> tuple[tuple[dict[str, float], Trace], ...]:
    """Return (test in the spec's units, recording in the simulator's channels and units) of every recorded test.

    Raises:
        UsageError: the real rollouts are not recorded, or a channel's unit does not convert.
    """
    if isinstance(real, HasRecordings) and isinstance(real, Backend):
        matched = check_compatibility(spec, requirement, real)
        pairs = [(matched.to_spec(run.params), run.trace) for run in real.recordings if not run.protocol]
    elif isinstance(real, Backend):
        raise UsageError(f"{real.name} has no recordings, so there are no commands to play")
    else:
        pairs = [(dict(run.params), run.trace) for run in _of_pairs(real) if not run.protocol]
    return tuple(
        (dict(test), convert_units(trace.at_busiest().known(), simulator))
        for test, trace in pairs
        if test is not None
    )


def _of_backend(bench: Bench, real: Backend) -> list[Recording]:
    assert isinstance(real, HasRecordings)
    matched = check_compatibility(bench.spec, bench.requirement, real)
    pairs = [(run, run.params if run.protocol else matched.to_spec(run.params)) for run in real.recordings]
    used = [run for run, params in pairs if params is not None]
    refuse_hidden(bench.spec, real, tests_of(used), {p.name for p in bench.backend.parameters})
    refuse_unstated_times(bench.spec, bench.requirement, real, tests_of(used))
    return [replace(run, params=params) for run, params in pairs if params is not None]


def _of_pairs(real: Rollouts) -> list[Recording]:
    recordings = []
    for n, item in enumerate(real):
        if not (isinstance(item, tuple | list) and len(item) == 2 and isinstance(item[1], Trace)):
            raise UsageError(f"real rollouts are (params, Trace) pairs, not {type(item).__name__}")
        params = {name: float(value) for name, value in item[0].items()}
        recordings.append(
            Recording(f"real rollout {n}", params, item[1], str(item[1].meta.get(PROTOCOL) or ""))
        )
    return recordings


def _clip_to_ranges(bench: Bench, run: Recording) -> Recording:
    """Return a recording with its test within the spec's ranges."""
    space = bench.spec.space
    if missing := [name for name in space.names if name not in run.params]:
        raise UsageError(
            f"{run.source} has no value of {missing[0]!r}; every test parameter of the spec needs one"
        )
    try:
        test = space.point(space.vector({name: run.params[name] for name in space.names}))
    except UsageError as error:
        raise UsageError(f"{run.source}: {error}; leave it out, or widen the spec's range") from None
    return replace(run, params=test)


def comparable_trace(bench: Bench, run: Recording) -> Trace:
    """Return the trace of a test, or of a protocol, in the simulator's units until the simulator's end.

    Where a window of the spec is shorter than the time between samples of a test, it gets the simulator's period.

    Raises:
        UsageError: times are not in seconds, a channel's unit does not convert, or ρ of a test cannot be evaluated.
    """
    of = protocol_of(bench.backend, run.protocol) if run.protocol else bench.backend
    longer = run.trace.duration / of.duration
    if (unit := _unit(longer)) != "s" and _unit(period_of(run.trace.times) / _period(bench, run)) != "s":
        raise UsageError(
            f"{run.source} lasts {run.trace.duration:.4g} s, {longer:.3g} times as long as a rollout of the simulator. "
            f"Its times seem to be in {unit}; convert them to s"
        )
    trace = truncate(convert_units(run.trace, bench.backend), of.duration)
    if run.protocol:
        return trace
    horizon = bench.spec.horizon(bench.requirement)
    try:
        try:
            bench.rho(trace, run.params)
        except SamplingError:
            trace = read_at(trace, _period(bench, run), horizon)
            bench.rho(trace, run.params)
        return trace
    except TraceError as error:
        what, why = str(error), str(error).partition(";")[0]
        if "is NaN" in why:
            what = f"{why}; fill in the missing samples, or leave the rollout out"
        elif run.trace.duration < horizon < math.inf:
            what = f"{why}; leave it out, or, if the machine fell, set 'failure' in the trace's metadata"
        raise UsageError(f"{run.source}: {what}") from None


def _unit(times: float) -> str:
    return TIMES[min(TIMES, key=lambda known: abs(math.log(max(times, 1e-9) / known)))]


def _period(bench: Bench, run: Recording) -> float:
    experiment = experiment_of(bench, run)
    with name_rollout(bench, {}, dict(experiment.params), 0):
        return period_of(experiment.run(bench.backend, 0).times)


def read_at(trace: Trace, period: float, until: float = 0.0) -> Trace:
    """Return the trace from t = 0 on, at samples ``period`` [s] apart: linear between its own; flags hold.

    One that ends less than one of its own periods before ``until`` [s] keeps its last values until then.
    """
    own = trace.shift(-trace.times[0])
    if own.times[-1] < until < 2.0 * own.times[-1] - own.times[-2]:
        channels = {name: np.concatenate([x, x[-1:]]) for name, x in own.channels.items()}
        own = Trace(np.append(own.times, until), channels, own.units)
    rules: dict[str, Rule] = {
        name: "hold" if np.isin(x[np.isfinite(x)], (0.0, 1.0)).all() else "linear"
        for name, x in own.channels.items()
    }
    return replace(own.resample(period, rules), meta=dict(trace.meta) | {READ_AT: period})


def truncate(trace: Trace, duration: float) -> Trace:
    """Return the first ``duration`` seconds of a trace; one that failed stays as it is."""
    # The last sample must not fall out by rounding, nor is one sample more a longer recording.
    period = trace.duration / max(len(trace) - 1, 1)
    if trace.failure is not None or trace.duration <= duration + 1.5 * period:
        return trace
    first = float(trace.times[0])
    kept = trace.between(first, first + duration + 0.5 * period)
    return replace(kept, meta=dict(trace.meta) | {CUT: duration})


def convert_units(trace: Trace, simulator: Backend) -> Trace:
    """Return the trace with every channel in the simulator's unit, and NaN for values that are not finite.

    A channel without a unit is taken to be in the simulator's.

    Raises:
        UsageError: a unit of the trace does not convert, or is none.
    """
    channels, units = dict(trace.channels), dict(trace.units)
    for name, unit in ((c.name, c.unit) for c in simulator.channels if c.name in channels):
        if units.get(name) and unit and units[name] != unit:
            conversion = _conversion(name, units[name], unit, simulator.name)
            channels[name], units[name] = conversion.each(channels[name]), unit
        finite = np.isfinite(channels[name])
        channels[name] = channels[name] if finite.all() else np.where(finite, channels[name], np.nan)
    return replace(trace, channels=channels, units=units)


def _conversion(name: str, recorded: str, unit: str, simulator: str) -> Conversion:
    try:
        here = parse_unit(unit)
        there = unit_in_log(recorded, here)
    except UnknownUnitError as error:
        raise UsageError(
            f"the channel {name!r} is recorded in {recorded!r}, and s2r does not know the unit {error}"
        ) from None
    if not here.fits(there):
        raise UsageError(
            f"the channel {name!r} is recorded in {recorded}, which does not convert to the {unit} of backend "
            f"{simulator!r}. "
            f"{there.two_readings(here) or 'Correct the unit in the recording, or leave the channel out'}"
        )
    return there.to(here)
