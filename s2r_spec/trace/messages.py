"""Messages of a channel: its own samples, at stamps that other channels of the trace need not have.

Data: stamps t_1 ≤ t_2 ≤ … of a channel with values y_i. Between two messages a channel holds the last value,
or is linear. Several messages may have one stamp; the last one is held. The messages of an episode begin with the last
one before it, whose value is held at its begin.

A channel is **periodic** if the middle 80 % of its intervals lie within ±50 % of their median, its period. Any
other channel is **sent on change**: its value is valid until the next message. The value of a periodic channel is
valid for one period, and through a gap of at most :data:`SILENT` periods.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from types import MappingProxyType
from typing import Any

import numpy as np

from s2r_spec.base.arrays import BoolArray, FloatArray, IntArray

SILENT = 5.0
"""Tolerance: longest gap of a periodic channel that its last value bridges [periods], so that single losses of a
network pass."""
INTERVALS = 10
"""Definition: fewest intervals of a periodic channel: with fewer there is no middle 80 %."""
_MIDDLE, _SPREAD = (0.1, 0.9), (0.5, 1.5)
"""Definition: the quantiles of the intervals of a periodic channel, and the bounds on them [medians]."""


Span = tuple[float, float]
"""Two times with nothing between them [s]."""


def period_of_messages(times: FloatArray) -> float:
    """Return the median interval of (n,) increasing times of a periodic channel [s]; NaN if it is sent on change."""
    steps = np.diff(times)
    steps = steps[steps > 0]
    if steps.size < INTERVALS:
        return math.nan
    period = float(np.median(steps))
    low, high = steps.min(), steps.max()
    if (
        low < _SPREAD[0] * period or high > _SPREAD[1] * period
    ):  # else the quantiles are within the bounds, too
        low, high = np.quantile(steps, _MIDDLE)
    return period if _SPREAD[0] * period <= low and high <= _SPREAD[1] * period else math.nan


def silences_of(times: FloatArray) -> list[Span]:
    """Return the spans without a sample in (n,) increasing times of a periodic signal [s]."""
    period = period_of_messages(times)
    if math.isnan(period):
        return []
    before = np.flatnonzero(np.diff(times) > SILENT * period)
    return [(float(times[i]), float(times[i + 1])) for i in before]


@dataclass(frozen=True, eq=False)
class Messages:
    """The messages of a channel. Frozen: arrays are read-only.

    Args:
        times: (m,) stamps [s], not decreasing, m ≥ 1.
        values: (m,) or (m, k) values; NaN where a message has none.
        period: period of the whole log's messages [s]; NaN if the channel is sent on change.
        longest: time for which a value is valid, as the user states it [s]; NaN if not stated.
        log_end: time at which the log ends [s]; NaN if it is not known.
        end: time until which the last value of the whole log is valid [s].
        linear: whether the channel is linear between messages; else it holds the last value.
        invalid: spans in which a component of a vector from several topics has no valid value [s].
    """

    times: FloatArray
    values: FloatArray
    period: float = math.nan
    longest: float = math.nan
    log_end: float = math.nan
    end: float = math.inf
    linear: bool = False
    invalid: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for array in (self.times, self.values):
            array.setflags(write=False)

    def __len__(self) -> int:
        return int(self.times.size)

    @classmethod
    def of(
        cls,
        times: FloatArray,
        values: FloatArray,
        *,
        longest: float = math.nan,
        log_end: float = math.nan,
        linear: bool = False,
    ) -> Messages:
        """Return the messages of a whole log, with their period and the end of the last value."""
        made = cls(times, values, period_of_messages(times), longest, log_end, linear=linear)
        return replace(made, end=made.valid_until)

    @property
    def first(self) -> float:
        """The first stamp [s]."""
        return float(self.times[0])

    @property
    def last(self) -> float:
        """The last stamp [s]."""
        return float(self.times[-1])

    @property
    def valid_until(self) -> float:
        """Time until which the last value is valid, if it is the last one of the log [s]."""
        return self.last if self.linear else self._valid_after(self.last)

    def held_between(self) -> Messages:
        """Return the messages of a channel that holds its values although its log is interpolated."""
        return replace(self, linear=False, end=self._valid_after(self.end))

    def in_log_until(self, end: float) -> Messages:
        """Return the messages of a log recorded until a time [s]: values sent on change are valid until then."""
        if math.isfinite(self.valid) or self.linear:
            return self
        return replace(self, end=max(self.end, end))

    def _valid_after(self, last: float) -> float:
        """Return until when a last value is valid: for its time, or else until the end of the log, if known [s]."""
        if math.isfinite(self.valid):
            return last + self.valid
        return last if math.isnan(self.log_end) else max(self.log_end, last)

    @property
    def bridged(self) -> float:
        """Longest gap that the last value bridges [s]; inf if the channel is sent on change."""
        if not math.isnan(self.longest):
            return self.longest
        return math.inf if math.isnan(self.period) else SILENT * self.period

    @property
    def valid(self) -> float:
        """Time for which a value is valid where no other one follows within :attr:`bridged` [s]."""
        if not math.isnan(self.longest):
            return self.longest
        return math.inf if math.isnan(self.period) else self.period

    @property
    def recorded_until(self) -> float:
        """Time up to which the messages were recorded, one period after the last of a periodic channel [s]."""
        return self.last if math.isnan(self.period) or self.linear else self.last + self.period

    @property
    def rhythm(self) -> str:
        """What is expected of the next message, in words."""
        if not math.isnan(self.longest):
            return f"a value is valid for {self.longest:.3g} s"
        return f"they come every {self.period:.3g} s"

    def index(self, at: FloatArray) -> IntArray:
        """Return (n,) the number of the last message up to each time; −1 before the first."""
        return np.asarray(np.searchsorted(self.times, at, side="right") - 1)

    def held(self, at: FloatArray) -> FloatArray:
        """Return (n,) or (n, k): the last value up to each time, NaN before the first."""
        index = self.index(at)
        values = self.values[np.maximum(index, 0)]
        if (index < 0).any():
            values[index < 0] = np.nan
        return values

    def read(self, at: FloatArray) -> FloatArray:
        """Return (n,) or (n, k): the values at times, held or linear, NaN before the first message.

        A linear channel holds its last value after its last message.
        """
        held = self.held(at)
        if not self.linear or len(self) < 2:
            return held
        index = self.index(at)
        inside = (index >= 0) & (index < len(self) - 1)
        before, after = index[inside], index[inside] + 1
        width = self.times[after] - self.times[before]
        part = np.divide(at[inside] - self.times[before], width, out=np.zeros(len(before)), where=width > 0)
        part = part.reshape(-1, *(1,) * (self.values.ndim - 1))
        held[inside] = (1.0 - part) * self.values[before] + part * self.values[after]
        return held

    def own(self, at: FloatArray) -> BoolArray:
        """Return (n,) whether a message has exactly this stamp."""
        place = np.minimum(np.searchsorted(self.times, at), len(self) - 1)
        return np.asarray(self.times[place] == at)

    def between(self, start: float, end: float) -> Messages | None:
        """Return the messages from ``start`` to ``end`` [s], with the one before; None if there is none of them.

        A linear channel has the one after, too.
        """
        first = max(int(np.searchsorted(self.times, start, side="right")) - 1, 0)
        first = int(np.searchsorted(self.times, self.times[first], side="left"))
        stop = int(np.searchsorted(self.times, end, side="right")) + self.linear
        if first >= stop:
            return None
        return replace(self, times=self.times[first:stop].copy(), values=self.values[first:stop].copy())

    def shifted(self, by: float) -> Messages:
        """Return the messages, later by so many seconds."""
        invalid = tuple((start + by, end + by) for start, end in self.invalid)
        moved = replace(self, times=self.times + by, invalid=invalid)
        return replace(moved, end=self.end + by, log_end=self.log_end + by)

    def silences(self, start: float, end: float) -> list[tuple[float, float]]:
        """Return the spans without a valid value that overlap ``start`` to ``end`` [s], in order."""
        times, bridged, valid, last = self.times, self.bridged, self.valid, self.last
        spans = [(-math.inf, self.first)] if self.first > start else []
        if math.isfinite(bridged):
            for i in np.flatnonzero(np.diff(times) > bridged):
                before, after = float(times[i]) + valid, float(times[i + 1])
                if after > start and before < end:
                    spans.append((before, after))
        valid_until = min(self.end, last + valid if end - last > bridged else math.inf)
        if valid_until < end:
            spans.append((valid_until, math.inf))
        if not self.invalid:
            return spans
        return _unite([*spans, *(span for span in self.invalid if span[1] > start and span[0] < end)])


def _unite(spans: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return spans in order, as one where they overlap."""
    result: list[tuple[float, float]] = []
    for start, end in sorted(spans):
        if result and start <= result[-1][1]:
            result[-1] = result[-1][0], max(end, result[-1][1])
        else:
            result.append((start, end))
    return result


