"""Online monitoring against definitions: sound, shrinking, tight, and equal to the offline ρ."""

from __future__ import annotations

import math
import re
import tracemalloc
from dataclasses import replace
from fractions import Fraction
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from s2r_spec.errors import SamplingError, TraceError, UsageError
from s2r_spec.robustness.online import points
from s2r_spec.spec import parse_spec
from s2r_spec.trace import Trace
from tests.errors import naming
from tests.examples import examples
from tests.robustness.definitions import NoSampleError, Truth, by_definition, reach, sample_reach
from tests.robustness.drawing import Case, cases, text_of
from tests.robustness.test_functions import DEFINITIONS

CASES = st.sampled_from(["regular", "irregular"]).flatmap(cases).map(lambda case: replace(case, end="clip"))
RANGES = "signal x in [-1.5, 1.5]\nsignal y in [-1.5, 1.5]"


def samples(case: Case):
    """Yield (time, sample), as a recorder does."""
    for tick, x, y in zip(case.ticks, case.x, case.y, strict=True):
        yield case.start + tick * float(case.period), {"x": x, "y": y}


def period(case: Case) -> float | None:
    """A recorded trace of one sample has no period: nothing but now is in a window then."""
    return float(case.period) if case.kind == "regular" and len(case.ticks) > 1 else None


def trace_of(case: Case) -> Trace:
    times, values = zip(*samples(case), strict=True)
    return Trace(times, {name: [sample[name] for sample in values] for name in "xy"})


def unbounded(node: tuple) -> bool:
    """Whether an operator anywhere looks at the whole rest of the trace."""
    ahead = node[0] in ("always", "eventually", "until", "release", "unless")
    return (ahead and (node[1] is None or node[1][1] is None)) or any(
        unbounded(part) for part in node if isinstance(part, tuple) and part and isinstance(part[0], str)
    )


def defined(case: Case) -> list[float] | None:
    """ρ at every sample; None if a window has no sample."""
    try:
        return by_definition(case)
    except NoSampleError:
        return None


def opened(case: Case, opens):
    """What follows a case, or None if it is refused for an operator over the whole rest."""
    try:
        return opens({"p": case.param}, period=period(case), until=case.until, sparse=True)
    except UsageError as error:
        refusal = str(error)
    assert re.search(r"`.+` \(line \d", refusal)
    assert unbounded(case.formula)
    return None


@settings(max_examples=examples(200), deadline=None)
@given(case=CASES)
def test_a_stream_is_the_robustness_signal(case: Case) -> None:
    stream = opened(case, parse_spec(case.text).robustness_stream)
    assert stream or unbounded(case.formula)
    if not stream:
        return
    rho, refusal = defined(case), ""
    try:
        pairs = [pair for time, sample in samples(case) for pair in stream.update(time, sample)["it"]]
        pairs += stream.finish()["it"]
    except TraceError as error:
        refusal = str(error)
    if rho is None:
        assert re.search(r"`[\[(].+` \(line \d", refusal)
        return
    assert not refusal
    assert [time for time, _ in pairs] == [time for time, _ in samples(case)]
    assert [value for _, value in pairs] == pytest.approx(rho, abs=1e-9, rel=0)


@settings(max_examples=examples(250), deadline=None)
@given(case=CASES, often=st.sampled_from([1, 3, 1024]))
def test_an_interval_shrinks_to_what_is_defined(case: Case, often: int) -> None:
    """Every prefix of a trace has the whole of it among its completions."""
    spec = parse_spec(case.text.replace("signal x\nsignal y", RANGES))
    rho = defined(case)
    assume(rho is not None)
    monitor = opened(case, spec.monitor)
    if not monitor:
        return
    seen = [monitor.intervals["it"]]
    with patch.object(points, "OFTEN", often):
        for time, sample in samples(case):
            seen.append(monitor.update(time, sample)["it"])
            assert seen[-2].lower <= seen[-1].lower <= seen[-1].upper <= seen[-2].upper
    offline = spec.evaluate(trace_of(case), "it", {"p": case.param}, until=case.until, sparse=True)
    complete = offline.complete[0]
    if complete and not unbounded(case.formula):
        assert seen[-1].decided
    # windows that lie wholly past the end of the trace are empty, which no interval foresees
    if complete and (not unbounded(case.formula) or reach(case.formula) == 0):
        assert all(interval.lower - 1e-9 <= rho[0] <= interval.upper + 1e-9 for interval in seen)
    ended = monitor.finish(partial=not complete)["it"]
    assert ended.decided
    assert ended.lower == pytest.approx(rho[0], abs=1e-9, rel=0)
    true = by_definition(case, Truth)[0]
    assert ended.satisfied == offline.satisfied == true
    if complete and (not unbounded(case.formula) or reach(case.formula) == 0):
        assert all(interval.satisfied in (None, true) for interval in seen)


