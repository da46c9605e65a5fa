"""What the real rollouts lack for a diagnosis: channels, tests, rollouts that ended whole."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_spec.backend import Backend
from s2r_spec.trace import Trace

Rollout = tuple[dict[str, float], Trace]

CUT = "cut at"
"""In the metadata of a recording of which only the begin is used: until when [s]."""
SHOWN = 6
"""Channels that are named in a note; of more the number is told."""


def notes(
    simulator: Backend, rollouts: Sequence[Rollout], recorded: int, held: int, least: tuple[int, int]
) -> tuple[str, ...]:
    """Return, a sentence each, what these rollouts lack for a diagnosis.

    Args:
        simulator: whose channels they should have.
        rollouts: that were used.
        recorded: how many there were.
        held: how many of them were held out.
        least: from how many different tests, and rollouts, on some are held out.
    """
    found = []
    count = len(rollouts)
    if recorded > count:
        found.append(f"only the first {count} of {recorded} recorded rollouts were used, as the budget says")
    fell = [trace.failure for _, trace in rollouts if trace.failure is not None]
    if fell:
        kinds = ", ".join(sorted({str(failure) for failure in fell}))
        used = (
            "the cause is named from what came before"
            if len(fell) == count
            else "the cause is named from the others"
        )
        found.append(f"{len(fell)} of {count} real rollouts ended early ({kinds}): {used}")
    longer = [trace.meta[CUT] for _, trace in rollouts if CUT in trace.meta]
    if longer:
        found.append(
            f"{len(longer)} of {count} real rollouts go on after the simulator's end: only their first "
            f"{longer[0]:g} s are used"
        )
    lacking = [
        channel.name
        for channel in simulator.channels
        if all(
            channel.name not in trace.channels or not np.isfinite(trace[channel.name]).any()
            for _, trace in rollouts
        )
    ]
    if lacking:
        more = f" and {len(lacking) - SHOWN} more" if len(lacking) > SHOWN else ""
        found.append(
            f"the real rollouts have no {', '.join(lacking[:SHOWN])}{more}: what shows there alone cannot be told"
        )
    tests = {tuple(sorted(test.items())) for test, _ in rollouts}
    if len(tests) == 1 and rollouts[0][0]:
        found.append("all real rollouts are of one test: of the others nothing was seen")
    if not held:
        found.append(
            f"nothing was held out, so how far the gap shrinks was not measured: that takes {least[1]} rollouts of "
            f"{least[0]} different tests, and here are {count} of {len(tests)}"
        )
    return tuple(found)
