"""Which instants, which channels and which parts of the formula make the gap of one pair of rollouts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.where.align import Aligned, align
from s2r_spec.diagnose.where.critical import Switch, switch
from s2r_spec.diagnose.where.path import Path, Piece
from s2r_spec.lang import formula as f
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

BINS = 300
"""Samples that a trace is thinned to for JSON."""


@dataclass(frozen=True)
class Part:
    """A sub-formula, and what of Δρ went through it.

    Attributes:
        text: as it is written.
        name: what it is called, if it is a use of a named sub-formula.
        line: where it is written.
        span: (start, end) of it in the specification's text.
        depth: how many sub-formulas it is in.
        predicate: whether it is one, the end of a branch.
        amount: of Δρ, in the unit of ρ.
    """

    text: str
    name: str
    line: int
    span: tuple[int, int]
    depth: int
    predicate: bool
    amount: float


@dataclass(frozen=True, eq=False)
class Attribution:
    """Δρ of one pair of rollouts, taken apart: the parts, ``ended`` and ``error`` add up to ``delta``.

    Attributes:
        requirement: its name.
        unit: of ρ.
        delta: Δρ = ρ_real − ρ_sim.
        times: (n,) of the common samples [s].
        credit: channel → (n,) what its samples add to Δρ; a vector's components by index ("u[0]").
        real: signal → (width, n) samples of the real trace, in the spec's units.
        simulated: the same of the simulated one, at these times.
        parts: the formula, from the requirement down to its predicates, in written order.
        ended: what the common samples do not show: the end of the shorter trace, a fall.
        reason: what ended it; "" if nothing did.
        jumps: part of Δρ that came in jumps: booleans, counts, directions.
        error: what is left: rounding, or all of it where ρ is infinite.
        switch: what decides ρ on both sides; None if no predicate does.
    """

    requirement: str
    unit: str
    delta: float
    times: FloatArray
    credit: Mapping[str, FloatArray]
    real: Mapping[str, FloatArray]
    simulated: Mapping[str, FloatArray]
    parts: tuple[Part, ...]
    ended: float
    reason: str
    jumps: float
    error: float
    switch: Switch | None

    @property
    def over_time(self) -> FloatArray:
        """(n,) what all channels add at each sample."""
        return sum(self.credit.values(), start=np.zeros(self.times.size))

    def binned(self, most: int = BINS) -> dict[str, Any]:
        """Return the samples as plain data for JSON: means, and sums of what they add, over equal bins of them."""
        starts = np.unique(np.linspace(0, self.times.size, min(most, self.times.size) + 1).astype(int)[:-1])
        counts = np.diff(np.append(starts, self.times.size))

        def plain(values: FloatArray) -> list[float]:
            return [float(f"{value:.6g}") for value in np.add.reduceat(values, starts)]

        rows = {"real": labelled(self.real), "simulated": labelled(self.simulated)}
        return {
            "begin": [float(f"{time:.9g}") for time in self.times[starts]],
            "channels": {
                name: {
                    side: plain(of[name].astype(float) / np.repeat(counts, counts))
                    for side, of in rows.items()
                }
                | {"delta": plain(values)}
                for name, values in self.credit.items()
            },
        }

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON, without the samples."""
        return {
            "requirement": self.requirement,
            "unit": self.unit,
            "delta": self.delta,
            "channels": {name: float(values.sum()) for name, values in self.credit.items()},
            "parts": [vars(part) | {"span": list(part.span)} for part in self.parts],
            "ended": self.ended,
            "reason": self.reason,
            "jumps": self.jumps,
            "error": self.error,
            "switch": None if self.switch is None else self.switch.to_json() | {"words": str(self.switch)},
        }


def attribute(
    spec: Spec, requirement: str, real: Trace, simulated: Trace, params: Mapping[str, float]
) -> Attribution:
    """Take Δρ = ρ_real − ρ_sim of one pair of rollouts apart.

    Args:
        spec: the specification.
        requirement: one of its requirements.
        real: a real rollout.
        simulated: a simulated one of the same test.
        params: the test.

    Raises:
        TraceError: a channel is missing, or does not fit the spec.
        UsageError: a parameter is missing, or a trace fell and the spec declares no ρ for that.
    """
    pair = align(spec, requirement, real, simulated, params)
    path = Path(pair)
    pieces = list(path.pieces())
    credit = _by_channel(pair, pieces)
    return Attribution(
        requirement,
        spec.unit(requirement),
        pair.delta,
        pair.times,
        credit,
        pair.real,
        pair.simulated,
        parts(pair.formula, pieces),
        pair.ended,
        pair.reason,
        sum(piece.amount for piece in pieces if piece.jump),
        pair.delta - pair.ended - sum(float(values.sum()) for values in credit.values()),
        switch(path),
    )


def parts(formula: f.Formula, pieces: list[Piece]) -> tuple[Part, ...]:
    """Return every sub-formula with the sum of what went through it, in written order."""
    amounts: dict[int, float] = {}
    for piece in pieces:
        for step in piece.steps:
            amounts[id(step.node)] = amounts.get(id(step.node), 0.0) + piece.amount
    found: list[Part] = []
    _collect(formula, 0, amounts, found, set())
    return tuple(found)


def _collect(
    node: f.Formula, depth: int, amounts: Mapping[int, float], found: list[Part], seen: set[int]
) -> None:
    if id(node) in seen:
        return  # a named sub-formula that is used twice stands once
    seen.add(id(node))
    if not isinstance(node, f.Rescale):
        span = node.span
        found.append(
            Part(
                " ".join(span.text.split()),
                node.name if isinstance(node, f.Named) else "",
                span.line,
                (span.start, span.end),
                depth,
                isinstance(node, f.Comparison),
                amounts.get(id(node), 0.0),
            )
        )
        depth += 1
    if isinstance(node, f.Comparison):
        return
    for child in f.children(node):
        if isinstance(child, f.Formula):
            _collect(child, depth, amounts, found, seen)


def _by_channel(pair: Aligned, pieces: list[Piece]) -> dict[str, FloatArray]:
    """Return label → (n,) sums over the pieces; every channel that the formula reads is there."""
    sums = {name: np.zeros_like(samples) for name, samples in pair.real.items()}
    for piece in pieces:
        for name, amounts in piece.credit.items():
            sums[name] += amounts
    return labelled(sums)


def labelled(signals: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return label → (n,) of (width, n) signals: a vector's components by index ("u[0]")."""
    return {
        name if len(rows) == 1 else f"{name}[{k}]": row
        for name, rows in signals.items()
        for k, row in enumerate(rows)
    }
