"""What the real rollouts are in the simulator's terms, and what they lack: units, channels, falls, tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend
from s2r_spec.errors import UsageError
from s2r_spec.lang.units import UnknownUnitError, parse_unit
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Rollout = tuple[dict[str, float], Trace]

SHOWN = 6
"""Channels that are named in a note; of more the number is told."""


def as_simulated(trace: Trace, simulator: Backend) -> Trace:
    """Return the trace with every channel in the unit that the simulator has for it, and NaN for what is no number.

    A channel without a unit is taken to be in the simulator's.

    Raises:
        UsageError: a unit of the trace does not convert, or is none.
    """
    channels, units = dict(trace.channels), dict(trace.units)
    for channel in simulator.channels:
        name, recorded = channel.name, units.get(channel.name, "")
        if name not in channels:
            continue
        values = channels[name]
        if recorded and channel.unit and recorded != channel.unit:
            values = _converted(values, name, recorded, channel.unit, simulator.name)
            units[name] = channel.unit
        channels[name] = (
            values if np.isfinite(values).all() else np.where(np.isfinite(values), values, np.nan)
        )
    return replace(trace, channels=channels, units=units)


def _converted(values: FloatArray, name: str, recorded: str, wanted: str, simulator: str) -> FloatArray:
    try:
        there, here = parse_unit(recorded), parse_unit(wanted)
    except UnknownUnitError as error:
        raise UsageError(
            f"the channel {name!r} is recorded in {recorded!r}, and {error} is no unit that s2r knows"
        ) from None
    if not here.fits(there):
        raise UsageError(
            f"the channel {name!r} is recorded in {recorded}, which does not convert to the {wanted} that backend "
            f"{simulator!r} has; correct the unit in the recording, or leave the channel out"
        )
    factor, offset = there.to(here)
    return values if (factor, offset) == (1.0, 0.0) else factor * values + offset


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
