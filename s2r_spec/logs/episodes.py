"""Cut a long log into episodes, each the trace of one test.

Data: sample times t_k and truth values c_k of a condition. An episode begins where the condition becomes true, c_k and
not c_{k−1}, and lasts for a stated duration. A begin within an episode starts no other one, so that no sample is in
two. An episode that the log does not cover is left out, and so is one whose begin it does not show. But if the log
ended in a failure, its last episode is the one that failed: to leave it out would count only the successes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Cut:
    """Episodes of a log, as ranges of samples.

    Args:
        spans: first sample of each episode, and the one after its last.
        already: whether the condition is true at the first sample, so that its begin is not known.
        within: begins within an episode.
        incomplete: begins after which the log is shorter than an episode.
        failed: whether the last episode ended in the log's failure, before its time.
    """

    spans: tuple[tuple[int, int], ...]
    already: bool
    within: int
    incomplete: int
    failed: bool = False

    def notes(self, condition: str) -> list[str]:
        """Return what was cut, in sentences; they belong to the assumptions of a certificate."""
        count = len(self.spans)
        sentences = [
            f"{count} episode{'s' * (count != 1)} begin{'s' * (count == 1)} where {condition} becomes true"
        ]
        if self.already:
            sentences.append("the condition is true at the first sample, so that its begin is not in the log")
        if self.within:
            within = "begin lies" if self.within == 1 else "begins lie"
            sentences.append(f"{self.within} more {within} within an episode, so that no sample is in two")
        if self.incomplete:
            left = "begin is" if self.incomplete == 1 else "begins are"
            sentences.append(
                f"{self.incomplete} more {left} left out, because the log ends within the episode; if it ended in a "
                f"failure, the episodes count only successes"
            )
        if self.failed:
            sentences.append("the last episode ended in the log's failure")
        return sentences


def cut(
    times: FloatArray, truth: BoolArray, duration: float, earliest: float = -np.inf, failure: bool = False
) -> Cut:
    """Return the episodes of a log.

    Args:
        times: (n,) sample times [s].
        truth: (n,) whether the condition is true.
        duration: length of an episode [s].
        earliest: time before which no episode begins [s].
        failure: whether the log ended in a failure.
    """
    begins = np.flatnonzero(truth[1:] & ~truth[:-1]) + 1
    begins = begins[times[begins] >= earliest]
    period = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    spans: list[tuple[int, int]] = []
    within = incomplete = 0
    failed = False
    for begin in begins.tolist():
        if spans and begin < spans[-1][1]:
            within += 1
            continue
        # The last sample may miss the end by rounding; half a period tells it from its neighbour.
        end = int(np.searchsorted(times, times[begin] + duration + 0.5 * period))
        if times[-1] < times[begin] + duration - 0.5 * period:
            failed = failure
            spans += [(begin, len(times))] if failure else []
            incomplete += not failure
        else:
            spans.append((begin, end))
    return Cut(tuple(spans), bool(truth[0]), within, incomplete, failed)


def part(trace: Trace, first: int, end: int, failed: bool = True) -> Trace:
    """Return samples of a trace, with times from 0 on; only with ``failed`` the failure of the trace is its own."""
    meta = {key: value for key, value in trace.meta.items() if failed or key != "failure"}
    channels = {name: values[first:end] for name, values in trace.channels.items()}
    return Trace(trace.times[first:end] - trace.times[first], channels, trace.units, meta)