@pytest.mark.parametrize("period", [None, 100.0])
@pytest.mark.parametrize("formula", ["always[0, 2] x > 0", "once[0, 2] x > 0", "count(x > 0, 2) > 0"])
def test_a_window_that_is_shorter_than_the_period_is_refused(period, formula: str) -> None:
    spec = parse_spec(f"signal x\nrequire it: {formula}", "a.stl")

    def follow() -> None:
        monitor = spec.monitor(period=period)
        for k in range(3):
            monitor.update(100.0 * k, {"x": 1.0})

    with pytest.raises(SamplingError, match=r"line 2 of a\.stl"):
        follow()


@pytest.mark.parametrize("period", [None, 0.1])
@pytest.mark.parametrize(
    ("formula", "count", "verdict"),
    [("always[0, 0.3] x > 0", 1, "unknown"), ("always[0, 0.3] x > 0", 2, "unknown"),
     ("always[0, 0.3] x > 0", 3, "unknown"), ("always[0, 0.3] x > 0", 4, "holds"),
     ("always[0, 0.3) x > 0", 3, "holds"), ("always[0, 0.35] x > 0", 4, "holds"),
     ("always x > 0", 1, "unknown"), ("always x > 0", 2, "holds"), ("x > 0", 1, "holds"),
     ("always[0, 0.2] eventually[0, 0.1] x > 0", 4, "holds"), ("next x > 0", 1, "unknown")],
)  # fmt: skip
def test_how_long_a_trace_must_be(period, formula: str, count: int, verdict: str) -> None:
    spec = parse_spec(f"signal x\nrequire it: {formula}")
    monitor = spec.monitor(period=period)
    for k in range(count):
        monitor.update(0.1 * k, {"x": 1.0})
    assert monitor.finish()["it"].verdict == verdict
    trace = Trace(np.arange(count) / 10, {"x": np.ones(count)})
    assert spec.evaluate(trace, "it").complete[0] == (verdict == "holds")
    if verdict == "unknown":
        with pytest.raises(TraceError, match=naming("'it'")):
            spec.satisfied(trace)


_BOUNDED = st.tuples(st.integers(0, 3), st.integers(1, 4), st.booleans(), st.booleans()).map(
    lambda drawn: (drawn[0], drawn[0] + drawn[1] + 1, drawn[2], drawn[3])
)


def _wrapped(inner: st.SearchStrategy) -> st.SearchStrategy:
    """Put operators around a formula that do not use it twice."""
    return st.recursive(
        inner,
        lambda below: st.one_of(
            st.tuples(st.sampled_from(["not", "next"]), below),
            st.tuples(st.sampled_from(["always", "eventually"]), _BOUNDED, below),
        ),
        max_leaves=1,
    )


def _predicate(name: str) -> st.SearchStrategy:
    bound = st.integers(-3, 3).map(lambda n: ("num", n / 4))
    return st.tuples(st.sampled_from(["<", ">="]), st.just(("name", name)), bound)


_TWO = st.tuples(_wrapped(_predicate("x")), _wrapped(_predicate("y"))).flatmap(
    lambda pair: st.one_of(
        st.tuples(st.sampled_from(["and", "or", "->"]), st.just(pair[0]), st.just(pair[1])),
        st.tuples(
            st.sampled_from(["until", "release", "unless"]), _BOUNDED, st.just(pair[0]), st.just(pair[1])
        ),
    )
)


