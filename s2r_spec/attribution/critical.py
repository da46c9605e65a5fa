"""The predicate and sample that decide ρ of each trace, and bounds on Δρ that follow from them.

Let c_s and c_r decide ρ of the simulated and of the real trace, and let v be the margin. If ρ is a minimum of margins,

    v_real(c_r) − v_sim(c_r) ≤ Δρ ≤ v_real(c_s) − v_sim(c_s).

The left side holds because ρ_real = v_real(c_r) and ρ_sim ≤ v_sim(c_r). The right side follows in the same way with the
traces exchanged. If ρ is a maximum of margins, the two bounds change places. Other formulas have no such bounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from s2r_spec.attribution.path import Path
from s2r_spec.attribution.place import instant
from s2r_spec.base.json_values import Ends, Shown
from s2r_spec.lang import formula as f
from s2r_spec.robustness.deciding import DescentStep

Kind = Literal["either", "min", "max", "mixed"]


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
        bounds: bounds on Δρ; None if ρ is neither a minimum nor a maximum of margins.
        words: the same in a sentence.
    """

    simulated: Critical
    real: Critical
    bounds: Ends | None

    JSON = "simulated real switches bounds words=__str__"

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

    simulated, real = critical(start.steps), critical(end.steps)
    changes = real.real - real.simulated, simulated.real - simulated.simulated
    over = kind(path.pair.formula)
    return Switch(simulated, real, None if over == "mixed" else changes[::-1] if over == "max" else changes)


def kind(formula: f.Formula, negated: bool = False) -> Kind:
    """Return whether ρ of a formula, or of its negation, is one margin, or a minimum, a maximum or a mix of margins."""
    least: Kind = "max" if negated else "min"
    most: Kind = "min" if negated else "max"
    match formula:
        case f.Named() | f.Rescale() | f.AdjacentSample():
            return kind(formula.operand, negated)
        case f.Not():
            return kind(formula.operand, not negated)
        case f.Junction():
            over = least if formula.operator == "and" else most
            return _join(over, *(kind(operand, negated) for operand in formula.operands))
        case f.Implication():
            if formula.operator == "<->":
                return "mixed"
            return _join(most, kind(formula.left, not negated), kind(formula.right, negated))
        case f.Temporal():
            over = least if formula.operator in ("always", "historically") else most
            return _join(over, kind(formula.operand, negated))
        case f.Edge():
            inner = kind(formula.operand)
            return least if inner == "either" else "mixed"
        case f.Until():
            return "mixed"
        case _:
            return "either"


def _join(over: Kind, *parts: Kind) -> Kind:
    return over if all(part in ("either", over) for part in parts) else "mixed"
