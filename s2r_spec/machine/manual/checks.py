"""Check that a log belongs to the requested test. Each check returns the reason for a refusal, or None.

Data: the trace as read, the parameters of the test, and the channels of the specification. The checks are pure and run
in the order of :data:`CHECKS`; a check may rely on the ones before it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Channel, Needs, Parameter
from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import S2RError, one_of, suggest
from s2r_spec.lang.conversion import Conversion
from s2r_spec.lang.units import UnknownUnitError, parse_unit, unit_in_log
from s2r_spec.trace import Trace

COMMANDS = ("{}_cmd", "cmd_{}", "{}_command", "{}_des", "{}_ref")
"""Definition: names of a quantity's command in a log; a column with another name is mapped to ``<parameter>_cmd``."""
COMMANDED = {"vd": ("v", "vx")}
"""Definition: parameter → quantities that it commands, as named in our specs for walking robots."""
SAME_TEST = 0.01
"""Tolerance: difference between the test in a log and the requested one, as a share of the parameter's range. It is
above the rounding of any interface."""
FEWEST = 10
"""Tolerance: samples within the horizon. A log with fewer samples and a far too long duration has its times in another
unit."""
FAR_TOO_LONG = 100.0
"""Tolerance: duration of a log, in horizons. Milliseconds read as seconds make a log 1000 times too long."""
GAP = 0.05
"""Tolerance: longest gap between samples, as a share of the horizon."""
WANDERS = 0.05
"""Tolerance: deviation of a command after it reached the test, as a share of the parameter's range. It is above the
noise of a measured command."""
STEPS = 10.0
"""Tolerance: shortest gap, in median sampling periods, so that a slow logger has none."""


@dataclass(frozen=True)
class RequestedTest:
    """The test that s2r requested, in the units of the spec.

    ``seconds`` is the horizon of the spec [s]; 0 if it reads a trace to its end.
    """

    params: Mapping[str, float]
    needs: Needs
    seconds: float


def refusal(trace: Trace, test: RequestedTest) -> str | None:
    """Return why a trace is not the log of a test; None if it passes all checks.

    The samples of a failed trace do not count, so only its test is checked.
    """
    checks = OF_FAILURES if trace.failure is not None else CHECKS
    return next((reason for check in checks if (reason := check(trace, test)) is not None), None)


def stated_test(trace: Trace, test: RequestedTest) -> str | None:
    """Refuse a log that states another test in ``meta["params"]``."""
    stated = trace.meta.get("params")
    for name, value in stated.items() if isinstance(stated, Mapping) else ():
        parameter = next((p for p in test.needs.parameters if p.name == name), None)
        if parameter is None or not isinstance(value, int | float):
            continue
        requested = test.params[name]
        if not abs(value - requested) <= _tolerance(parameter, requested):
            unit = _unit(parameter.unit)
            return f"its params state {name} = {value:g}{unit}, but the test has {name} = {requested:g}{unit}"
    return None


def channels(trace: Trace, test: RequestedTest) -> str | None:
    """Refuse a log that lacks a channel of the spec, or has it with another width or an incompatible unit."""
    for channel in test.needs.channels:
        if channel.name not in trace.channels:
            return (
                f"it has no channel {channel.name!r}{suggest(channel.name, trace.channels)} it has "
                f"{one_of(trace.channels)}; map another name with manual:FOLDER?map={channel.name}=NAME"
            )
        width = math.prod(trace[channel.name].shape[1:])
        if width != channel.width:
            return (
                f"its channel {channel.name!r} has {width} components, and the spec declares {channel.width}"
            )
        if (wrong := _unit_fault(channel.name, trace.units.get(channel.name), channel.unit)) is not None:
            return wrong
    return None


def clock(trace: Trace, test: RequestedTest) -> str | None:
    """Refuse times in another unit: the log is far too long, and has few samples within the horizon."""
    if test.seconds <= 0 or len(trace) < 2:
        return None
    within = int(np.searchsorted(trace.times - trace.times[0], test.seconds, side="right"))
    if trace.duration > FAR_TOO_LONG * test.seconds and within < FEWEST:
        step = float(np.median(np.diff(trace.times)))
        return (
            f"its clock is wrong: it lasts {trace.duration:g} s with a sample every {step:g} s, the test only "
            f"{test.seconds:g} s; read times in ms with manual:FOLDER?time-unit=ms"
        )
    return None


