"""Channels that count the other way, as between two conventions of axes: undone by the other sign."""

from __future__ import annotations

from s2r_spec.diagnose.quality.comparison import Comparison
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.suspects import Suspect, named, search, undo


def sign(c: Comparison) -> list[Suspect]:
    """Return the channels whose other sign explains most."""
    _, group, _ = search(c, [1.0], lambda _: -c.recorded)
    words = named(c, group)
    has, it = ("has", "it") if len(group) == 1 else ("have", "them")
    text = (
        f"{words} of the real rollouts {has} the opposite sign of the simulator's. Do both use one sign convention? If "
        f"not, change the sign of {it} in the recordings"
    )
    return [Suspect(Finding("sign", words, text, "the opposite sign"), undo(c, -c.recorded, group))]
