"""Why ρ is what it is: the instant, the sub-formula, the predicate and the numbers that decide it."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.lang import formula as f
from s2r_spec.robustness.deciding import descend
from s2r_spec.robustness.evaluate import Walk
from s2r_spec.robustness.evaluation import Reading
from s2r_spec.robustness.responsible import responsible
from s2r_spec.robustness.sampled import SampledAlgebra, Samples

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Observed:
    """A number at an instant: a signal, a parameter, or a side of a comparison."""

    name: str
    value: float
    unit: str

    def __str__(self) -> str:
        return f"{self.name} = {self.value:.6g} {self.unit}".rstrip()


@dataclass(frozen=True)
class Part:
    """A sub-formula on the way from the requirement to the predicate.

    Args:
        text: as it is written.
        name: what it is called, if it is a use of a named sub-formula.
        line: where it is written.
        time: when it is asked [s].
        rho: its own robustness there.
    """

    text: str
    name: str
    line: int
    time: float
    rho: float


@dataclass(frozen=True)
class Explanation:
    """What decides ρ of a requirement at the trace's first time.

    Args:
        requirement: its name.
        rho: its robustness, in ``unit``.
        unit: of ρ.
        parts: from the requirement down to the predicate, each with its own instant.
        instant: when the predicate is asked [s]; None without a predicate.
        predicate: its text; "" if ρ rests on none.
        line: where the predicate, or else the innermost part, is written.
        margin: of the predicate at the instant, in ``margin_unit``; ρ is factor · margin.
        margin_unit: unit of the margin.
        factor: 1, or −1 below a negation; times a change of units.
        sides: what the predicate compares, at the instant.
        signals: the signals and parameters in the predicate, at the instant.
        responsible: times [s], from and to, at which the verdict needs this predicate:
            where it fails, or else where it has to hold.
        reason: why ρ rests on no predicate; "" if it does.
    """

    requirement: str
    rho: float
    unit: str
    parts: tuple[Part, ...] = ()
    instant: float | None = None
    predicate: str = ""
    line: int | None = None
    margin: float | None = None
    margin_unit: str = ""
    factor: float = 1.0
    sides: tuple[Observed, ...] = ()
    signals: tuple[Observed, ...] = ()
    responsible: tuple[tuple[float, float], ...] = ()
    reason: str = ""

    def __str__(self) -> str:
        """Say it in two or three lines."""
        verdict = "holds" if self.rho >= 0 else "violated"
        head = f"{self.requirement} {verdict}: ρ = {self.rho:+.6g} {self.unit}".rstrip()
        if self.reason:
            return f"{head}\n  because {self.reason}"
        named = next((part.name for part in reversed(self.parts) if part.name), "")
        within = f", in `{named}`" if named else ""
        rests = ", ".join(
            f"{start:g} s" if start == end else f"{start:g} s to {end:g} s"
            for start, end in self.responsible[:4]
        )
        more = ", …" if len(self.responsible) > 4 else ""
        what = "fails" if self.rho < 0 else "has to hold"
        return "\n".join(
            (
                head,
                f"  decided at t = {self.instant:g} s by `{self.predicate}` (line {self.line}{within}): "
                f"margin {self.margin:+.6g} {self.margin_unit}".rstrip(),
                f"  there {', '.join(map(str, self.signals))}" if self.signals else "  a constant",
                f"  it {what} at {rests}{more}",
            )
        )

    def to_json(self) -> dict[str, Any]:
        """Return plain data that JSON can hold: an infinite ρ is the word "inf" or "-inf"."""
        plain: dict[str, Any] = _plain(asdict(self))
        return plain


def explain(formula: f.Formula, reading: Reading, requirement: str, unit: str) -> Explanation:
    """Explain ρ of a formula at the first sample, conditions asked at the samples."""
    algebra = SampledAlgebra(Samples(reading.clock, reading.signals, reading.params, reading.until))
    walk = Walk(algebra, reading.until)
    rho = float(walk(formula)[0]) + 0.0  # no one wants to read -0
    steps = list(descend(formula, walk, reading.clock))
    parts = tuple(
        Part(
            _one_line(step.node.span.text),
            step.node.name if isinstance(step.node, f.Named) else "",
            step.node.span.line,
            float(reading.times[step.sample]),
            float(walk(step.node)[step.sample]) + 0.0,
        )
        for step in steps
        if not isinstance(step.node, f.Rescale)
    )
    last = steps[-1]
    predicate, sample = last.node, last.sample
    if not isinstance(predicate, f.Comparison):
        match predicate:
            case f.Truth():
                what = "is constant"
            case f.Flag():
                what = "is true" if parts[-1].rho > 0 else "is false"
            case _:
                what = "looks where the trace has no samples, so that it is decided by definition"
        reason = f"`{parts[-1].text}` (line {parts[-1].line}), at t = {parts[-1].time:g} s, {what}"
        return Explanation(requirement, rho, unit, parts, line=parts[-1].line, reason=reason)
    times = responsible(formula, walk, reading.clock).get(
        id(predicate), np.zeros(len(reading.times), dtype=bool)
    )
    times[sample] = True  # of several reasons for a violated until, ρ may name another one
    return Explanation(
        requirement,
        rho,
        unit,
        parts,
        instant=parts[-1].time,
        predicate=parts[-1].text,
        line=parts[-1].line,
        margin=parts[-1].rho,
        margin_unit=_unit(predicate),
        factor=last.factor,
        sides=tuple(_observed(side, algebra, sample) for side in (predicate.left, predicate.right)),
        signals=_signals(predicate, algebra, sample),
        responsible=_runs(times, reading.times),
    )


def _plain(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(value) for value in data]
    return str(data) if isinstance(data, float) and not math.isfinite(data) else data


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _unit(node: f.Value | f.Formula) -> str:
    return "" if node.unit is None else node.unit.text


def _observed(node: f.Value, algebra: SampledAlgebra, sample: int) -> Observed:
    values = algebra.numbers(node)[0]
    return Observed(_one_line(node.span.text), float(values[min(sample, values.size - 1)]), _unit(node))


def _signals(predicate: f.Comparison, algebra: SampledAlgebra, sample: int) -> tuple[Observed, ...]:
    """Return the signals and parameters in a predicate, each once, vectors by component."""
    found: dict[str, Observed] = {}
    for node in f.walk(predicate):
        if not isinstance(node, f.SignalValue | f.ParamValue):
            continue
        values = algebra.numbers(node)
        index = node.index if isinstance(node, f.SignalValue) else None
        for k, component in enumerate(values):
            name = (
                node.name
                if node.width == 1 and index is None
                else f"{node.name}[{k if index is None else index}]"
            )
            value = float(component[min(sample, component.size - 1)])
            found.setdefault(name, Observed(name, value, _unit(node)))
    return tuple(found.values())


def _runs(at: NDArray[np.bool_], times: FloatArray) -> tuple[tuple[float, float], ...]:
    """Return (first, last) time of every run of samples."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], at, [False]))))
    return tuple(
        (float(times[start]), float(times[end - 1]))
        for start, end in zip(edges[::2], edges[1::2], strict=True)
    )