@settings(max_examples=examples(100), deadline=None)
@given(
    formula=_wrapped(_TWO),
    x=st.lists(st.integers(-6, 6).map(lambda v: v / 4), min_size=1, max_size=10),
    y=st.lists(st.integers(-6, 6).map(lambda v: v / 4), min_size=10, max_size=10),
    until=st.sampled_from(["open", "closed"]),
)
def test_both_ends_of_an_interval_are_reached_by_some_completion(formula, x, y, until: str) -> None:
    """Each signal in one predicate that is used once: the extremes are where both stay at ends of their ranges."""
    n, longest = len(x), sample_reach(formula) + 1
    assume(longest <= 40)
    period = Fraction(1, 10)
    spec = parse_spec(f"{RANGES}\nrequire it: {text_of(formula, period)}")
    monitor = spec.monitor(period=0.1, until=until)
    for k in range(n):
        found = monitor.update(k / 10, {"x": x[k], "y": y[k]})["it"]
    more = max(longest - n, 0)
    ends = []
    for at_x in (-1.5, 1.5):
        for at_y in (-1.5, 1.5):
            drawn = (*x, *[at_x] * more), (*y[:n], *[at_y] * more)
            ticks = tuple(range(n + more))
            ends.append(
                by_definition(Case("regular", formula, ticks, *drawn, 0.0, period, 0.0, until, "clip"))[0]
            )
    assert (found.lower, found.upper) == pytest.approx((min(ends), max(ends)), abs=1e-9)


@pytest.mark.parametrize("text", DEFINITIONS)
@settings(max_examples=15, deadline=None)
@given(
    x=st.lists(st.integers(-3, 3).map(lambda v: v + 0.5), min_size=2, max_size=12),
    gaps=st.lists(st.integers(1, 3), min_size=11, max_size=11),
    regular=st.booleans(),
)
def test_functions_of_the_past_as_defined(text: str, x, gaps, regular: bool) -> None:
    times = np.cumsum([0, *([1] * 11 if regular else gaps)])[: len(x)] / 10 + 3
    stream = parse_spec(f"signal x require it: {text} > 0").robustness_stream(period=0.1 if regular else None)
    pairs = [pair for t, value in zip(times, x, strict=True) for pair in stream.update(t, {"x": value})["it"]]
    pairs += stream.finish()["it"]
    expected = [DEFINITIONS[text](times, x, t) for t in range(len(x))]
    np.testing.assert_allclose([rho for _, rho in pairs], expected, rtol=0, atol=1e-9)


MIXED = """
signal x in [-2, 2]
signal u[2] in [-2, 2]
signal on bool
param p = 0.5 in [0.1, 1]
let soon := eventually[0, 0.3] x > 0
let turn := norm(u - init(u), x) + sign(x)^3 / (3 + x^2)
require a: always[0, 0.5] (count(soon, 0.4) + duration(soon) / 1 {s} >= turn)
require b: eventually[0, p] (if(on and soon, mean(u[0], 0.35), delay(x, 0.25)) > 0)
require c: always[0, 0.5] (rise(on) -> deriv(mean(x, 0.2)) * 1 {s} <= turn until(0, 0.4] soon)
require d: historically[0.1, 0.4] (soon since[0, 0.3] x > -1) or once (x > 1) or prev (x <= 0 unless[0, 0.2] on)
require e: always[0, 0.6] (integral(abs(x), 0.5) <= 1 {s} or overshoot(x, u[1], init(u[0])) <= 0.5 and next on)
require f: max(sqrt(x + 2), min(-x, u[0]), 0) <= 1 + delay(turn, 0.2) release[0, 0.5] not (x == u[1] and x != 0)
require g: integral(x) <= 9 {s} and mean(x) <= 1 and count(x > 0) <= 30
"""


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), regular=st.booleans(), ranges=st.booleans())
def test_everything_together_as_offline(seed: int, regular: bool, ranges: bool) -> None:
    rng = np.random.default_rng(seed)
    spec, n = parse_spec(MIXED), 40
    times = 7 + np.cumsum(np.full(n, 0.05) if regular else rng.uniform(0.02, 0.06, n))
    trace = Trace(
        times,
        {"x": rng.uniform(-2, 2, n), "u": rng.uniform(-2, 2, (n, 2)), "on": rng.integers(0, 2, n)},
    )
    period = 0.05 if regular else None
    stream, monitor = spec.robustness_stream(period=period), spec.monitor(period=period, ranges=ranges)
    pairs = {name: [] for name in spec.requirements}
    seen = [monitor.intervals]
    for k in range(n):
        sample = {name: channel[k] for name, channel in trace.channels.items()}
        seen.append(monitor.update(times[k], sample))
        for name, new in stream.update(times[k], sample).items():
            pairs[name] += new
    for name, rest in stream.finish().items():
        rho = [value for _, value in pairs[name] + rest]
        np.testing.assert_allclose(rho, spec.robustness_signal(trace, name), rtol=0, atol=1e-9)
        assert all(one[name].lower - 1e-9 <= rho[0] <= one[name].upper + 1e-9 for one in seen)
        assert seen[-1][name].decided
        assert seen[-1][name].lower == pytest.approx(rho[0], abs=1e-9)


