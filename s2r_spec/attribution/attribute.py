"""Δρ of one pair of rollouts, divided into parts of times, of channels and of sub-formulas, and what decides each ρ."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from s2r_spec.attribution.align import align
from s2r_spec.attribution.path import Path, PathPiece
from s2r_spec.attribution.place import instant
from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.json_values import Shown
from s2r_spec.lang import formula as f
from s2r_spec.robustness.deciding import DescentStep
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

WINDOWS = 6
"""Definition: equal windows of time over which Δρ is summed."""


@dataclass(frozen=True)
class FormulaShare:
    """A sub-formula and its part of Δρ.

    Attributes:
        text, line, span: its text in the specification, its line, and (start, end) in the text.
        name: the name of a named sub-formula; "" for others.
        depth: number of sub-formulas around it.
        predicate: whether it is a predicate, the end of a branch.
        amount: its part of Δρ, in the unit of ρ.
    """

    text: str
    name: str
    line: int
    span: tuple[int, int]
    depth: int
    predicate: bool
    amount: float


@dataclass(frozen=True)
class Window:
    """One of equal windows of time, from ``begin`` to ``end`` [s], and its part of Δρ."""

    begin: float
    end: float
    delta: float


@dataclass(frozen=True)
class Critical:
    """The predicate and sample that decide ρ of one trace.

    Attributes:
        predicate, line: its text in the specification, and its line.
        name: name of the innermost named sub-formula around it; "" for none.
        time: time of the sample [s].
        simulated, real: ± its margin on each trace, in the unit of ρ.
    """

    predicate: str
    name: str
    line: int
    time: float
    simulated: float
    real: float

    def __str__(self) -> str:
        within = f" in `{self.name}`" if self.name else ""
        return f"`{self.predicate}`{within} {instant(self.time)}"


@dataclass(frozen=True)
class Switch(Shown):
    """The predicates that decide ρ in simulation and on the real machine.

    Attributes:
        words: the same in a sentence.
    """

    simulated: Critical
    real: Critical

    JSON = "simulated real switches words=__str__"

    @property
    def switches(self) -> bool:
        """Whether the two predicates differ."""
        return (self.simulated.predicate, self.simulated.line) != (self.real.predicate, self.real.line)

    def __str__(self) -> str:
        if self.switches:
            return f"the critical predicate is {self.simulated} in simulation, but {self.real} on the real machine"
        if f"{self.simulated}" == f"{self.real}":
            return f"the critical predicate is {self.simulated} in both"
        later = f"{instant(self.real.time)} on the real machine"
        return f"the critical predicate is {self.simulated} in simulation and {later}"


@dataclass(frozen=True, eq=False)
class Attribution:
    """Δρ of one pair of rollouts in parts: the sum of ``credit``, ``ended`` and ``error`` is ``delta``.

    Attributes:
        requirement: its name.
        unit: the unit of ρ.
        delta: Δρ = ρ_real − ρ_sim.
        times: (n,) common sample times [s].
        credit: channel → (n,) part of each sample; components of vectors have an index ("u[0]").
        real: signal → (width, n) samples of the real trace, in the spec's units.
        simulated: the same of the simulated trace.
        parts: the sub-formulas from the requirement down to its predicates, in written order.
        ended: the part that is not in the common samples: a fall, or samples after the end of the shorter trace.
        reason: what ended the shorter trace; "" if both end together.
        error: the rest: rounding, or all of Δρ if ρ is infinite.
        switch: the critical predicates of both traces; None if no predicate decides ρ.
    """

    requirement: str
    unit: str
    delta: float
    times: FloatArray
    credit: Mapping[str, FloatArray]
    real: Mapping[str, FloatArray]
    simulated: Mapping[str, FloatArray]
    parts: tuple[FormulaShare, ...]
    ended: float
    reason: str
    error: float
    switch: Switch | None

    @property
    def over_time(self) -> FloatArray:
        """(n,) part of each sample, summed over channels."""
        return sum(self.credit.values(), start=np.zeros(self.times.size))

    @property
    def channels(self) -> dict[str, float]:
        """Name of a channel → its contribution to Δρ."""
        return {name: float(values.sum()) for name, values in self.credit.items()}

    def windows(self) -> tuple[Window, ...]:
        """Return the parts of equal windows of time."""
        edges = np.linspace(self.times[0], self.times[-1], WINDOWS + 1)
        place = np.clip(np.searchsorted(edges, self.times, side="right") - 1, 0, WINDOWS - 1)
        sums = np.bincount(place, weights=self.over_time, minlength=WINDOWS)
        return tuple(map(Window, edges[:-1].tolist(), edges[1:].tolist(), sums.tolist()))

    @property
    def window(self) -> Window | None:
        """The window with the largest part; None if the end of a trace has a larger part."""
        largest = max(self.windows(), key=lambda each: abs(each.delta))
        return largest if abs(largest.delta) >= abs(self.ended) else None


def attribute(
    spec: Spec, requirement: str, real: Trace, simulated: Trace, params: Mapping[str, float]
) -> Attribution:
    """Return the parts of Δρ = ρ_real − ρ_sim of one pair of rollouts of a test; for errors see :func:`align`."""
    pair = align(spec, requirement, real, simulated, params)
    path = Path(pair)
    pieces = list(path.pieces())
    sums = {name: np.zeros_like(samples) for name, samples in pair.real.items()}
    for piece in pieces:
        for name, amounts in piece.credit.items():
            sums[name] += amounts
    credit = label_components(sums)
    return Attribution(
        requirement=requirement,
        unit=spec.unit(requirement),
        delta=pair.delta,
        times=pair.times,
        credit=credit,
        real=pair.real,
        simulated=pair.simulated,
        parts=parts(pair.formula, pieces),
        ended=pair.ended,
        reason=pair.reason,
        error=pair.delta - pair.ended - sum(float(values.sum()) for values in credit.values()),
        switch=switch(path),
    )


def parts(formula: f.Formula, pieces: list[PathPiece]) -> tuple[FormulaShare, ...]:
    """Return every sub-formula with the sum of the pieces that it decides, in written order."""
    amounts: dict[int, float] = {}
    for piece in pieces:
        for step in piece.steps:
            amounts[id(step.node)] = amounts.get(id(step.node), 0.0) + piece.amount
    return tuple(
        FormulaShare(
            text=" ".join(node.span.text.split()),
            name=node.name if isinstance(node, f.Named) else "",
            line=node.span.line,
            span=(node.span.start, node.span.end),
            depth=depth,
            predicate=isinstance(node, f.Comparison),
            amount=amounts.get(id(node), 0.0),
        )
        for node, depth in _walk_formulas(formula, 0, set())
    )


def _walk_formulas(node: f.Formula, depth: int, seen: set[int]) -> Iterator[tuple[f.Formula, int]]:
    """Yield every sub-formula down to the predicates with its depth; a named one that is used twice comes once."""
    if id(node) in seen:
        return
    seen.add(id(node))
    if not isinstance(node, f.Rescale):
        yield node, depth
        depth += 1
    if not isinstance(node, f.Comparison):
        for child in f.children(node):
            if isinstance(child, f.Formula):
                yield from _walk_formulas(child, depth, seen)


def label_components(signals: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return label → (n,) of (width, n) signals: a vector's components by index ("u[0]")."""
    return {
        name if len(rows) == 1 else f"{name}[{k}]": row
        for name, rows in signals.items()
        for k, row in enumerate(rows)
    }


def switch(path: Path) -> Switch | None:
    """Return the critical predicates at both ends of a path; None if no predicate decides ρ there."""
    start, end = path.start, path.end
    if not all(isinstance(point.steps[-1].node, f.Comparison) for point in (start, end)):
        return None

    def critical(steps: tuple[DescentStep, ...]) -> Critical:
        last = steps[-1]
        named = next((s.node.name for s in reversed(steps) if isinstance(s.node, f.Named)), "")
        return Critical(
            " ".join(last.node.span.text.split()),
            named,
            last.node.span.line,
            float(path.pair.times[last.sample]),
            path.value(last, start.algebra),
            path.value(last, end.algebra),
        )

    return Switch(critical(start.steps), critical(end.steps))
