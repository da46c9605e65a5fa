"""Is this the log of the test that was asked for? Each check returns why not, in a sentence, or None.

Data: a trace as its file has it, the parameters of the test, and what the specification needs. The checks are pure,
and ask in the order of :data:`CHECKS`: a later one may rely on those before it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Channel, Needs, Parameter
from s2r_spec.errors import S2RError, one_of, suggest
from s2r_spec.lang.units import UnknownUnitError, parse_unit
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

COMMANDS = ("{}_cmd", "cmd_{}", "{}_command", "{}_des", "{}_ref")
"""Definition: how a log calls the command of a quantity; a column of another name is mapped to ``<parameter>_cmd``."""
COMMANDED = {"vd": ("v", "vx")}
"""Definition: quantities that a parameter of another name commands, by the names of our specs for walking robots."""
SAME_TEST = 0.01
"""Tolerance: part of a parameter's range by which what a log says of its test may differ from the test. It is above the
rounding of any interface and below what a person would call another test; twice as much accepts tests twice as far."""
FEWEST = 10
"""Tolerance: samples within the time that the spec looks at. A log with fewer that is far too long, too, has its times
in another unit; twice as many would refuse slow loggers."""
FAR_TOO_LONG = 100.0
"""Tolerance: times the needed length. Milliseconds that are read as seconds make a log a thousand times too long."""
GAP = 0.05
"""Tolerance: part of the needed length for which a log may have no sample; twice as much may hide a violation twice as
long."""
WANDERS = 0.05
"""Tolerance: part of a parameter's range by which a command may leave its test once it has reached it. It is above the
noise of a command that was measured; twice as much accepts a test that went on at another speed by as much."""
STEPS = 10.0
"""Tolerance: usual steps of its clock that a gap is longer than, so that a slow logger has none."""


@dataclass(frozen=True)
class Question:
    """The test that was asked for.

    Attributes:
        params: of the test, in the units of the spec.
        needs: of the spec.
        seconds: that the spec looks ahead [s]; 0 where it looks at the whole rest of a trace.
    """

    params: Mapping[str, float]
    needs: Needs
    seconds: float


def refusal(trace: Trace, question: Question) -> str | None:
    """Return why a trace is not the log of the test, or None if nothing speaks against it.

    A trace that failed is judged by no sample: only that it is of this test is asked.
    """
    checks = OF_FAILURES if trace.failure is not None else CHECKS
    return next((sentence for check in checks if (sentence := check(trace, question)) is not None), None)


def said_test(trace: Trace, question: Question) -> str | None:
    """Refuse a log that says itself that it is of another test (``meta["params"]``)."""
    said = trace.meta.get("params")
    for name, value in said.items() if isinstance(said, Mapping) else ():
        parameter = next((p for p in question.needs.parameters if p.name == name), None)
        if parameter is None or not isinstance(value, int | float):
            continue
        asked = question.params[name]
        if not abs(value - asked) <= _tolerance(parameter, asked):
            unit = _unit(parameter.unit)
            return (
                f"it says that it is of {name} = {value:g}{unit}, and the test has {name} = {asked:g}{unit}"
            )
    return None


def channels(trace: Trace, question: Question) -> str | None:
    """Refuse a log that lacks a channel of the spec, or has it in another width or in a unit that does not fit."""
    for channel in question.needs.channels:
        if channel.name not in trace.channels:
            return (
                f"it has no channel {channel.name!r}{suggest(channel.name, trace.channels)} it has "
                f"{one_of(trace.channels)}; another name is mapped, as in manual:FOLDER?map={channel.name}=NAME"
            )
        width = math.prod(trace[channel.name].shape[1:])
        if width != channel.width:
            return (
                f"its channel {channel.name!r} has {width} components, and the spec declares {channel.width}"
            )
        if (wrong := _unfit(channel.name, trace.units.get(channel.name), channel.unit)) is not None:
            return wrong
    return None


def clock(trace: Trace, question: Question) -> str | None:
    """Refuse times that are in another unit: far too long a log with hardly a sample in the time that counts."""
    if question.seconds <= 0 or len(trace) < 2:
        return None
    within = int(np.searchsorted(trace.times - trace.times[0], question.seconds, side="right"))
    if trace.duration > FAR_TOO_LONG * question.seconds and within < FEWEST:
        step = float(np.median(np.diff(trace.times)))
        return (
            f"its clock is wrong: it lasts {trace.duration:g} s with samples every {step:g} s, the test lasts "
            f"{question.seconds:g} s; times in ms are read with manual:FOLDER?time-unit=ms"
        )
    return None


def length(trace: Trace, question: Question) -> str | None:
    """Refuse a log that ends before the spec has seen what it looks at, to within one usual step."""
    step = float(np.median(np.diff(trace.times))) if len(trace) > 1 else 0.0
    if trace.duration + step * (1 + 1e-6) < question.seconds:
        return (
            f"it is too short: it lasts {trace.duration:.4g} s, and the spec looks at {question.seconds:g} s"
        )
    return None


def gaps(trace: Trace, question: Question) -> str | None:
    """Refuse a clock that jumps in the time that counts: what happened meanwhile nobody knows."""
    counted = _counted(trace, question.seconds)
    steps = np.diff(trace.times[counted])
    if not len(steps):
        return None
    longest = int(np.argmax(steps))
    span = question.seconds or trace.duration
    if steps[longest] > max(STEPS * float(np.median(steps)), GAP * span):
        since = float(trace.times[longest] - trace.times[0])
        return f"it has no sample for {steps[longest]:.3g} s, from {since:.4g} s after its beginning"
    return None


def samples(trace: Trace, question: Question) -> str | None:
    """Refuse a channel of the spec that lacks a sample."""
    for channel in question.needs.channels:
        lacking = np.isnan(trace[channel.name]).reshape(len(trace), -1).any(axis=1)
        if lacking.any():
            at = float(trace.times[int(np.argmax(lacking))] - trace.times[0])
            return (
                f"its channel {channel.name!r} has no value {at:.4g} s after its beginning; the sample before stands "
                f"for it with manual:FOLDER?nan=hold"
            )
    return None


def commands(trace: Trace, question: Question) -> str | None:
    """Refuse a log whose recorded command is not that of the test.

    Its median over the time that counts is compared: a ramp at the beginning changes it little. Once it has reached
    the test it must stay there: who let go of the stick, or turned it down, ran another test.
    """
    counted = _counted(trace, question.seconds)
    for parameter in question.needs.parameters:
        for name in _commands_of(parameter.name, trace, counted):
            unit = trace.units.get(name)
            if (wrong := _unfit(name, unit, parameter.unit)) is not None:
                return wrong
            there = counted & np.isfinite(trace[name].reshape(-1))
            if not there.any():
                continue
            factor, offset = _conversion(unit, parameter.unit)
            values = factor * trace[name].reshape(-1)[there] + offset
            found, asked = float(np.median(values)), question.params[parameter.name]
            shown = _unit(parameter.unit)
            wanted = f"the test has {parameter.name} = {asked:.4g}{shown}"
            if abs(found - asked) > _tolerance(parameter, asked):
                return f"its command {name} is {found:.4g}{shown}, and {wanted}"
            if trace.failure is not None:  # who sees a robot fall lets go of the stick
                continue
            since = trace.times[there] - trace.times[0]
            for first, level in _left(values, asked, _tolerance(parameter, asked) * WANDERS / SAME_TEST):
                return f"its command {name} is {level:.4g}{shown} from {since[first]:.4g} s on, and {wanted}"
    return None


def _left(values: FloatArray, asked: float, tolerance: float) -> Iterator[tuple[int, float]]:
    """Yield where a command that has reached the test is elsewhere, and what it is there.

    Medians of pieces are compared, each a ``GAP`` of the time that counts: single samples may be noise.
    """
    reached = False
    for piece in np.array_split(np.arange(len(values)), min(len(values), round(1 / GAP))):
        level = float(np.median(values[piece]))
        if abs(level - asked) <= tolerance:
            reached = True
        elif reached:
            yield int(piece[0]), level


def what_counts(trace: Trace, seconds: float) -> Trace:
    """Return the part of a trace that the spec looks at: all of it where ``seconds`` is 0."""
    counted = _counted(trace, seconds)
    return Trace(
        trace.times[counted], {n: v[counted] for n, v in trace.channels.items()}, trace.units, trace.meta
    )


def _counted(trace: Trace, seconds: float) -> NDArray[np.bool_]:
    """Return which samples the spec looks at."""
    counted: NDArray[np.bool_] = trace.times - trace.times[0] <= (seconds or math.inf)
    return counted


def _commands_of(parameter: str, trace: Trace, counted: NDArray[np.bool_]) -> list[str]:
    """Return the channels that hold the command of a parameter.

    One of the parameter's own name may be what was measured (``wz``): it is the command only if it keeps one value.
    """
    quantities = (parameter, *COMMANDED.get(parameter, ()))
    names = [form.format(quantity) for quantity in quantities for form in COMMANDS]
    if parameter in trace.channels and len(np.unique(trace[parameter][counted])) == 1:
        names.append(parameter)
    return [name for name in names if name in trace.channels and trace[name].size == len(trace)]


def score(trace: Trace, question: Question) -> str | None:
    """Refuse what the spec cannot judge, for whatever reason: the run would end over it."""
    try:
        found = question.needs.score(_in_units(trace, question.needs.channels), question.params)
    except S2RError as error:
        return f"the spec cannot judge it: {error}"
    return None if math.isfinite(found) else f"the spec cannot judge it: its robustness is {found}"


Check = Callable[[Trace, Question], str | None]
OF_FAILURES: tuple[Check, ...] = (said_test, commands)
CHECKS: tuple[Check, ...] = (said_test, channels, clock, length, commands, gaps, samples, score)


def alike(trace: Trace, needed: tuple[Channel, ...]) -> Trace:
    """Return a trace that was not refused as every trace of a folder is: channels of the spec in its units.

    One that failed has all of them, with no sample where its log has none that fits: its robustness is declared, and
    nothing is read from it.
    """
    return _with_all(trace, needed) if trace.failure is not None else _in_units(trace, needed)


def _in_units(trace: Trace, needed: tuple[Channel, ...]) -> Trace:
    """Return the trace with the channels of the spec in its units; numbers without a unit are in those."""
    found, units = dict(trace.channels), dict(trace.units)
    for channel in needed:
        if channel.name in found:
            values = found[channel.name]
            factor, offset = _conversion(units.get(channel.name), channel.unit)
            if (factor, offset) != (1.0, 0.0):
                values = factor * values + offset
            found[channel.name] = values
            units.pop(channel.name, None)
            if channel.unit:
                units[channel.name] = channel.unit
    return Trace(trace.times, found, units, trace.meta)


def _with_all(trace: Trace, needed: tuple[Channel, ...]) -> Trace:
    """Return the trace with all channels of the spec; no sample where it has none that fits."""
    fit = {
        c.name
        for c in needed
        if c.name in trace.channels
        and math.prod(trace[c.name].shape[1:]) == c.width
        and _unfit(c.name, trace.units.get(c.name), c.unit) is None
    }
    found = {n: v for n, v in trace.channels.items() if n in fit or all(n != c.name for c in needed)}
    for c in needed:
        if c.name not in fit:
            found[c.name] = np.full((len(trace), *((c.width,) if c.width > 1 else ())), np.nan)
    units = {name: unit for name, unit in trace.units.items() if name in found}
    units |= {c.name: c.unit for c in needed if c.unit and c.name not in fit}
    return _in_units(Trace(trace.times, found, units, trace.meta), needed)


def without_unit(trace: Trace, needed: tuple[Channel, ...]) -> list[str]:
    """Return the channels of the spec whose numbers are read in its units because their log says none."""
    return [c.name for c in needed if c.unit and c.name in trace.channels and not trace.units.get(c.name)]


def _tolerance(parameter: Parameter, asked: float) -> float:
    width = parameter.high - parameter.low
    return SAME_TEST * (width if width > 0 else abs(asked)) + 1e-12


def _unfit(name: str, unit: str | None, declared: str) -> str | None:
    """Return why the unit of a channel is not one that the spec can read, or None."""
    if not unit or unit == declared:
        return None
    try:
        found = parse_unit(unit)
    except UnknownUnitError:
        return f"its channel {name!r} is in {unit!r}, which is no unit"
    if not found.fits(parse_unit(declared)):
        return f"its channel {name!r} is in {unit}, which does not convert to {declared or 'a number without unit'}"
    return None


def _conversion(unit: str | None, declared: str) -> tuple[float, float]:
    """Return (a, b): a number x in ``unit`` is a·x + b in the declared one."""
    return (1.0, 0.0) if not unit or unit == declared else parse_unit(unit).to(parse_unit(declared))


def _unit(text: str) -> str:
    return f" {text}" if text else ""
