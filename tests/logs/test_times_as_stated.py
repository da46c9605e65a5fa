"""Verdicts are those of the times as a file states them, or there is none: property tests on whole nanoseconds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import s2r_spec as s2r
from s2r_spec.errors import SamplingError, TraceError
from tests.examples import examples

UNITS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
EPOCH = 1_718_000_000_000_000_000
PERIODS = [10**6, 2 * 10**6, 10**7, 5 * 10**7, 10**8]


@st.composite
def recordings(draw):
    """(times [ns], values): regular, drifting, or jittered by up to 30 % of a period; from 0, or from 1970."""
    period, n = draw(st.sampled_from(PERIODS)), draw(st.integers(20, 60))
    steps = np.full(n - 1, period)
    kind = draw(st.sampled_from(["regular", "drifting", "jittered"]))
    if kind == "drifting":
        steps = steps + int(period * draw(st.sampled_from([-3e-4, 3e-4, 5e-3])))
    if kind == "jittered":
        share = st.integers(-period * 3 // 10, period * 3 // 10)
        steps = steps + np.array(draw(st.lists(share, min_size=n - 1, max_size=n - 1)))
    start = draw(st.sampled_from([0, EPOCH]))
    values = draw(st.lists(st.sampled_from([0.0, 0.5, 1.0, 1.5]), min_size=n, max_size=n))
    return start + np.concatenate(([0], np.cumsum(steps))), values, period


def truth(times, values, low: int, high: int) -> bool:
    """Return whether every sample in [low, high] ns after the first is at most 1, by whole numbers."""
    return all(v <= 1 for t, v in zip(times - times[0], values, strict=True) if low <= t <= high)


def on_the_border(times, *ends: int) -> bool:
    """Whether a sample is so close to an end that rounding decides on which side it lies."""
    return any(abs(int(t) - end) <= 1000 for t in times - times[0] for end in ends)


def written(folder, times, values, unit: str, how: str):
    """Write a trace whose times are counts of a unit; return what reads it."""
    counts = times / UNITS[unit] if unit == "s" else times // UNITS[unit]
    path = folder / f"trace.{'csv' if how in ('header', 'option', 'iso') else how.split()[0]}"
    if how == "header":
        rows = [f"{t!r},{v}" for t, v in zip(counts.tolist(), values, strict=True)]
        path.write_text("\n".join([f"t [{unit}],v", *rows]) + "\n")
    elif how == "option":
        rows = [f"{t!r},{v}" for t, v in zip(counts.tolist(), values, strict=True)]
        path.write_text("\n".join(["t,v", *rows]) + "\n")
        return s2r.read_trace(path, time_unit=unit)
    elif how == "iso":
        stamps = np.datetime_as_string(times.astype("M8[ns]"), unit="ns")
        path.write_text(
            "\n".join(["t,v", *(f"{t}Z,{v}" for t, v in zip(stamps, values, strict=True))]) + "\n"
        )
    elif how == "npz dates":
        np.savez(path, t=times.astype("M8[ns]"), v=values)
    elif how == "npz durations":
        np.savez(path, t=times.astype("m8[ns]"), v=values)
    elif how == "parquet dates":
        arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
        parquet.write_table(arrow.table({"t": arrow.array(times, arrow.timestamp("ns")), "v": values}), path)
    return s2r.read_trace(path)


HOW = [
    *(("header", unit) for unit in ("ms", "us", "ns")),
    *(("option", unit) for unit in ("s", "ms", "us", "ns")),
    *((how, "ns") for how in ("iso", "npz dates", "npz durations", "parquet dates")),
]


def answered(spec, source):
    """Return (evaluation, None), or (None, the refusal)."""
    try:
        trace = source if isinstance(source, s2r.Trace) else s2r.read_trace(source)
        return spec.evaluate(trace, "slow"), None
    except TraceError as error:
        return None, error


@pytest.mark.parametrize(("how", "unit"), HOW)
@settings(max_examples=examples(16), deadline=None)
@given(recording=recordings(), low=st.integers(0, 4), length=st.integers(1, 12), quarter=st.integers(0, 3))
def test_the_verdict_is_of_the_times_as_stated(
    tmp_path_factory, how, unit, recording, low, length, quarter
) -> None:
    times, values, period = recording
    if unit in ("ms", "us"):
        times = times // UNITS[unit] * UNITS[unit]  # what a logger of this unit can write
        if (np.diff(times) <= 0).any():
            return
    begin, end = low * period, (low + length) * period + quarter * period // 4
    if on_the_border(times, begin, end):
        begin, end = begin + period // 3, end + period // 3
        if on_the_border(times, begin, end):
            return
    spec = s2r.parse_spec(f"signal v\nrequire slow: always[{begin / 1e9!r}, {end / 1e9!r}] v <= 1")
    trace = written(tmp_path_factory.mktemp("t"), times, values, unit, how)
    found, refusal = answered(spec, trace)
    if found is None:
        beyond = (end - begin) / np.median(np.diff(times)) - 1
        short = isinstance(refusal, SamplingError)
        assert short or beyond > -1e-3
        assert not short or beyond < 1e-3
        return
    assert found.satisfied == truth(times, values, begin, end)
    assert found.period == pytest.approx(np.median(np.diff(times)) / 1e9, rel=0.02)
    assert found.narrowest is None or found.narrowest >= 1


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
@settings(max_examples=examples(16), deadline=None)
@given(recording=recordings(), length=st.integers(2, 12))
def test_counts_that_do_not_say_their_unit_are_no_seconds_in_silence(
    tmp_path_factory, unit, recording, length
) -> None:
    """They are refused, or the answer is that of seconds and tells how many samples the window holds."""
    times, values, period = recording
    counts = times // UNITS[unit]
    if (np.diff(counts) <= 0).any():
        return
    path = tmp_path_factory.mktemp("t") / "trace.csv"
    path.write_text("\n".join(["t,v", *(f"{t},{v}" for t, v in zip(counts, values, strict=True))]) + "\n")
    seconds = length * period / 1e9
    spec = s2r.parse_spec(f"signal v\nrequire slow: always[0, {seconds!r}] v <= 1")
    found, refusal = answered(spec, path)
    if found is None:
        assert f"--time-unit {unit}" in str(refusal) or isinstance(refusal, SamplingError)
        return
    inside = int(np.sum(counts - counts[0] <= seconds))
    assert inside > 1
    assert found.narrowest is None or 1 < found.narrowest <= inside
