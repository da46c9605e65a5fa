"""The checks that look at one channel at a time, and at one simulated rollout beside each real one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from s2r_spec.backend import Channel
from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.quality.begin import begin
from s2r_spec.diagnose.quality.copied import copied
from s2r_spec.diagnose.quality.factor import opposite, unit, unit_of_one
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.recordings import Recordings
from s2r_spec.diagnose.quality.spike import spike
from s2r_spec.diagnose.quality.still import still
from s2r_spec.diagnose.quality.stopped import stopped
from s2r_spec.diagnose.quality.wrapped import wrapped

Check = Callable[[Channel, Recordings], Finding | None]


def direct(of: Recordings, lines: Sequence[Line] = ()) -> list[Finding]:
    """Return what to say of each channel that is not as the simulator's, one finding each, and of "the tests".

    Args:
        of: the recordings.
        lines: of the catalogue; a channel that none of them moves is a command, and tells when a recording began.
    """
    if not of.pairs:
        return []
    channels = _first_of((still, wrapped, opposite, unit, unit_of_one), of)
    found = [*channels, *copied(of), *begin(of, lines)]
    return list({finding.channel: finding for finding in found}.values())


def glitches(of: Recordings) -> list[Finding]:
    """Return what to say of each channel with samples that one rollout has and most have not."""
    return _first_of((spike, stopped), of)


def _first_of(checks: Sequence[Check], of: Recordings) -> list[Finding]:
    """Return the first finding about every channel."""
    every = [
        next(filter(None, (check(channel, of) for check in checks)), None)
        for channel in of.bench.backend.channels
    ]
    return [one for one in every if one is not None]
