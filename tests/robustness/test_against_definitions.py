"""Robustness against its definitions, written as loops over samples."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from s2r_spec.errors import UsageError
from s2r_spec.spec import parse_spec
from s2r_spec.trace import Trace

PERIODS = {"0.1": Fraction(1, 10), "0.25": Fraction(1, 4), "0.002": Fraction(1, 500)}

# --- formulas as tuples: drawn, printed, and evaluated by definition ---------------------------

NUMBERS = st.integers(-4, 4).map(lambda n: n / 2)
VALUES = st.recursive(
    st.one_of(
        st.sampled_from(["x", "y", "p"]).map(lambda name: ("name", name)), NUMBERS.map(lambda v: ("num", v))
    ),
    lambda inner: st.one_of(
        st.tuples(st.sampled_from("+-*"), inner, inner),
        st.tuples(st.sampled_from(["min", "max", "overshoot", "norm"]), inner, inner),
        st.tuples(st.sampled_from(["abs", "init", "sign", "minus"]), inner),
    ),
    max_leaves=4,
)
COMPARISONS = st.tuples(st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), VALUES, VALUES)


@st.composite
def intervals(draw: st.DrawFn) -> tuple[int, int | None, bool, bool] | None:
    """(first, last, closed, closed) in samples; never without a sample, so that it is no mistake."""
    if draw(st.integers(0, 5)) == 0:
        return None
    low, low_closed, high_closed = draw(st.integers(0, 4)), draw(st.booleans()), draw(st.booleans())
    if draw(st.integers(0, 5)) == 0:
        return low, None, low_closed, False
    return low, low + (not low_closed) + (not high_closed) + draw(st.integers(0, 4)), low_closed, high_closed


FORMULAS = st.recursive(
    st.one_of(COMPARISONS, st.sampled_from([("true",), ("false",)])),
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(["not", "next", "prev", "rise", "fall"]), inner),
        st.tuples(st.sampled_from(["and", "or", "->", "<->"]), inner, inner),
        st.tuples(st.sampled_from(["always", "eventually", "historically", "once"]), intervals(), inner),
        st.tuples(st.sampled_from(["until", "since", "release", "unless"]), intervals(), inner, inner),
    ),
    max_leaves=4,
)


def text_of(node: tuple, period: Fraction) -> str:
    match node:
        case ("name", name):
            return name
        case ("num", value):
            return f"({value!r})"
        case ("true" | "false" as word,):
            return word
        case ("minus", inner):
            return f"(-{text_of(inner, period)})"
        case (("min" | "max" | "overshoot" | "norm") as name, left, right):
            return f"{name}({text_of(left, period)}, {text_of(right, period)})"
        case (("abs" | "init" | "sign" | "rise" | "fall") as name, inner):
            return f"{name}({text_of(inner, period)})"
        case (("not" | "next" | "prev") as name, inner):
            return f"({name} {text_of(inner, period)})"
        case (("always" | "eventually" | "historically" | "once") as name, within, inner):
            return f"({name}{interval_text(within, period)} {text_of(inner, period)})"
        case (("until" | "since" | "release" | "unless") as name, within, left, right):
            return f"({text_of(left, period)} {name}{interval_text(within, period)} {text_of(right, period)})"
        case (operator, left, right):
            return f"({text_of(left, period)} {operator} {text_of(right, period)})"
    raise AssertionError(node)


def interval_text(within: tuple | None, period: Fraction) -> str:
    if within is None:
        return ""
    low, high, low_closed, high_closed = within
    # float(0.1 · 3) is 0.30000000000000004: what a script would write
    ends = f"{low * float(period)!r}, {'inf' if high is None else repr(high * float(period))}"
    return f"{'[' if low_closed else '('}{ends}{']' if high_closed else ')'}"


class Definition:
    """ρ by definition, at one sample at a time; closed says whether left holds at the witness."""

    def __init__(self, signals: dict, param: float, n: int, closed: bool) -> None:
        self.signals, self.param, self.n, self.closed = signals, param, n, closed

    def number(self, node: tuple, t: int) -> float:
        match node:
            case ("name", "p"):
                return self.param
            case ("name", name):
                return self.signals[name][t]
            case ("num", value):
                return value
            case ("init", inner):
                return self.number(inner, 0)
            case ("overshoot", x, reference):
                difference = self.number(x, t) - self.number(reference, t)
                return difference if self.number(reference, 0) >= 0 else -difference
        parts = [self.number(part, t) for part in node[1:]]
        return {
            "+": lambda a, b: a + b,
            "-": lambda a, b: a - b,
            "*": lambda a, b: a * b,
            "min": min,
            "max": max,
            "norm": math.hypot,
            "abs": abs,
            "sign": lambda a: (a > 0) - (a < 0),
            "minus": lambda a: -a,
        }[node[0]](*parts)

    def inside(self, distance: int, within: tuple | None) -> bool:
        low, high, low_closed, high_closed = within or (0, None, True, False)
        after = distance >= low if low_closed else distance > low
        return after and (high is None or (distance <= high if high_closed else distance < high))

    def until(self, left: list, right: list, t: int, within: tuple | None, sign: int = 1) -> float:
        """Sup over witnesses of min(right there, inf of left before); ``sign`` −1 looks into the past."""
        best = -math.inf
        for w in range(self.n):
            if self.inside(sign * (w - t), within):
                before = range(t, w, sign) if not self.closed else range(t, w + sign, sign)
                best = max(best, min([right[w], *(left[s] for s in before)]))
        return best

    def signal(self, node: tuple) -> list[float]:
        every, n = range(self.n), self.n
        match node:
            case ("true",):
                return [math.inf] * n
            case ("false",):
                return [-math.inf] * n
            case ("<" | "<=", a, b):
                return [self.number(b, t) - self.number(a, t) for t in every]
            case (">" | ">=", a, b):
                return [self.number(a, t) - self.number(b, t) for t in every]
            case ("==", a, b):
                return [-abs(self.number(a, t) - self.number(b, t)) for t in every]
            case ("!=", a, b):
                return [abs(self.number(a, t) - self.number(b, t)) for t in every]
        parts = [self.signal(part) for part in node[2 if node[0] in TIMED else 1 :]]
        inner = parts[0]
        match node:
            case ("not", _):
                return [-v for v in inner]
            case ("next", _):
                return [inner[t + 1] if t + 1 < n else -math.inf for t in every]
            case ("prev", _):
                return [inner[t - 1] if t > 0 else -math.inf for t in every]
            case ("rise", _):
                return [min(inner[t], -inner[t - 1]) if t else -math.inf for t in every]
            case ("fall", _):
                return [min(-inner[t], inner[t - 1]) if t else -math.inf for t in every]
            case ("always", within, _):
                return [
                    min([math.inf, *(inner[s] for s in every if self.inside(s - t, within))]) for t in every
                ]
            case ("eventually", within, _):
                return [
                    max([-math.inf, *(inner[s] for s in every if self.inside(s - t, within))]) for t in every
                ]
            case ("historically", within, _):
                return [
                    min([math.inf, *(inner[s] for s in every if self.inside(t - s, within))]) for t in every
                ]
            case ("once", within, _):
                return [
                    max([-math.inf, *(inner[s] for s in every if self.inside(t - s, within))]) for t in every
                ]
        left, right = parts
        match node[0]:
            case "and":
                return [min(a, b) for a, b in zip(left, right, strict=True)]
            case "or":
                return [max(a, b) for a, b in zip(left, right, strict=True)]
            case "->":
                return [max(-a, b) for a, b in zip(left, right, strict=True)]
            case "<->":
                return [min(max(-a, b), max(a, -b)) for a, b in zip(left, right, strict=True)]
            case "until":
                return [self.until(left, right, t, node[1]) for t in every]
            case "since":
                return [self.until(left, right, t, node[1], sign=-1) for t in every]
            case "release":
                no_left, no_right = [-v for v in left], [-v for v in right]
                return [-self.until(no_left, no_right, t, node[1]) for t in every]
            case "unless":
                _, high, _, high_closed = node[1] or (0, None, True, False)
                reach = (0, high, True, high_closed)
                stays = [
                    min([math.inf, *(left[s] for s in every if self.inside(s - t, reach))]) for t in every
                ]
                return [max(stays[t], self.until(left, right, t, node[1])) for t in every]
        raise AssertionError(node)


TIMED = {"always", "eventually", "historically", "once", "until", "since", "release", "unless"}
SAMPLES = st.integers(1, 12).flatmap(
    lambda n: st.tuples(*(st.lists(st.integers(-6, 6).map(lambda v: v / 4), min_size=n, max_size=n),) * 2)
)


@settings(max_examples=400, deadline=None)
@given(
    formula=FORMULAS,
    samples=SAMPLES,
    param=NUMBERS,
    period=st.sampled_from(sorted(PERIODS)),
    start=st.sampled_from([0.0, -3.7, 1000.1]),
    until=st.sampled_from(["open", "closed"]),
)
def test_every_sample_is_as_defined(formula, samples, param, period, start, until) -> None:
    step = PERIODS[period]
    x, y = samples
    spec = parse_spec(f"signal x\nsignal y\nparam p in [-9, 9]\nrequire it: {text_of(formula, step)}")
    trace = Trace(start + np.arange(len(x)) * float(step), {"x": x, "y": y})
    before = {name: values.tobytes() for name, values in trace.channels.items()}
    found = spec.robustness_signal(trace, "it", {"p": param}, until=until)
    expected = Definition({"x": x, "y": y}, param, len(x), until == "closed").signal(formula)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    assert {name: values.tobytes() for name, values in trace.channels.items()} == before


FUTURE = st.recursive(
    COMPARISONS.filter(lambda node: "init" not in repr(node) and "overshoot" not in repr(node)),
    lambda inner: st.one_of(
        st.tuples(st.just("not"), inner),
        st.tuples(st.sampled_from(["and", "or", "->", "<->"]), inner, inner),
        st.tuples(st.sampled_from(["always", "eventually"]), intervals(), inner),
        st.tuples(st.sampled_from(["until", "release", "unless"]), intervals(), inner, inner),
    ),
    max_leaves=4,
)
DUALS = [
    ("not always[0.1, 0.3) (x > 0)", "eventually[0.1, 0.3) not (x > 0)"),
    ("not (x > 0 until(0, 0.4] y > 0)", "(not x > 0) release(0, 0.4] (not y > 0)"),
    ("x > 0 until[0, 0.3] y > 0", "x > 0 until y > 0 and eventually[0, 0.3] y > 0"),
    ("eventually[0, 0.3] x > 0", "true until[0, 0.3] x > 0"),
    ("not historically[0, 0.2] x > 0", "once[0, 0.2] x <= 0"),
    ("x > 0 unless y > 0", "(x > 0 until y > 0) or always x > 0"),
    ("x > 0 -> y > 0", "not x > 0 or y > 0"),
    ("always[0.1, 0.2] always[0, 0.2] x > 0", "always[0.1, 0.4] x > 0"),
]


@pytest.mark.parametrize(("left", "right"), DUALS)
@settings(max_examples=25, deadline=None)
@given(samples=SAMPLES)
def test_identities(left: str, right: str, samples) -> None:
    spec = parse_spec(f"signal x signal y require left: {left} require right: {right}")
    trace = Trace(np.arange(len(samples[0])) / 10, {"x": samples[0], "y": samples[1]})
    np.testing.assert_array_equal(
        spec.robustness_signal(trace, "left"), spec.robustness_signal(trace, "right")
    )


@settings(max_examples=60, deadline=None)
@given(formula=FUTURE, samples=SAMPLES, more=st.integers(1, 3))
def test_the_past_does_not_matter_to_a_future_formula(formula, samples, more: int) -> None:
    spec = parse_spec(f"signal x signal y param p = 1 require it: {text_of(formula, Fraction(1, 10))}")

    def rho(x: list, y: list) -> np.ndarray:
        return spec.robustness_signal(Trace(np.arange(len(x)) / 10, {"x": x, "y": y}), "it")

    x, y = samples
    np.testing.assert_array_equal(rho([9.0] * more + x, [-9.0] * more + y)[more:], rho(x, y))


@settings(max_examples=60, deadline=None)
@given(formula=FUTURE, samples=SAMPLES)
def test_the_horizon_is_enough(formula, samples) -> None:
    spec = parse_spec(f"signal x signal y param p = 1 require it: {text_of(formula, Fraction(1, 10))}")
    if not math.isfinite(spec.horizon()):
        return
    x, y = ([*values, *[0.5] * 60] for values in samples)
    whole = Trace(np.arange(len(x)) / 10, {"x": x, "y": y})
    n = round(spec.horizon() * 10) + 1
    cut = Trace(whole.times[:n], {name: values[:n] for name, values in whole.channels.items()})
    if n <= len(x):
        assert spec.robustness(cut) == spec.robustness(whole)


def test_a_bound_between_two_samples_is_refused() -> None:
    spec = parse_spec("signal x\nrequire it: always[0, 0.25 s] x > 0", "a.stl")
    with pytest.raises(UsageError) as caught:
        spec.robustness(Trace(np.arange(9) / 10, {"x": np.ones(9)}))
    assert str(caught.value) == (
        "the time 0.25 s in `[0, 0.25 s]` (line 2 of a.stl) is not a multiple of the sample period, 0.1 s; "
        "the nearest multiples are 0.2 s and 0.3 s"
    )


def test_an_interval_without_a_sample_is_refused() -> None:
    spec = parse_spec("signal x\nrequire it: always(0.1, 0.2) x > 0", "a.stl")
    with pytest.raises(
        UsageError, match=r"no sample lies in `\(0.1, 0.2\)` \(line 2 of a.stl\): the sample period"
    ):
        spec.robustness(Trace(np.arange(9) / 10, {"x": np.ones(9)}))