def test_an_interval_by_hand() -> None:
    spec = parse_spec("signal x {m} in [-1, 1]\nrequire it: always[0, 0.2] x <= 0.5 {m}")
    monitor = spec.monitor(period=0.1)
    found = monitor.intervals["it"]
    assert (found.lower, found.upper, found.verdict, found.decided) == (-0.5, 1.5, "unknown", False)
    found = monitor.update(5.0, {"x": 0.1})["it"]
    assert (found.lower, found.upper) == (-0.5, 0.4)
    found = monitor.update(5.1, {"x": 0.75})["it"]
    assert (found.lower, found.upper, found.verdict) == (-0.5, -0.25, "violated")
    assert not monitor.decided
    found = monitor.update(5.2, {"x": 0.0})["it"]
    assert (found.lower, found.upper, monitor.decided) == (-0.25, -0.25, True)
    assert monitor.update(5.3, {"x": 1.0}) == {"it": found}


def test_the_whole_rest_is_asked_for_at_the_first_instant() -> None:
    spec = parse_spec("signal x\nrequire it: always (x < 3 -> eventually[0, 0.1] x >= 2)", "a.stl")
    monitor = spec.monitor(period=0.1)
    assert monitor.update(0, {"x": 1})["it"].upper == math.inf
    assert monitor.update(0.1, {"x": 1})["it"].upper == -1
    assert monitor.update(0.2, {"x": 3})["it"].lower == -math.inf
    assert monitor.finish() == spec.monitor(period=0.1).intervals | monitor.intervals
    assert monitor.intervals["it"].lower == monitor.intervals["it"].upper == -1


@pytest.mark.parametrize(
    ("formula", "named"),
    [
        ("always eventually x > 0", "eventually x > 0"),
        ("always[0, 1] (x > 0 -> not (x < 1 until[1, inf) x > 2))", "x < 1 until[1, inf) x > 2"),
        ("once (x > 0 and always\n x > 1)", "always x > 1"),
        ("count(x < 1 release x > 2) > 1", "x < 1 release x > 2"),
    ],
)
def test_what_has_no_bound_is_named(formula: str, named: str) -> None:
    spec = parse_spec(f"signal x\nrequire it: {formula}", "a.stl")
    with pytest.raises(UsageError, match=naming(f"`{named}`", "line 2 of a.stl", "time bound")):
        spec.monitor()


BAD = [
    ((0.1, {"y": 1.0}), ["'x'", "y"]),
    ((0.1, {"x": "fast"}), ["'x'", "'fast'"]),
    ((0.1, {"x": [1.0, 2.0]}), ["'x'", "[1.0, 2.0]"]),
    ((0.1, {"x": math.nan}), ["'x'", "NaN", "sample 1", "--nan hold"]),
    ((math.inf, {"x": 0.0}), ["1", "inf"]),
    ((0.0, {"x": 0.0}), ["sample 1", "0 s"]),
    ((0.1, {"x": 3.0}), ["'x'", "3", "sample 1", "[-2, 2]", "--no-ranges"]),
    ((0.2, {"x": 0.0}), ["sample 1", "0.2 s", "0.1 s"]),
]


