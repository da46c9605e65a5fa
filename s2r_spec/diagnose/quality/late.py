"""Channels whose stamps are later than those of the others: undone by reading them later.

The size is the delay [s]; of channels that come early it is negative. All channels together means that the recordings
begin at another time than their tests.
"""

from __future__ import annotations

import numpy as np

from s2r_spec.diagnose.quality.comparison import LATEST, Comparison
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.suspects import Suspect, channels, named, search, undo

SHORTEST = 1 / 400
"""Tolerance: part of a rollout that a delay has at least; twice as much misses shorter ones."""


def late(c: Comparison) -> list[Suspect]:
    """Return the delay and the channels that explain most."""
    later = np.geomspace(SHORTEST, LATEST, 9) * c.times[-1] / (1.0 - LATEST)
    sizes = [*(-later[::-1]).tolist(), *later.tolist()]
    by, group, _ = search(c, sizes, lambda size: c.read(late=size))
    values = undo(c, c.read(late=by), group)
    rest = frozenset(channels(c)) - group
    much, when = f"{abs(by):.2g} s", "late" if by > 0.0 else "early"
    if not rest:
        text = (
            f"all channels of the real rollouts are {much} {'later' if by > 0.0 else 'earlier'} than the simulator's. "
            f"Do the recordings begin {much} too {'early' if by > 0.0 else 'late'}? If so, shift the times so that "
            f"each recording begins with its test"
        )
        said = Finding("begin", "the clock", text, "a recording that begins at another time")
        return [Suspect(said, values)]
    # It is the few that are said to be wrong; late poses are early commands.
    many = len(group) > len(rest)
    text = (
        f"{named(c, group)} {'is' if len(group) == 1 and not many else 'are'} {much} {when} against "
        f"{named(c, rest) if many else 'the other channels'} from the first sample on. Do all channels get their "
        f"timestamps from the same clock? If not, shift their times by this delay"
    )
    return [Suspect(Finding("late", named(c, group), text, "a wrong clock"), values)]
