"""Read the tolerance of a requirement off its formula: the constant that a signal is compared with."""

from __future__ import annotations

from collections.abc import Iterator

from s2r_spec.lang import formula as f
from s2r_spec.lang.constants import constant


def smallest_tolerance(formula: f.Formula) -> float | None:
    """Return the smallest positive constant that a predicate compares a signal with, in the unit of ρ.

    None where no predicate has one, or where ρ is a minimum of different dimensions.
    """
    if formula.unit == f.MIXED:
        return None
    return min((size for size in _sizes(formula, 1.0) if size > 0.0), default=None)


def _sizes(node: f.Formula, factor: float) -> Iterator[float]:
    """Yield the absolute constants of all predicates; ``factor`` converts margins at this node to the unit of ρ."""
    if isinstance(node, f.Comparison):
        for side in (node.left, node.right):
            value = constant(side)
            # A number of degrees Celsius is no difference, so no tolerance.
            if value is not None and not (side.unit and side.unit.offset):
                scale = side.unit.to(node.unit)[0] if side.unit and node.unit else 1.0
                yield abs(value) * scale * factor
        return
    scale = node.factor if isinstance(node, f.Rescale) else 1.0
    for part in f.children(node):
        if isinstance(part, f.Formula):
            yield from _sizes(part, factor * scale)
