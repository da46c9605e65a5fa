"""The predicate and sample that decide ρ of each trace."""

from __future__ import annotations

from dataclasses import dataclass

from s2r_spec.attribution.path import Path
from s2r_spec.attribution.place import instant
from s2r_spec.base.json_values import Shown
from s2r_spec.lang import formula as f
from s2r_spec.robustness.deciding import DescentStep


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
