"""Channels that count the other way, as between two conventions of axes: undone by the other sign."""

from __future__ import annotations

from s2r_spec.diagnose.quality.comparison import Comparison
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.suspects import Suspect, named, search, undo


def sign(c: Comparison) -> list[Suspect]:
    """Return the channels whose other sign explains most."""
    _, group, _ = search(c, [1.0], lambda _: -c.recorded)
    words = named(c, group)
    does, it = ("goes", "does it count") if len(group) == 1 else ("go", "do they count")
    text = (
        f"{words} of the real rollouts {does} the other way than the simulator's: {it} the same way? If not, give "
        f"{'it' if len(group) == 1 else 'them'} the other sign"
    )
    return [Suspect(Finding("sign", words, text, "the other sign"), undo(c, -c.recorded, group))]
