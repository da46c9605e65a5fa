"""Channels whose stamps are later than those of the others: undone by reading them later.

The size is the delay [s]; of channels that come early it is negative. All channels together means that the recordings
begin at another time than their tests.
"""

from __future__ import annotations

import numpy as np

from s2r_spec.diagnose.quality.comparison import Comparison
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.suspects import Suspect, channels, named, search, undo

LONGEST = 0.1
"""Definition: part of a rollout that a delay is looked for up to; what is compared leaves as much unread."""
SHORTEST = 1 / 400
"""Tolerance: the same of the shortest; twice as much misses shorter ones."""


def late(c: Comparison) -> list[Suspect]:
    """Return the delay and the channels that explain most."""
    whole = c.times[-1] / (1.0 - LONGEST)
    later = np.geomspace(SHORTEST, LONGEST, 9) * whole
    sizes = [*(-later[::-1]).tolist(), *later.tolist()]
    by, group, _ = search(c, sizes, lambda size: c.read(late=size))
    values = undo(c, c.read(late=by), group)
    rest = frozenset(range(len(channels(c)))) - group
    when = "late" if by > 0.0 else "early"
    if not rest:
        text = (
            f"all channels of the real rollouts are {abs(by):.2g} s {'later' if by > 0.0 else 'earlier'} than the "
            f"simulator's. Do the recordings begin {abs(by):.2g} s too {'early' if by > 0.0 else 'late'}? "
        )
        return [
            Suspect(
                Finding("begin", "the clock", text + CUT, "a recording that begins at another time"), values
            )
        ]
    if len(group) > len(rest):
        # It is the few that are said to be wrong; late poses are early commands.
        text = (
            f"{named(c, group)} are {abs(by):.2g} s {when} against {named(c, rest)} from the first sample on. "
            f"Do all channels get their timestamps from the same clock? "
        )
    else:
        text = (
            f"{named(c, group)} {'is' if len(group) == 1 else 'are'} {abs(by):.2g} s {when} against the other channels "
            f"from the first sample on. Do all channels get their timestamps from the same clock? "
        )
    return [Suspect(Finding("late", named(c, group), text + SHIFT, "a wrong clock"), values)]


CUT = "If so, shift the times so that each recording begins with its test"
SHIFT = "If not, shift their times by this delay"
