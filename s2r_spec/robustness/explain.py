"""Explanation of ρ: the instant, the sub-formula, the predicate and the numbers that decide it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from s2r_spec.base.arrays import BoolArray, FloatArray
from s2r_spec.base.json_values import to_json
from s2r_spec.base.printable import html_text, one_line
from s2r_spec.lang import formula as f
from s2r_spec.robustness.deciding import DescentStep, descend
from s2r_spec.robustness.evaluate import Walk
from s2r_spec.robustness.evaluation import Reading
from s2r_spec.robustness.responsible import responsible_samples
from s2r_spec.robustness.sampled import numbers_at, sampled_algebra
from s2r_spec.robustness.ties import restore_zero
from s2r_spec.trace.instants import DATES, instant


@dataclass(frozen=True)
class Observed:
    """A number at an instant: a signal, a parameter, or a side of a comparison."""

    name: str
    value: float
    unit: str

    def __str__(self) -> str:
        return f"{self.name} = {self.value:.6g} {self.unit}".rstrip()


@dataclass(frozen=True)
class ExplanationStep:
    """A sub-formula on the way from the requirement to the predicate.

    Args:
        text: its text in the specification.
        name: its name, if it is a use of a named sub-formula.
        line: its line, counted from 1.
        time: instant at which it is evaluated [s].
        rho: its robustness at that instant.
    """

    text: str
    name: str
    line: int
    time: float
    rho: float


@dataclass(frozen=True, repr=False)
class Explanation:
    """The instant and the predicate that decide ρ of a requirement at the trace's first time.

    Args:
        requirement: the name of the requirement.
        rho: the robustness of the requirement, in ``unit``.
        unit: the unit of ρ.
        satisfied: whether the requirement is true there; at ρ = 0 the comparisons decide.
        parts: the formulas from the requirement down to the predicate, each with its own instant.
        instant: time at which the predicate is evaluated [s]; None without a predicate.
        predicate: the text of the predicate; "" if no predicate decides ρ.
        line: line of the predicate, or else of the innermost part.
        margin: the margin of the predicate at the instant, in ``margin_unit``; ρ is factor · margin.
            Where the factor is negative the predicate must not hold.
        margin_unit: unit of the margin.
        factor: 1, or −1 below a negation; times a change of units.
        sides: both sides of the predicate, at the instant.
        signals: the signals and parameters in the predicate, at the instant.
        when: the instant in words, to the precision of the samples; relative to the first one if times are dates.
        rests: the times of ``responsible`` in words.
        responsible: (from, to) times [s] at which the verdict depends on this predicate: where it fails, or else
            where it must hold; below a negation, where it holds, or else where it must not.
        unneeded: the right side of an implication that is true because its left side is false; "" if there is none.
        reason: the reason why no predicate decides ρ; "" if one does.
    """

    requirement: str
    rho: float
    unit: str
    satisfied: bool
    parts: tuple[ExplanationStep, ...] = ()
    instant: float | None = None
    predicate: str = ""
    line: int | None = None
    margin: float | None = None
    margin_unit: str = ""
    factor: float = 1.0
    sides: tuple[Observed, ...] = ()
    signals: tuple[Observed, ...] = ()
    responsible: tuple[tuple[float, float], ...] = ()
    when: str = ""
    rests: tuple[str, ...] = ()
    unneeded: str = ""
    reason: str = ""

    def __str__(self) -> str:
        """Return the explanation in a few lines."""
        verdict = "holds" if self.satisfied else "violated"
        head = f"{self.requirement} {verdict}: ρ = {self.rho:+.6g} {self.unit}".rstrip()
        if self.rho == 0:
            head += ", where the comparisons decide"
        if self.reason:
            return f"{head}\n  because {self.reason}"
        named = next((part.name for part in reversed(self.parts) if part.name), "")
        within = f", in `{named}`" if named else ""
        rests = ", ".join(self.rests[:4])
        more = ", …" if len(self.rests) > 4 else ""
        must_hold = self.factor > 0
        what = {
            (True, True): "must hold", (True, False): "must not hold", (False, True): "fails",
            (False, False): "holds",
        }[self.satisfied, must_hold]  # fmt: skip
        assert self.margin is not None
        margin = (self.margin if must_hold else -self.margin) + 0.0
        lines = [
            head,
            f"  decided at t = {self.when} by `{self.predicate}` (line {self.line}{within})"
            f"{'' if must_hold else ', which must not hold'}: margin {margin:+.6g} {self.margin_unit}".rstrip(),
            f"  there {', '.join(map(str, self.signals))}" if self.signals else "  a constant",
            f"  it {what} at {rests}{more}",
        ]
        if self.unneeded:
            lines.append(
                f"  `{self.unneeded}` is not needed there: the left side of its implication is false"
            )
        return "\n".join(lines)

    def __repr__(self) -> str:
        """Return one line: the verdict, ρ, and the instant and predicate that decide it."""
        verdict = "holds" if self.satisfied else "violated"
        why = self.reason or f"decided at t = {self.when} by `{self.predicate}`"
        rho = f"ρ = {self.rho:+.6g} {self.unit}".rstrip()
        return one_line(f"Explanation({self.requirement} {verdict}: {rho}; {why})")

    def _repr_html_(self) -> str:
        """Return the lines of ``print`` for a notebook."""
        head, *rest = map(html_text, str(self).split("\n"))
        return f"<pre><b>{head}</b>\n" + "\n".join(rest) + "</pre>"

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON; an infinite ρ becomes the text "inf" or "-inf"."""
        plain: dict[str, Any] = to_json(self, infinite=True)
        return plain


