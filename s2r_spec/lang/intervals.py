"""The check of time intervals: constant or parametric ends, in order, converted to seconds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from s2r_spec.lang import formula as f
from s2r_spec.lang import syntax
from s2r_spec.lang.constants import constant
from s2r_spec.lang.declarations import Param
from s2r_spec.lang.scope import Mistake, Scope, fail
from s2r_spec.lang.source import Span
from s2r_spec.lang.units import PLAIN, SECOND, Unit

_TIMES = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}
_PER_SECOND = {"ns": 1e9, "us": 1e6, "ms": 1e3}


def EVER(span: Span) -> f.Interval:  # noqa: N802  (a constant but for its place)
    """Return [0, inf): the whole rest of the trace."""
    return f.Interval(0.0, math.inf, True, False, span)


@dataclass(frozen=True)
class _End:
    """One end: its least and greatest time [s], and the parameter that sets it, if any."""

    least: float
    greatest: float
    param: f.ParamTime | None = None


def interval(
    written: syntax.Interval, scope: Scope, value: Callable[[syntax.Expression, Scope], f.Value]
) -> f.Interval:
    """Check an interval; ``value`` checks the expressions of its ends."""
    start, end = _end(written.low, scope, value), _end(written.high, scope, value)
    low, high = start.least, end.greatest
    if low < 0 or end.least < 0:
        past = "use `historically`, `once` or `since` for the past"
        fail("E06", f"the interval begins at {low:g} s, in the past", written.low.span, past)
    if high < low:
        fail(
            "E06",
            f"the interval is empty: it ends at {high:g} s, before it begins at {low:g} s",
            written.span,
        )
    if high == low and not (written.low_closed and written.high_closed):
        fail(
            "E06",
            f"the interval is empty: it excludes {low:g} s, its only instant",
            written.span,
            "write `[a, a]`",
        )
    # other tools write "inf]"; no instant is at infinity
    high_closed = written.high_closed and not math.isinf(high)
    return f.Interval(low, high, written.low_closed, high_closed, written.span, start.param, end.param)


def _end(bound: syntax.Bound, scope: Scope, value: Callable[[syntax.Expression, Scope], f.Value]) -> _End:
    if bound.value is None:
        return _End(math.inf, math.inf)
    checked = value(bound.value, scope)
    if not isinstance(checked, f.ParamValue):
        number = constant(checked)
        if number is None:
            message = (
                f"a time bound must be a constant or a parameter, but `{bound.value.span.text}` is neither"
            )
            fail("E18", message, bound.value.span)
        if not math.isfinite(number):
            fail("E18", f"`{bound.value.span.text}` is not a finite number", bound.value.span)
        seconds = _seconds(bound, checked, number)
        return _End(seconds, seconds)
    param = scope.find(checked.name, bound.value.span)
    assert isinstance(param, Param)
    ends = param.range or (param.default, param.default)
    if ends[0] is None or ends[1] is None:
        raise Mistake  # neither range nor default: reported before
    return _End(
        _seconds(bound, checked, ends[0]),
        _seconds(bound, checked, ends[1]),
        f.ParamTime(checked.name, _seconds(bound, checked, 1.0)),
    )


def _seconds(bound: syntax.Bound, checked: f.Value, number: float) -> float:
    assert bound.value is not None
    unit: Unit = checked.unit or SECOND
    if bound.unit is not None:
        if bound.unit.text not in _TIMES:
            fail(
                "E04",
                f"`{bound.unit.text}` is not a unit of time",
                bound.unit.span,
                "use ns, us, ms, s, min or h",
            )
        if checked.unit not in (None, PLAIN):
            fail("E06", f"the bound has two units, {checked.unit} and {bound.unit.text}", bound.span)
        # 100/1000 is the closest number to a tenth, and 100·0.001 need not be
        small = _PER_SECOND.get(bound.unit.text)
        return number / small if small else number * _TIMES[bound.unit.text]
    if isinstance(checked, f.ParamValue) and unit == PLAIN:
        return number
    if not unit.fits(SECOND):
        fail(
            "E06",
            f"a time bound must be a time, but `{bound.value.span.text}` is in {unit}",
            bound.value.span,
        )
    return unit.to(SECOND)(number)
