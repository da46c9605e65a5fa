"""Cut a long log into episodes, each the trace of one test.

Data: sample times t_k and truth values c_k of a condition. An episode begins where the condition becomes true, c_k and
not c_{k−1}, and lasts for a stated duration. A begin within an episode starts no other one, so that no sample is in
two. An episode that the log does not cover is left out, and so is one whose begin it does not show. But if the log
ended in a failure, its last episode is the one that failed: to leave it out would count only the successes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.robustness.grid import SNAP, Grid
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class EpisodeWindow:
    """The window of an episode in its log.

    Args:
        begin: its first instant [s].
        end: its last instant [s]; inf for the end of the log.
        samples: its samples, in a trace with common samples.
        failed: whether the log's failure ended it, before its time.
    """

    begin: float
    end: float
    samples: slice
    failed: bool = False


@dataclass(frozen=True)
class EpisodeSearch:
    """The episodes of a log as ranges of samples, and the begins of no episode.

    Args:
        ranges: first sample of each episode, and the one after its last.
        already: whether the condition is true at the first sample, so that its begin is not known.
        within: begins within an episode.
        incomplete: begins after which the log is shorter than an episode.
        failed: whether the last episode ended in the log's failure, before its time.
    """

    ranges: tuple[tuple[int, int], ...]
    already: bool
    within: int
    incomplete: int
    failed: bool = False

    def notes(self, condition: str) -> list[str]:
        """Return what was cut, in sentences; they belong to the assumptions of a certificate."""
        count = len(self.ranges)
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


def find_episodes(
    times: FloatArray,
    truth: BoolArray,
    duration: float,
    earliest: float = -np.inf,
    failure: bool = False,
    until: float | None = None,
) -> EpisodeSearch:
    """Return the episodes of a log.

    Args:
        times: (n,) sample times [s].
        truth: (n,) whether the condition is true.
        duration: length of an episode [s].
        earliest: time before which no episode begins [s].
        failure: whether the log ended in a failure.
        until: end of a log of messages [s]; None for the last sample.
    """
    begins = np.flatnonzero(truth[1:] & ~truth[:-1]) + 1
    begins = begins[times[begins] >= earliest]
    slack = slack_of(times)
    ranges: list[tuple[int, int]] = []
    within = incomplete = 0
    failed = False
    for begin in begins.tolist():
        if ranges and (
            begin < ranges[-1][1] if until is None else times[begin] <= times[ranges[-1][0]] + duration
        ):
            within += 1
            continue
        until_here = times[begin] + duration
        end = int(np.searchsorted(times, until_here + slack, side="right"))
        if (times[-1] if until is None else until) < until_here - slack:
            failed = failure
            ranges += [(begin, len(times))] if failure else []
            incomplete += not failure
        else:
            ranges.append((begin, end))
    return EpisodeSearch(tuple(ranges), bool(truth[0]), within, incomplete, failed)


def slack_of(times: FloatArray) -> float:
    """Return by how much a sample may miss an instant that it stands for, by rounding or jitter of a grid [s]."""
    rounding = 16 * math.ulp(max(abs(float(times[0])), abs(float(times[-1]))))
    grid = Grid.of(times) if len(times) > 1 else None
    return rounding if grid is None else max(rounding, (grid.jitter + SNAP) * grid.step)


def take_episode(trace: Trace, window: EpisodeWindow) -> Trace:
    """Return an episode of a trace, with times from 0 on; the failure of the trace is only of the one that it ended."""
    meta = {key: value for key, value in trace.meta.items() if window.failed or key != "failure"}
    if trace.messages:
        begun = [name for name, one in trace.messages.items() if one.times[0] <= window.end]
        episode = trace.only(begun).between(window.begin, window.end).shift(-window.begin)
        return replace(episode, meta=meta)
    kept = window.samples
    channels = {name: values[kept] for name, values in trace.channels.items()}
    masks = {name: mask[kept] for name, mask in trace.masks.items()}
    origin = None if trace.origin is None else take_episode(trace.origin, window)
    times = trace.times[kept] - trace.times[kept][0]
    return Trace(times, channels, trace.units, meta, masks=masks, origin=origin)
