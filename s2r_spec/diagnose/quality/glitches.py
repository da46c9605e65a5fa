"""Samples that look like the recording's doing: which channels are asked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_spec.diagnose.quality.comparison import Rollout
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.spike import spike
from s2r_spec.diagnose.quality.stopped import stopped
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.trace import Trace


def glitches(bench: Bench, rollouts: Sequence[Rollout]) -> list[Finding]:
    """Return what to say of each channel with samples that one rollout has and most have not.

    Args:
        bench: the simulator; it is run once at a test at which a channel seems to have stopped.
        rollouts: the machine's.
    """
    found = []
    for channel in bench.backend.channels:
        name = channel.name
        having = [(n, test, trace) for n, (test, trace) in enumerate(rollouts) if _read(trace, name)]
        if len(having) < 2:
            continue
        if words := spike(name, having, channel.unit):
            found.append(Finding("spike", name, words))
        elif words := stopped(bench, name, having):
            found.append(Finding("stopped", name, words))
    return found


def _read(trace: Trace, name: str) -> bool:
    """Return whether a trace has a channel of measured numbers: neither a flag nor a count."""
    if name not in trace.channels or len(trace) < 3:
        return False
    values = trace[name]
    return bool(np.isfinite(values).all()) and not (values == np.round(values)).all()