def length(trace: Trace, test: RequestedTest) -> str | None:
    """Refuse a log that is shorter than the horizon by more than one sampling period."""
    step = float(np.median(np.diff(trace.times))) if len(trace) > 1 else 0.0
    if trace.duration + step * (1 + 1e-6) < test.seconds:
        return (
            f"it is too short: it lasts {trace.duration:.4g} s, and the spec looks {test.seconds:g} s ahead"
        )
    return None


def gaps(trace: Trace, test: RequestedTest) -> str | None:
    """Refuse a log with a long gap between samples within the horizon."""
    counted = _in_horizon(trace, test.seconds)
    steps = np.diff(trace.times[counted])
    if not len(steps):
        return None
    longest = int(np.argmax(steps))
    span = test.seconds or trace.duration
    if steps[longest] > max(STEPS * float(np.median(steps)), GAP * span):
        since = float(trace.times[longest] - trace.times[0])
        return f"it has no sample for {steps[longest]:.3g} s, from {since:.4g} s after its beginning"
    return None


def samples(trace: Trace, test: RequestedTest) -> str | None:
    """Refuse a log in which a channel of the spec lacks a sample."""
    for channel in test.needs.channels:
        lacking = np.isnan(trace[channel.name]).reshape(len(trace), -1).any(axis=1)
        if lacking.any():
            at = float(trace.times[int(np.argmax(lacking))] - trace.times[0])
            return (
                f"its channel {channel.name!r} has no value {at:.4g} s after its beginning; take the sample before it "
                f"with manual:FOLDER?nan=hold"
            )
    return None


def commands(trace: Trace, test: RequestedTest) -> str | None:
    """Refuse a log whose recorded command differs from the test.

    The median within the horizon is compared, which a ramp at the beginning changes little. After the command has
    reached the test it must stay there: an operator who releases the stick runs another test.
    """
    counted = _in_horizon(trace, test.seconds)
    for parameter in test.needs.parameters:
        for name in _commands_of(parameter.name, trace, counted):
            unit = trace.units.get(name)
            if (wrong := _unit_fault(name, unit, parameter.unit)) is not None:
                return wrong
            finite = counted & np.isfinite(trace[name].reshape(-1))
            if not finite.any():
                continue
            values = _conversion(unit, parameter.unit).each(trace[name].reshape(-1)[finite])
            median, requested = float(np.median(values)), test.params[parameter.name]
            shown = _unit(parameter.unit)
            expected = f"but the test has {parameter.name} = {requested:.4g}{shown}"
            if abs(median - requested) > _tolerance(parameter, requested):
                return f"its command {name} is {median:.4g}{shown}, {expected}"
            if trace.failure is not None:  # an operator releases the stick when the robot falls
                continue
            since = trace.times[finite] - trace.times[0]
            tolerance = _tolerance(parameter, requested) * WANDERS / SAME_TEST
            for first, level in _departures(values, requested, tolerance):
                return f"its command {name} is {level:.4g}{shown} from {since[first]:.4g} s on, {expected}"
    return None


def _departures(values: FloatArray, requested: float, tolerance: float) -> Iterator[tuple[int, float]]:
    """Yield (index, level) of each piece in which a command has left the test after it reached it.

    Each piece lasts a share ``GAP`` of the horizon, and its level is a median, because single samples may be noise.
    """
    reached = False
    for piece in np.array_split(np.arange(len(values)), min(len(values), round(1 / GAP))):
        level = float(np.median(values[piece]))
        if abs(level - requested) <= tolerance:
            reached = True
        elif reached:
            yield int(piece[0]), level


def within_horizon(trace: Trace, seconds: float) -> Trace:
    """Return the part of a trace within the horizon [s]; all of it if ``seconds`` is 0."""
    return trace.between(trace.times[0], trace.times[0] + (seconds or math.inf))


def _in_horizon(trace: Trace, seconds: float) -> NDArray[np.bool_]:
    counted: NDArray[np.bool_] = trace.times - trace.times[0] <= (seconds or math.inf)
    return counted


