"""One recording that stands under two tests."""

from __future__ import annotations

from collections.abc import Sequence

from s2r_spec.diagnose.quality.comparison import Rollout
from s2r_spec.diagnose.quality.pairs import called
from s2r_spec.diagnose.simulate import Bench, blamed
from s2r_spec.space import key_of
from s2r_spec.trace import Trace


def copied(bench: Bench, rollouts: Sequence[Rollout]) -> str:
    """Say of the first recording that stands under two tests; not where these are one to the simulator, too."""
    seen: dict[tuple[bytes, ...], int] = {}
    for number, (test, trace) in enumerate(rollouts):
        first = seen.setdefault(_bytes(trace), number)
        before = rollouts[first][0]
        if key_of(before) == key_of(test):
            continue
        with blamed(bench, {}, test, 0):
            alike = _bytes(bench.run({}, before, 0)) == _bytes(bench.run({}, test, 0))
        if alike:
            return ""
        return f"{called(number, test)} equals {called(first, before)} in every sample. Which test was it?"
    return ""


def _bytes(trace: Trace) -> tuple[bytes, ...]:
    return tuple(values.tobytes() for _, values in sorted(trace.channels.items()))