def explain(formula: f.Formula, reading: Reading, requirement: str, unit: str) -> Explanation:
    """Explain ρ of a formula at the first sample; conditions are evaluated at the samples."""
    numbers = numbers_at(reading.samples)
    walk = Walk(sampled_algebra(numbers), reading.until)
    signed = float(walk(formula)[0])
    steps = list(descend(formula, walk, reading.clock))
    parts = way_down(
        (step.node, float(reading.times[step.sample]), float(walk(step.node)[step.sample])) for step in steps
    )
    last = steps[-1]
    predicate, sample = last.node, last.sample
    decided = Decided(predicate, last.factor, reading.times, unneeded=_irrelevant_side(steps))
    if isinstance(predicate, f.Comparison):

        def at(node: f.Value) -> FloatArray:
            values = numbers(node)
            return values[:, min(sample, values.shape[-1] - 1)]

        none = np.zeros(len(reading.times), dtype=bool)
        times = responsible_samples(formula, walk, reading.clock).get(id(predicate), none)
        times[sample] = True  # a violated until may have several reasons, and ρ may name another one
        decided = replace(
            decided,
            runs=_runs(times, reading.times),
            sides=tuple(observe(side, at(side)[0]) for side in (predicate.left, predicate.right)),
            signals=observe_signals(predicate, at),
        )
    return make_explanation(requirement, unit, signed, parts, decided)


@dataclass(frozen=True, eq=False)
class Decided:
    """The formula at the end of the way down, which decides ρ; for most fields see :class:`Explanation`.

    Args:
        node: a predicate; or a formula whose ρ is infinite.
        times: increasing times of the trace, to whose resolution times are printed [s].
        runs: (from, to) times at which the verdict depends on the predicate [s].
    """

    node: f.Formula
    factor: float
    times: FloatArray
    runs: tuple[tuple[float, float], ...] = ()
    sides: tuple[Observed, ...] = ()
    signals: tuple[Observed, ...] = ()
    unneeded: str = ""


def make_explanation(
    requirement: str, unit: str, signed: float, parts: tuple[ExplanationStep, ...], decided: Decided
) -> Explanation:
    """Return an explanation from the way down to what decides ρ; the sign of ``signed``, never 0, is the verdict."""
    rho, satisfied = restore_zero(signed), signed > 0
    when = instant(decided.times, parts[-1].time)
    if not isinstance(decided.node, f.Comparison):
        match decided.node:
            case f.Truth():
                what = "is constant"
            case f.Flag():
                what = "is true" if parts[-1].rho > 0 else "is false"
            case _:
                what = "has no sample in its window, so its value holds by definition"
        reason = f"`{parts[-1].text}` (line {parts[-1].line}), at t = {when}, {what}"
        return Explanation(requirement, rho, unit, satisfied, parts, line=parts[-1].line, reason=reason)
    return Explanation(
        requirement,
        rho,
        unit,
        satisfied,
        parts,
        instant=parts[-1].time,
        predicate=parts[-1].text,
        line=parts[-1].line,
        margin=parts[-1].rho,
        margin_unit=_unit(decided.node),
        factor=decided.factor,
        sides=decided.sides,
        signals=decided.signals,
        responsible=decided.runs,
        when=when,
        rests=tuple(_run_text(decided.times, *run) for run in decided.runs),
        unneeded=decided.unneeded if satisfied else "",
    )


def _irrelevant_side(steps: Sequence[DescentStep]) -> str:
    """Return the right side of the last implication on the way down whose left side is false; "" if there is none."""
    for above, below in zip(reversed(steps[:-1]), reversed(steps[1:]), strict=True):
        if below.vacuous and isinstance(above.node, f.Implication):
            return _one_line(above.node.right.span.text)
    return ""


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _unit(node: f.Value | f.Formula) -> str:
    return "" if node.unit is None else node.unit.text


def way_down(steps: Iterable[tuple[f.Formula, float, float]]) -> tuple[ExplanationStep, ...]:
    """Return the steps of an explanation from sub-formulas, their instants [s] and their signed ρ there."""
    return tuple(
        ExplanationStep(
            _one_line(node.span.text),
            node.name if isinstance(node, f.Named) else "",
            node.span.line,
            time,
            restore_zero(rho),
        )
        for node, time, rho in steps
        if not isinstance(node, f.Rescale)
    )


def observe(node: f.Value, number: float) -> Observed:
    """Return a value as text with its number."""
    return Observed(_one_line(node.span.text), float(number), _unit(node))


def observe_signals(
    predicate: f.Comparison, read: Callable[[f.SignalValue | f.ParamValue], FloatArray]
) -> tuple[Observed, ...]:
    """Return the signals and parameters in a predicate, each once, vectors by component.

    ``read``: signal or parameter → (width,) its components at the instant.
    """
    observed: dict[str, Observed] = {}
    for node in f.walk(predicate):
        if isinstance(node, f.SignalValue | f.ParamValue):
            index = node.index if isinstance(node, f.SignalValue) else None
            for k, number in enumerate(read(node), index or 0):
                name = node.name if node.width == 1 and index is None else f"{node.name}[{k}]"
                observed.setdefault(name, Observed(name, float(number), _unit(node)))
    return tuple(observed.values())


def _run_text(times: FloatArray, start: float, end: float) -> str:
    """Return a period of time in words; if times are dates, relative to the first sample."""
    if start == end:
        return instant(times, start)
    first = 0.0 if times[0] < DATES else float(times[0])
    after = " after the first sample" if first else ""
    return f"{instant(times - first, start - first)} to {instant(times - first, end - first)}{after}"


def _runs(at: BoolArray, times: FloatArray) -> tuple[tuple[float, float], ...]:
    """Return (first, last) time of every run of samples."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], at, [False]))))
    return tuple(zip(times[edges[::2]].tolist(), times[edges[1::2] - 1].tolist(), strict=True))