def union(channels: Iterable[Messages]) -> FloatArray:
    """Return (n,) all stamps of channels, increasing, each once."""
    distinct = {id(one.times): one.times for one in channels}.values()
    result: FloatArray = np.unique(np.concatenate(list(distinct)))
    return result


class HeldChannels(Mapping[str, FloatArray]):
    """Channels with messages, as their values at all stamps of the trace; each is made when it is read."""

    def __init__(self, messages: Mapping[str, Messages], since: float | None, until: float | None) -> None:
        self.messages = MappingProxyType(dict(messages))
        self._since, self._until = since, until

    def __getitem__(self, name: str) -> FloatArray:
        values = self.messages[name].read(self.times)
        values.setflags(write=False)
        return values

    @cached_property
    def times(self) -> FloatArray:
        """(n,) the begin of the trace, and all stamps of all channels in it [s]."""
        times = union(self.messages.values())
        if self._since is not None:
            times = np.union1d(times[times > self._since], self._since)
        if self._until is not None:
            times = times[times <= self._until]
        times.setflags(write=False)
        return times

    def __iter__(self) -> Iterator[str]:
        return iter(self.messages)

    def __len__(self) -> int:
        return len(self.messages)

    def __contains__(self, name: object) -> bool:
        return name in self.messages


def messages_of(channels: Mapping[str, Any]) -> Mapping[str, Messages]:
    """Return the channels that are messages."""
    if isinstance(channels, HeldChannels):
        return channels.messages
    return {name: one for name, one in channels.items() if isinstance(one, Messages)}


