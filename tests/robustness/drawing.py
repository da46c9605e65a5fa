"""Random formulas as tuples, their text, and traces to evaluate them on."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from hypothesis import strategies as st

PERIODS = {"0.1": Fraction(1, 10), "0.25": Fraction(1, 4), "0.002": Fraction(1, 500)}
TIMED = {"always", "eventually", "historically", "once", "until", "since", "release", "unless"}

NUMBERS = st.integers(-4, 4).map(lambda n: n / 2)
_NUMBER = NUMBERS.map(lambda value: ("num", value))
VALUES = st.recursive(
    st.one_of(st.sampled_from(["x", "y", "p"]).map(lambda name: ("name", name)), _NUMBER),
    lambda inner: st.one_of(
        st.tuples(st.sampled_from("+-*"), inner, inner),
        st.tuples(st.sampled_from(["min", "max", "overshoot", "norm"]), inner, inner),
        st.tuples(st.sampled_from(["abs", "init", "sign", "minus"]), inner),
    ),
    max_leaves=4,
)
_SIGNS = st.sampled_from(["<", "<=", ">", ">=", "==", "!="])
COMPARISONS = st.tuples(_SIGNS, VALUES, VALUES)

# Values with slopes −1, 0 and 1 only, so that lines cross on a lattice of halves (see Lattice).
_STEADY = st.one_of(_NUMBER, st.just(("name", "p")), st.just(("init", ("name", "x"))))
_SLOPED = st.recursive(
    st.sampled_from(["x", "y"]).map(lambda name: ("name", name)),
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(["min", "max"]), inner, inner),
        st.tuples(st.sampled_from(["abs", "minus"]), inner),
        st.tuples(st.sampled_from(["+", "overshoot"]), inner, _STEADY),
    ),
    max_leaves=2,
)
SLOPED_COMPARISONS = st.one_of(st.tuples(_SIGNS, _SLOPED, _STEADY), st.tuples(_SIGNS, _STEADY, _SLOPED))

Within = tuple[int, int | None, bool, bool]


@st.composite
def intervals(draw: st.DrawFn) -> Within | None:
    """(first, last, closed, closed) in periods; never without one of them, so that it is no mistake."""
    if draw(st.integers(0, 5)) == 0:
        return None
    low, low_closed, high_closed = draw(st.integers(0, 4)), draw(st.booleans()), draw(st.booleans())
    if draw(st.integers(0, 5)) == 0:
        return low, None, low_closed, False
    return low, low + (not low_closed) + (not high_closed) + draw(st.integers(0, 4)), low_closed, high_closed


def formulas(comparisons: st.SearchStrategy, unary: list[str]) -> st.SearchStrategy:
    """Formulas over some predicates; ``unary`` are the untimed operators of one formula."""
    return st.recursive(
        st.one_of(comparisons, st.sampled_from([("true",), ("false",)])),
        lambda inner: st.one_of(
            st.tuples(st.sampled_from(unary), inner),
            st.tuples(st.sampled_from(["and", "or", "->", "<->"]), inner, inner),
            st.tuples(st.sampled_from(["always", "eventually", "historically", "once"]), intervals(), inner),
            st.tuples(st.sampled_from(["until", "since", "release", "unless"]), intervals(), inner, inner),
        ),
        max_leaves=4,
    )


FORMULAS = formulas(COMPARISONS, ["not", "next", "prev", "rise", "fall"])
DENSE_FORMULAS = formulas(COMPARISONS, ["not", "rise", "fall"])
SLOPED_FORMULAS = formulas(SLOPED_COMPARISONS, ["not", "rise", "fall"])


def text_of(node: tuple, period: Fraction) -> str:
    """Write a formula down; its intervals count periods."""
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


def interval_text(within: Within | None, period: Fraction) -> str:
    """Write an interval down."""
    if within is None:
        return ""
    low, high, low_closed, high_closed = within
    # float(0.1 · 3) is 0.30000000000000004: what a script would write
    ends = f"{low * float(period)!r}, {'inf' if high is None else repr(high * float(period))}"
    return f"{'[' if low_closed else '('}{ends}{']' if high_closed else ')'}"


@dataclass(frozen=True)
class Case:
    """A formula and a trace; ``kind`` is regular, irregular, hold or linear."""

    kind: str
    formula: tuple
    ticks: tuple[int, ...]
    x: tuple[float, ...]
    y: tuple[float, ...]
    param: float
    period: Fraction
    start: float
    until: str
    end: str

    @property
    def text(self) -> str:
        """The specification."""
        return f"signal x\nsignal y\nparam p in [-9, 9]\nrequire it: {text_of(self.formula, self.period)}"


@st.composite
def cases(draw: st.DrawFn, kind: str) -> Case:
    """Draw a case; ticks count periods."""
    n = draw(st.integers(3 if kind == "irregular" else 1, 12 if kind in ("regular", "irregular") else 6))
    longest = 1 if kind == "regular" else 3
    gaps = draw(st.lists(st.integers(1, longest), min_size=n - 1, max_size=n - 1))
    if kind == "irregular" and len(set(gaps)) == 1:
        gaps[-1] += 1  # else it would be a grid
    ticks = tuple(sum(gaps[:k]) for k in range(n))
    if kind == "linear":
        x, y = draw(_sloped(gaps)), draw(_sloped(gaps))
    else:
        sample = st.lists(st.integers(-6, 6).map(lambda v: v / 4), min_size=n, max_size=n).map(tuple)
        x, y = draw(sample), draw(sample)
    pool = {"hold": DENSE_FORMULAS, "linear": SLOPED_FORMULAS}.get(kind, FORMULAS)
    return Case(
        kind, draw(pool), ticks, x, y,
        param=draw(NUMBERS),
        period=PERIODS[draw(st.sampled_from(sorted(PERIODS)))],
        start=draw(st.sampled_from([0.0, -3.7, 1000.1])),
        until=draw(st.sampled_from(["open", "closed"])),
        end=draw(st.sampled_from(["clip"] if kind == "irregular" or n == 1 else ["clip", "hold"])),
    )  # fmt: skip


@st.composite
def _sloped(draw: st.DrawFn, gaps: list[int]) -> tuple[float, ...]:
    values = [float(draw(st.integers(-3, 3)))]
    for gap in gaps:
        values.append(values[-1] + gap * draw(st.sampled_from([-1, 0, 1])))
    return tuple(values)
