"""Formulas and traces for RTAMT: what both languages can say, drawn, written down and run there."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st

from tests.robustness.drawing import NUMBERS, TIMED, Within

_VALUES = st.recursive(
    st.one_of(
        st.sampled_from(["x", "y"]).map(lambda name: ("name", name)),
        NUMBERS.map(lambda value: ("num", value)),
    ),
    lambda inner: st.one_of(
        st.tuples(st.sampled_from("+-*"), inner, inner), st.tuples(st.just("abs"), inner)
    ),
    max_leaves=3,
)
_PREDICATES = st.tuples(st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), _VALUES, _VALUES)
_CLOSED = st.tuples(st.integers(0, 4), st.integers(0, 4)).map(lambda ends: (ends[0], sum(ends), True, True))
_WITHIN = st.one_of(st.none(), _CLOSED, _CLOSED)
_UNARY, _BINARY = ["always", "eventually", "historically", "once"], ["until", "since", "release"]


def _formulas(pointwise: list[str]) -> st.SearchStrategy:
    return st.recursive(
        _PREDICATES,
        lambda inner: st.one_of(
            st.tuples(st.sampled_from(pointwise), inner),
            st.tuples(st.sampled_from(["and", "or", "->", "<->"]), inner, inner),
            st.tuples(st.sampled_from(_UNARY), _WITHIN, inner),
            st.tuples(st.sampled_from(_BINARY), _WITHIN, inner, inner),
            st.tuples(st.just("unless"), _CLOSED, inner, inner),
        ),
        max_leaves=4,
    )


@dataclass(frozen=True)
class Pair:
    """A formula and samples at whole numbers of periods."""

    formula: tuple
    ticks: tuple[int, ...]
    x: tuple[float, ...]
    y: tuple[float, ...]


@st.composite
def pairs(draw: st.DrawFn, dense: bool) -> Pair:
    """Draw a pair; the samples of a dense one are not regular."""
    gaps = draw(st.lists(st.integers(1, 3) if dense else st.just(1), min_size=1, max_size=9))
    ticks = tuple(sum(gaps[:k]) for k in range(len(gaps) + 1))
    sample = st.lists(st.integers(-6, 6).map(lambda v: v / 4), min_size=len(ticks), max_size=len(ticks)).map(
        tuple
    )
    pool = _formulas(["not"] if dense else ["not", "next", "prev", "rise", "fall"])
    return Pair(draw(pool), ticks, draw(sample), draw(sample))


def written(node: tuple) -> str:
    """Write a formula down for RTAMT, in brackets throughout; where it has no such operator, by its meaning."""
    match node:
        case ("name", name):
            return name
        case ("num", value):
            return f"({value!r})"
        case ("abs", inner):
            return f"abs({written(inner)})"
        case ("!=", a, b):
            return f"({written(a)} !== {written(b)})"
        case ("not", a):
            return f"(not {written(a)})"
        case (("next" | "prev") as operator, a):
            return f"(s_{operator} {written(a)})"  # the strong ones: false where there is no sample
        case ("rise", a):
            return f"({written(a)} and s_prev (not {written(a)}))"
        case ("fall", a):
            return f"((not {written(a)}) and s_prev {written(a)})"
        case ("<->", a, b):
            a, b = written(a), written(b)
            return f"(({a} -> {b}) and ({b} -> {a}))"
        case ("release", within, a, b):
            return written(("not", ("until", within, ("not", a), ("not", b))))
        case (operator, within, a) if operator in TIMED:
            return f"({operator}{_interval(within)} {written(a)})"
        case (operator, within, a, b) if operator in TIMED:
            return f"({written(a)} {operator}{_interval(within)} {written(b)})"
        case (operator, a, b):
            return f"({written(a)} {operator} {written(b)})"
    raise AssertionError(node)


def _interval(within: Within | None) -> str:
    return "" if within is None else f"[{within[0]},{within[1]}]"


def in_discrete_time(text: str, x: Sequence[float], y: Sequence[float]) -> list[float]:
    """Return ρ at every sample, as RTAMT has it in discrete time with a period of 1 s."""
    import rtamt

    spec = _parsed(rtamt.StlDiscreteTimeSpecification, text)
    found = spec.evaluate({"time": list(range(len(x))), "x": list(x), "y": list(y)})
    return [value for _, value in found]


def in_dense_time(text: str, ticks: Sequence[int], x: Sequence[float], y: Sequence[float]) -> list[float]:
    """Return ρ at every sample, as RTAMT has it in dense time, from the steps that it returns.

    NaN before the first of them: a since without bounds says nothing about a start at which it is −inf.
    """
    import rtamt

    spec = _parsed(rtamt.StlDenseTimeSpecification, text)
    channels = (
        [name, [[float(t), float(v)] for t, v in zip(ticks, values, strict=True)]]
        for name, values in (("x", x), ("y", y))
    )
    steps = np.array(spec.evaluate(*channels), dtype=float)
    at = np.searchsorted(steps[:, 0], np.array(ticks, dtype=float), side="right") - 1
    return np.where(at < 0, np.nan, steps[at, 1]).tolist()


def _parsed(kind, text: str):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        spec = kind()
        for name in "xy":
            spec.declare_var(name, "float")
        spec.spec = text
        spec.parse()
    return spec