def join(parts: list[Messages]) -> Messages:
    """Return the vector of several scalar channels: a message for each stamp of any, from the first one of all on.

    Where a component has several values with one stamp, each combination is a message. Where a component has no valid
    value, the vector has none.
    """
    first = parts[0]
    if all(one.times is first.times or np.array_equal(one.times, first.times) for one in parts):
        return replace(first, values=np.stack([one.values for one in parts], axis=1))
    begin = max(one.first for one in parts)
    known = [one.log_end for one in parts if not math.isnan(one.log_end)]
    reach = max([*known, *(one.last for one in parts)])
    whole = [one for one in parts if reach - one.last <= one.bridged]
    times, values = _combine(parts, begin)
    periods = [one.period for one in parts if not math.isnan(one.period)]
    invalid = tuple(
        span
        for one in parts
        for span in one.silences(begin, reach)
        if math.isfinite(span[1]) or all(one is not other for other in whole)
    )
    period, log_end = min(periods, default=math.nan), max(known, default=math.nan)
    end = min(one.end for one in whole or parts)
    return Messages(times, values, period, first.longest, log_end, end, first.linear, invalid)


def _combine(parts: list[Messages], begin: float) -> tuple[FloatArray, FloatArray]:
    """Return (m,) stamps from a time on and (m, k) values of components, each combination of those with one stamp."""
    stamps = union(parts)
    stamps = stamps[stamps >= begin]
    values = np.stack([one.read(stamps) for one in parts], axis=1)
    repeated = {float(at) for one in parts for at in one.times[1:][np.diff(one.times) == 0] if at >= begin}
    if not repeated:
        return stamps, values
    times, rows = [], []
    for at in sorted(repeated):
        here = np.searchsorted(stamps, at)
        own = [
            one.values[np.searchsorted(one.times, at) : np.searchsorted(one.times, at, side="right")]
            for one in parts
        ]
        kinds = [part if len(part) else values[here, [k]] for k, part in enumerate(own)]
        combinations = [*product(*kinds)]
        times += [at] * len(combinations)
        rows += combinations
    kept = ~np.isin(stamps, [*repeated])
    every = np.concatenate((stamps[kept], times))
    order = np.argsort(every, kind="stable")
    return every[order], np.concatenate((values[kept], np.array(rows)))[order]