def _commands_of(parameter: str, trace: Trace, counted: NDArray[np.bool_]) -> list[str]:
    """Return the channels that hold the command of a parameter.

    A channel with the parameter's own name, such as ``wz``, may be a measurement; it is a command if it is constant.
    """
    quantities = (parameter, *COMMANDED.get(parameter, ()))
    names = [form.format(quantity) for quantity in quantities for form in COMMANDS]
    if parameter in trace.channels and len(np.unique(trace[parameter][counted])) == 1:
        names.append(parameter)
    return [name for name in names if name in trace.channels and trace[name].size == len(trace)]


def score(trace: Trace, test: RequestedTest) -> str | None:
    """Refuse a log for which the spec gives no robustness: it would end the run."""
    try:
        rho = test.needs.score(_in_units(trace, test.needs.channels), test.params)
    except S2RError as error:
        return f"the spec gives it no robustness: {error}"
    return None if math.isfinite(rho) else f"the spec gives it no robustness: the result is {rho}"


Check = Callable[[Trace, RequestedTest], str | None]
OF_FAILURES: tuple[Check, ...] = (stated_test, commands)
CHECKS: tuple[Check, ...] = (stated_test, channels, clock, length, commands, gaps, samples, score)


def in_common_form(trace: Trace, needed: tuple[Channel, ...]) -> Trace:
    """Return an accepted trace in the folder's common form: the channels of the spec in its units.

    A failed trace gets all of these channels, with NaN where its log has no valid one; its robustness is declared.
    """
    return _with_all(trace, needed) if trace.failure is not None else _in_units(trace, needed)


def _in_units(trace: Trace, needed: tuple[Channel, ...]) -> Trace:
    """Return the trace with the spec's channels in the spec's units; numbers without a unit already are."""
    conversions, units = {}, dict(trace.units)
    for channel in needed:
        if channel.name in trace:
            conversions[channel.name] = _conversion(units.pop(channel.name, None), channel.unit)
            if channel.unit:
                units[channel.name] = channel.unit
    converted = trace.with_channels(lambda name, x: conversions[name].each(x) if name in conversions else x)
    return replace(converted, units=units)


def _with_all(trace: Trace, needed: tuple[Channel, ...]) -> Trace:
    """Return the trace with all channels of the spec; NaN where the trace has no valid one."""
    valid = {
        c.name
        for c in needed
        if c.name in trace.channels
        and math.prod(trace[c.name].shape[1:]) == c.width
        and _unit_fault(c.name, trace.units.get(c.name), c.unit) is None
    }
    samples = {n: v for n, v in trace.channels.items() if n in valid or all(n != c.name for c in needed)}
    for c in needed:
        if c.name not in valid:
            samples[c.name] = np.full((len(trace), *((c.width,) if c.width > 1 else ())), np.nan)
    units = {name: unit for name, unit in trace.units.items() if name in samples}
    units |= {c.name: c.unit for c in needed if c.unit and c.name not in valid}
    return _in_units(Trace(trace.times, samples, units, trace.meta), needed)


def without_unit(trace: Trace, needed: tuple[Channel, ...]) -> list[str]:
    """Return the channels of the spec for which the log states no unit."""
    return [c.name for c in needed if c.unit and c.name in trace.channels and not trace.units.get(c.name)]


def _tolerance(parameter: Parameter, requested: float) -> float:
    width = parameter.high - parameter.low
    return SAME_TEST * (width if width > 0 else abs(requested)) + 1e-12


def _unit_fault(name: str, unit: str | None, declared: str) -> str | None:
    if not unit or unit == declared:
        return None
    try:
        parsed = unit_in_log(unit, parse_unit(declared))
    except UnknownUnitError:
        return f"its channel {name!r} is in {unit!r}, which is not a unit"
    if not parsed.fits(parse_unit(declared)):
        return f"its channel {name!r} is in {unit}, which does not convert to {declared or 'a number without unit'}"
    return None


def _conversion(unit: str | None, declared: str) -> Conversion:
    if not unit or unit == declared:
        return Conversion()
    target = parse_unit(declared)
    return unit_in_log(unit, target).to(target)


def _unit(text: str) -> str:
    return f" {text}" if text else ""
