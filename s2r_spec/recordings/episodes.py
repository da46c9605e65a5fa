"""Cut a long log into episodes, each the trace of one test.

Data: sample times t_k and truth values c_k of a condition. An episode begins where the condition becomes true, c_k and
not c_{k−1}, and lasts for a stated duration. A begin within an episode starts no other one, so that no sample is in
two. An episode that the log does not cover is left out, and so is one whose begin it does not show. But if the log
ended in a failure, its last episode is the one that failed: to leave it out would count only the successes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from s2r_spec.base.arrays import BoolArray, FloatArray
from s2r_spec.lang.declarations import Signal
from s2r_spec.robustness.grid import SNAP, Grid
from s2r_spec.spec import Spec, parse_spec
from s2r_spec.trace import Trace

_CONDITION = "when"


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
    slack = _slack(times)
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


def _slack(times: FloatArray) -> float:
    """Return by how much a sample may miss an instant that it stands for, by rounding or jitter of a grid [s]."""
    rounding = 16 * math.ulp(max(abs(float(times[0])), abs(float(times[-1]))))
    grid = Grid.of(times) if len(times) > 1 else None
    return rounding if grid is None else max(rounding, (grid.jitter + SNAP) * grid.step)


def find_windows(
    trace: Trace, signals: Mapping[str, Signal], when: str | None, start: float, duration: float
) -> tuple[list[EpisodeWindow], list[str]]:
    """Return the windows of the episodes in a log, and sentences on how they were cut.

    Args:
        trace: the log.
        signals: the declared signals, for the units in the condition.
        when: condition that begins an episode as it becomes true; None for one episode.
        start: time after the log's begin from which episodes may begin [s].
        duration: length of an episode [s].
    """
    if trace.origin is not None:  # an episode begins with the message that makes the condition true
        windows, sentences = find_windows(trace.origin, signals, when, start, duration)
        slack = _slack(trace.times)
        for number, one in enumerate(windows):
            first, stop = map(int, np.searchsorted(trace.times, (one.begin, one.end + slack)))
            windows[number] = replace(one, samples=slice(first, max(stop, first + 1)))
        return windows, sentences
    if when is None:
        return _single_window(trace, start, duration)
    condition = _condition(trace, signals, when)
    times, truth = _truth(condition, trace.only(condition.channels(_CONDITION)), trace.begin)
    until = trace.ends if trace.messages else None
    found = find_episodes(times, truth, duration, trace.begin + start, trace.failure is not None, until)
    windows = [
        EpisodeWindow(float(times[first]), float(times[first]) + duration, slice(first, end))
        for first, end in found.ranges
    ]
    if found.failed:
        windows[-1] = replace(windows[-1], end=math.inf, failed=True)
    return windows, found.notes(when)


def equal_windows(trace: Trace, start: float, every: float) -> tuple[list[EpisodeWindow], list[str]]:
    """Return windows of ``every`` seconds, one after the other from ``start`` after the log's begin, and what was cut.

    The last sample of a window is the first of the next one, so that each covers its whole length.
    """
    windows: list[EpisodeWindow] = []
    while found := _single_window(trace, start + len(windows) * every, every)[0]:
        windows += found
    count = len(windows)
    return windows, [f"{count} part{'s' * (count != 1)} of {every:g} s, one after the other"]


def _truth(condition: Spec, trace: Trace, begin: float) -> tuple[FloatArray, BoolArray]:
    """Return (n,) times and whether a condition is true; before the first value of a channel it is not."""
    if trace.messages:
        evaluation = condition.evaluate(trace, _CONDITION)
        early = [begin] if begin < evaluation.times[0] else []
        times = np.concatenate((early, evaluation.times))
        return times, np.concatenate((np.zeros(len(early), bool), evaluation.truth & evaluation.complete))
    known = np.ones(len(trace), dtype=bool)
    for values in trace.channels.values():
        known &= ~np.isnan(values.reshape(len(trace), -1)).any(axis=1)
    truth = np.zeros(len(trace), dtype=bool)
    if known.any():
        first = int(np.argmax(known))
        rest = EpisodeWindow(float(trace.times[first]), math.inf, slice(first, None), failed=True)
        evaluation = condition.evaluate(take_episode(trace, rest), _CONDITION)
        truth[first:] = evaluation.truth & evaluation.complete
    return trace.times, truth


def _single_window(trace: Trace, start: float, duration: float) -> tuple[list[EpisodeWindow], list[str]]:
    """Return the one episode from a time on; none, with the reason, if the log does not hold it."""
    failed = trace.failure is not None
    first = trace.begin
    if trace.messages:
        complete = trace.ends >= first + start + duration - 16 * math.ulp(trace.ends)
        if complete or (failed and first + start <= trace.ends):
            end = first + start + duration if complete else math.inf
            return [EpisodeWindow(first + start, end, slice(0, 0), not complete)], []
    else:
        times = trace.times - first
        slack = _slack(trace.times)
        begin = int(np.searchsorted(times, start - slack))
        stop = int(np.searchsorted(times, start + duration + slack, side="right"))
        complete = times[-1] >= start + duration - slack
        if begin < stop and (complete or failed):
            end = first + start + duration
            return [EpisodeWindow(float(trace.times[begin]), end, slice(begin, stop), not complete)], []
    span = f"{start:.6g} s to {start + duration:.6g} s"
    lasts = trace.times[-1] - trace.times[0]
    if lasts > start + duration:
        return [], [f"the log has no sample from {span}, and an episode needs all of it"]
    return [], [f"the log ends {lasts:.6g} s after its first sample, and an episode needs {span}"]


def _condition(trace: Trace, signals: Mapping[str, Signal], text: str) -> Spec:
    """Return a specification of the condition, which may name every channel that was read."""
    lines = []
    for name in filter(str.isidentifier, trace.channels):
        signal = signals.get(name)
        unit = trace.units.get(name, "") if signal is None else signal.unit
        width = "" if trace[name].ndim == 1 else f"[{trace[name].shape[1]}]"
        shape = width + (f" {{{unit}}}" if unit else "")
        lines.append(f"signal {name}{' bool' if signal is not None and signal.boolean else shape}")
    return parse_spec("\n".join([*lines, f"require {_CONDITION}: {text}"]), "--when")


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