@pytest.mark.parametrize(("given", "facts"), BAD)
def test_a_sample_that_cannot_be_used_is_not_taken(given, facts: list[str]) -> None:
    monitor = parse_spec("signal x in [-2, 2] require it: always[0, 0.1] x > 0").monitor(period=0.1)
    before = monitor.update(0, {"x": 1.0})
    with pytest.raises(TraceError, match=naming(*facts)):
        monitor.update(*given)
    assert monitor.intervals == before
    assert monitor.update(0.1, {"x": 2.0})["it"].lower == 1


def test_what_has_no_value_ends_the_trace() -> None:
    monitor = parse_spec("signal x\nrequire it: always[0, 1] x / x > 0", "a.stl").monitor()
    monitor.update(0, {"x": 1})
    for time in (0.5, 0.6):
        with pytest.raises(TraceError, match=naming("`x / x > 0`", "line 2 of a.stl", "sample 1", "0.5 s")):
            monitor.update(time, {"x": 0})


def test_numbers_of_numpy_and_whole_numbers_give_plain_floats() -> None:
    spec = parse_spec("signal x in [-2, 2] signal u[2] require it: always[0, 0.1] (x <= 1 and norm(u) < 9)")
    stream, monitor = spec.robustness_stream(period=0.1), spec.monitor(period=0.1)
    x, found = [1, np.float32(0.5), np.int64(0), True], []
    for k in range(4):
        sample = {"x": x[k], "u": np.array([3, 4])}
        found += stream.update(np.float64(k) / 10, sample)["it"]
        interval = monitor.update(np.float64(k) / 10, sample)["it"]
    assert repr(found) == "[(0.0, 0.0), (0.1, 0.5), (0.2, 0.0)]"
    assert repr((interval.lower, interval.upper)) == "(0.0, 0.0)"


def test_an_empty_window_ends_the_trace() -> None:
    monitor = parse_spec("signal x\nrequire it: always[0.2, 0.2] x > 0", "a.stl").monitor(sparse=True)
    monitor.update(0.0, {"x": 1})
    for k in range(1, 300):
        with pytest.raises(TraceError, match=naming("`[0.2, 0.2]`", "line 2 of a.stl", "sample 0")):
            monitor.update(0.3 * k, {"x": 1})


def test_a_missing_sample_is_held_if_asked_for() -> None:
    spec = parse_spec("signal u[2] signal on bool require it: always[0, 1] (on -> norm(u) < 3)")
    monitor = spec.monitor(nan="hold")
    monitor.update(0, {"u": [1, 0], "on": True})
    assert monitor.update(1, {"u": (math.nan, 2), "on": math.nan})["it"].upper == 3 - math.sqrt(5)


def test_after_the_end_nothing_is_taken() -> None:
    monitor = parse_spec("signal x require it: always[0, 1] x > 0").monitor()
    with pytest.raises(TraceError, match="no sample"):
        monitor.finish()
    monitor.update(0, {"x": 1})
    assert not monitor.finish()["it"].decided
    with pytest.raises(UsageError, match="finished"):
        monitor.update(1, {"x": 1})
    with pytest.raises(UsageError, match="period=-1"):
        parse_spec("signal x require it: x > 0").monitor(period=-1)


