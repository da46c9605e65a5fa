"""Samples and parameters that a formula reads, in the declared units."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Set
from dataclasses import replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import TraceError, UsageError, one_of, suggest
from s2r_spec.lang.amounts import NUMBER_AND_UNIT, Amount, convert, read_amount
from s2r_spec.lang.conversion import Conversion
from s2r_spec.lang.declarations import Param, Signal
from s2r_spec.lang.units import UnknownUnitError, unit_in_log
from s2r_spec.robustness.once import once
from s2r_spec.robustness.stream import SignalMessages, on_circle
from s2r_spec.trace import Trace
from s2r_spec.trace.instants import instant

HOLD = 'nan="hold" (--nan hold) repeats the sample before it; --join hold joins columns of different rates'
LEADING = "there is no sample before it to repeat; --start begins after it"
Missing = Literal["error", "hold"]


@once
def read_signals(trace: Trace, signals: tuple[Signal, ...], missing: Missing) -> Mapping[str, FloatArray]:
    """Return name → (dim, n) in the declared unit; ``missing`` is the treatment of a NaN sample.

    A trace keeps the result, since it does not change.

    Raises:
        TraceError: a channel is missing, has another width, NaN, or a unit that does not fit.
    """
    return MappingProxyType({signal.name: _read(signal, trace, missing) for signal in signals})


def read_streams(
    signals: Iterable[Signal], trace: Trace, missing: Missing, linear: Set[str] = frozenset()
) -> dict[str, SignalMessages]:
    """Return name → signal with messages of its own; those of ``linear`` are so between messages.

    For the other args and errors see :func:`read_signals`.
    """
    return {signal.name: _stream(signal, trace, missing, signal.name in linear) for signal in signals}


def _stream(signal: Signal, trace: Trace, missing: Missing, linear: bool) -> SignalMessages:
    messages = trace.messages[signal.name]
    messages = replace(messages, linear=True) if linear else messages
    messages = messages.held_between() if signal.boolean and messages.linear else messages
    samples = _rows(signal, messages.values)
    empty = np.isnan(samples).any(axis=0)
    turn = turn_of(signal)
    if not empty.any():
        return SignalMessages(messages, _convert(signal, trace, samples), turn=turn)
    if missing == "error":
        raise _missing_error(signal, messages.times, int(np.argmax(empty)), HOLD)
    samples = _last_known(samples)
    known = ~np.isnan(samples).any(axis=0) & ~np.isnan(messages.values.reshape(len(messages), -1)).all(axis=1)
    if not known.any():
        raise _missing_error(signal, messages.times, 0, LEADING)
    kept = replace(messages, times=messages.times[known], values=messages.values[known])
    return SignalMessages(kept, _convert(signal, trace, samples[:, known]), int(empty.sum()), turn)


def turn_of(signal: Signal) -> float:
    """Return a full turn in the unit of a signal that is an angle; inf for any other."""
    unit = signal.measure
    if unit.dimension or unit.angle != 1 or signal.boolean:
        return math.inf
    return 2.0 * math.pi / float(unit.factor)


def _read(signal: Signal, trace: Trace, missing: Missing) -> FloatArray:
    samples = _rows(signal, trace[signal.name])
    if missing == "hold":
        samples = _last_known(samples)
    if math.isnan(np.minimum.reduce(samples, axis=None)):  # NaN if any sample is
        index = int(np.argmax(np.isnan(samples).any(axis=0)))
        raise _missing_error(signal, trace.times, index, HOLD if missing == "error" else LEADING)
    return _on_circle(signal, trace, _convert(signal, trace, samples))


def _on_circle(signal: Signal, trace: Trace, samples: FloatArray) -> FloatArray:
    """Return samples at the stamps of a clock; those of an angle lie on the circle where its messages jump."""
    turn = turn_of(signal)
    messages = None if trace.origin is None else trace.origin.messages.get(signal.name)
    if messages is None or not messages.linear or math.isinf(turn):
        return samples
    values = _convert(signal, trace, _rows(signal, messages.values))
    if not (np.abs(np.diff(values)) > turn / 2).any():
        return samples
    return on_circle(messages.times, values, turn).at(trace.times)


def _rows(signal: Signal, channel: FloatArray) -> FloatArray:
    """Return (dim, n) samples of a channel, after a check of its width and of truth values."""
    width = channel.shape[1] if channel.ndim == 2 else 1
    if width != signal.dim or (channel.ndim == 2) != signal.vector:
        declared = f"a vector of {signal.dim}" if signal.vector else "one number"
        shape = f"a vector of {width}" if channel.ndim == 2 else "one number"
        raise TraceError(f"channel {signal.name!r} has {shape} per sample, but the spec declares {declared}")
    if signal.boolean and not np.isin(channel[~np.isnan(channel)], (0, 1)).all():
        raise TraceError(f"channel {signal.name!r} is declared bool, but its samples are not all 0 or 1")
    return channel.T if channel.ndim == 2 else channel[np.newaxis, :]


def _missing_error(signal: Signal, times: FloatArray, index: int, remedy: str) -> TraceError:
    return TraceError(
        f"channel {signal.name!r} is NaN at sample {index}, t = {instant(times, times[index])}; "
        f"a missing sample has no robustness: {remedy}"
    )


def _convert(signal: Signal, trace: Trace, samples: FloatArray) -> FloatArray:
    return conversion(signal, trace.units.get(signal.name)).each(samples)


def _last_known(samples: FloatArray) -> FloatArray:
    """Return (width, n) with each NaN replaced by the sample before it; the first cannot be."""
    known = np.maximum.accumulate(np.where(np.isnan(samples), 0, np.arange(samples.shape[1])), axis=1)
    return np.take_along_axis(samples, known, axis=1)


def conversion(signal: Signal, unit: str | None) -> Conversion:
    """Return the conversion of samples in ``unit`` to the declared one; None is the declared one.

    Raises:
        TraceError: ``unit`` is not a unit, or has another dimension.
    """
    if unit is None or unit == signal.unit:
        return Conversion()
    remedy = f"--map '{signal.name}=COLUMN [{signal.unit or '-'}]' states the unit of its column in a log"
    try:
        logged = unit_in_log(unit, signal.measure)
    except UnknownUnitError:
        raise TraceError(f"channel {signal.name!r} is in {unit!r}, which is not a unit; {remedy}") from None
    if not logged.fits(signal.measure):
        why = logged.two_readings(signal.measure) or remedy
        raise TraceError(
            f"channel {signal.name!r} is in {logged.text or repr(unit)}, which does not convert to {signal.measure}, "
            f"the unit in the spec. {why[0].upper()}{why[1:]}"
        )
    if not signal.unit and not logged.to(signal.measure).same:
        raise TraceError(
            f"channel {signal.name!r} is in {logged.text or repr(unit)}, and the spec declares no unit: write "
            f"`signal {signal.name} {{{logged.text or unit}}}` there. {remedy}"
        )
    return logged.to(signal.measure)


def read_params(
    params: Mapping[str, Param], used: Set[str], given: Mapping[str, Amount]
) -> dict[str, FloatArray]:
    """Return name → (1, 1) of every parameter in ``used``: its given value, or else its default.

    Raises:
        UsageError: a name is unknown or missing, its value is not a finite number, or its unit does not fit.
    """
    values: dict[str, float] = {}
    for name, value in given.items():
        values[name] = read_amount(value, _find_param(params, name).measure, name)
        if not math.isfinite(values[name]):
            raise UsageError(f"the parameter {name} = {value} is not a finite number")
    numbers: dict[str, FloatArray] = {}
    for name, param in params.items():
        if name in used:
            number = values.get(name, param.default)
            if number is None:
                raise UsageError(
                    f"the parameter {name!r} has no value: give params={{{name!r}: …}}, "
                    f"or --param {name}=… on the command line"
                )
            numbers[name] = np.full((1, 1), float(number))
    return numbers


def read_param(params: Mapping[str, Param], text: str) -> tuple[str, float]:
    """Return the name and the value of ``vd=0.3``, or of ``vd=30 cm/s`` in the declared unit.

    Raises:
        UsageError: it is not of this form, the name is unknown, or the unit does not fit.
    """
    match = _GIVEN.fullmatch(text)
    if match is None:
        raise UsageError(f"{text!r} is not a value of a parameter, such as vd=0.3 or 'vd=30 cm/s'")
    param = _find_param(params, match["name"])
    return param.name, convert(float(match["number"]), match["unit"], param.measure, repr(text), param.name)


def _find_param(params: Mapping[str, Param], name: str) -> Param:
    if name not in params:
        raise UsageError(f"the spec has no parameter {name!r}{suggest(name, params)} it has {one_of(params)}")
    return params[name]


_GIVEN = re.compile(rf"\s*(?P<name>\w+)\s*=\s*{NUMBER_AND_UNIT}")
