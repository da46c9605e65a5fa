"""One recording that stands under two tests."""

from __future__ import annotations

from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.recordings import Recordings, called
from s2r_spec.space import key_of
from s2r_spec.trace import Trace


def copied(of: Recordings) -> list[Finding]:
    """Find the first recording that stands under two tests; not where these are one to the simulator, too."""
    seen: dict[tuple[bytes, ...], int] = {}
    for number, (test, trace) in enumerate(of.rollouts):
        first = seen.setdefault(_bytes(trace), number)
        before = of.rollouts[first][0]
        if key_of(before) == key_of(test):
            continue
        if _bytes(of.simulated(before)) == _bytes(of.simulated(test)):
            return []
        text = f"{called(number, test)} equals {called(first, before)} in every sample. Which test was it?"
        return [Finding("copied", "the tests", text)]
    return []


def _bytes(trace: Trace) -> tuple[bytes, ...]:
    return tuple(values.tobytes() for _, values in sorted(trace.channels.items()))