@pytest.mark.parametrize(
    "formula",
    [
        "always(0.2, 0.3] (y < 0 since[0.1, 0.2] eventually[0, 0.3] x > 0)",
        "(eventually[0, 0.2] x > 0 since[0.2, 0.4] y > 0) until(0.1, 0.4) (x > 0 since(0.1, 0.3] next y > 0)",
        "eventually[0.3, 0.5] (y < 0 since[0.2, 0.2] (x > 0 unless[0, 0.3] y > 0))",
    ],
)
def test_since_over_what_is_still_to_come(formula: str) -> None:
    # the first instant that is asked for has a window that begins before it, its neighbours' before that
    x = [-0.5, 0.25, -1.25, -1.25, 0.5, -0.75, 1, -0.5, 1.5, -0.5, -0.25]
    y = [0.5, -0.4, -0.3, 0.2, -0.1, 0, 0.1, -0.2, 0.3, 0.4, 0.5]
    spec = parse_spec(f"signal x signal y require it: {formula}")
    monitor = spec.monitor(period=0.1)
    for k in range(11):
        interval = monitor.update(k / 10, {"x": x[k], "y": y[k]})["it"]
    rho = spec.robustness(Trace(np.arange(11) / 10, {"x": x, "y": y}))["it"]
    assert (interval.lower, interval.upper) == (rho, rho)


@settings(max_examples=examples(400), deadline=None)
@given(case=CASES, cuts=st.lists(st.integers(0, 12), max_size=4))
def test_blocks_of_samples_give_what_single_samples_give(case, cuts) -> None:
    """With the same errors, and also if single samples follow."""
    spec = parse_spec(case.text)
    how = {"params": {"p": case.param}, "period": period(case), "until": case.until}

    def outcome(in_blocks):
        found, intervals = [], None
        try:
            stream, monitor = spec.robustness_stream(**how), spec.monitor(**how)
            given_samples = list(samples(case))
            ends = sorted({*cuts, len(given_samples)}) if in_blocks else range(1, len(given_samples) + 1)
            begin = 0
            for place, end in enumerate(ends):
                part = given_samples[begin:end]
                begin = max(begin, end)
                if not in_blocks or (part and place % 3 == 2):
                    for time, sample in part:
                        found += stream.update(time, sample)["it"]
                        intervals = monitor.update(time, sample)
                    continue
                times = [time for time, _ in part]
                block = {name: [sample[name] for _, sample in part] for name in "xy"}
                found += stream.extend(times, block)["it"]
                intervals = monitor.extend(times, block)
            found += stream.finish()["it"]
            intervals = monitor.finish(partial=True)
        except (TraceError, UsageError) as error:
            return type(error), str(error)
        return [(time.hex(), rho.hex()) for time, rho in found], intervals

    assert outcome(in_blocks=True) == outcome(in_blocks=False)


@pytest.mark.parametrize(
    ("times", "block", "named"),
    [
        ([0.2, 0.3], {"x": [1.0, math.nan]}, ["x", "NaN", "sample 3"]),
        ([0.2, 0.2], {"x": [1.0, 1.0]}, ["sample 3", "increase"]),
        ([0.2, 0.5], {"x": [1.0, 1.0]}, ["sample 3", "0.3 s", "0.1 s"]),
        ([0.2, math.inf], {"x": [1.0, 1.0]}, ["3", "finite"]),
        ([0.2, 0.3], {"y": [1.0, 1.0]}, ["x"]),
        ([0.2, 0.3], {"x": [1.0]}, ["x", "(1,)", "2"]),
        ([0.2, 0.3], {"x": ["a", "b"]}, ["x", "'a'"]),
    ],
)
def test_a_block_that_cannot_be_used_is_not_taken(times, block, named) -> None:
    stream = parse_spec("signal x require it: always[0, 0.2] x <= 2").robustness_stream(period=0.1)
    stream.extend([0.0, 0.1], {"x": [1.0, 0.5]})
    with pytest.raises(TraceError, match=naming(*named)):
        stream.extend(times, block)
    assert stream.extend([0.2, 0.3], {"x": [0.0, 1.5]}) == {"it": [(0.0, 1.0), (0.1, 0.5)]}


def test_a_stream_in_blocks_keeps_only_what_its_windows_read() -> None:
    spec = parse_spec("signal x require it: always[0, 1] once[0, 2] x <= 2")
    stream, kept = spec.robustness_stream(period=0.1), []
    tracemalloc.start()
    for k in range(40):
        stream.extend(0.1 * np.arange(2000 * k, 2000 * k + 2000), {"x": np.ones(2000)})
        kept.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert kept[-1] - kept[9] < 16_000  # bytes of one block: 30 blocks came
