"""A trace: the channels that one rollout recorded, as a specification reads them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from math import isnan
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import TraceError, TraceNote
from s2r_spec.base.upper import upper
from s2r_spec.trace.channels import Channels
from s2r_spec.trace.messages import Messages
from s2r_spec.trace.samples import Rule, between, finite_seconds, inside, regular, seconds_of


class Trace(Channels):
    """Channels over time. Frozen: arrays are read-only copies.

    The channels have common samples, or each has messages of its own (:class:`~s2r_spec.trace.messages.Messages`), as
    the topics of a log have. Then the times are all stamps of all channels, and ``trace[name]`` has the value that is
    held at each of them; :attr:`own` tells which are the channel's own.

    Args:
        times: (n,) time stamps [s], strictly increasing, n ≥ 1. Durations (``timedelta64``) become
            seconds; dates (``datetime64``, ``datetime``) seconds since the first of them. None for messages.
        channels: name → (n,) or (n, k) samples, read as float64. Masked samples become NaN, and durations seconds. A
            pint Quantity keeps its unit. Or name → messages.
        units: name → unit as a text ("m/s"); a channel without an entry has no unit.
        meta: values that can be written as JSON. ``meta["failure"]`` is reserved for a short word ("fall") if the
            rollout ended early; see :attr:`failure`.
        since: begin of the trace [s]; None for that of the first message. Only for messages.
        until: end of the trace [s]; None for that of the log. Only for messages.
        origin: the messages from which these samples were taken at the stamps of one topic; None for others.
        masks: name → (n,) whether a sample is the channel's own, and not held or interpolated, in a trace that was
            resampled; all are, if there is no entry.

    Raises:
        TraceError: times do not increase or are not finite, a channel has another length or no numbers, a unit is no
            text, or ``meta["failure"]`` is not a word.
    """

    @classmethod
    def of_messages(
        cls,
        channels: Mapping[str, Messages],
        units: Mapping[str, str] = MappingProxyType({}),
        meta: Mapping[str, Any] = MappingProxyType({}),
        since: float | None = None,
        until: float | None = None,
    ) -> Trace:
        """Return the trace of channels that have messages of their own; see :class:`Trace`."""
        return cls(None, channels, units, meta, since, until)  # type: ignore[arg-type]

    def common(self) -> Trace:
        """Return this trace with common samples, if the messages of all channels have the same stamps.

        Else return it unchanged, and so one that begins between two messages, has two with one stamp, or whose messages
        end before the log, so that a silence follows.
        """
        if not self.messages:
            return self
        first, *others = self.messages.values()
        times = first.times
        if any(one.times is not times and not np.array_equal(one.times, times) for one in others):
            return self
        since = times[0] if self.since is None else self.since
        begin, stop = np.searchsorted(times, since), np.searchsorted(times, self.ends, side="right")
        inner = times[begin:stop]
        stated = any(not isnan(one.longest) for one in self.messages.values())
        recorded = max(one.log_end for one in self.messages.values()) if self.until is None else self.until
        if stated or not inner.size or inner[0] != since or (np.diff(inner) <= 0).any():
            return self
        if any(one.invalid or recorded - inner[-1] > one.bridged for one in self.messages.values()):
            # One topic is evaluated at its messages, so that none of its values lies on a line between two.
            held = {name: one.held_between() if one.linear else one for name, one in self.messages.items()}
            return self._with_messages(held)
        if inner.size == times.size:
            return Trace(times, {n: one.values for n, one in self.messages.items()}, self.units, self.meta)
        channels = {name: one.values[begin:stop] for name, one in self.messages.items()}
        return Trace(inner, channels, self.units, self.meta)

    def as_messages(self) -> Trace:
        """Return common samples as the messages of one topic, whose values are held."""
        if self.messages or not self.channels:
            return self
        messages = {name: Messages.of(self.times, values) for name, values in self.channels.items()}
        return Trace.of_messages(messages, self.units, self.meta)

    def known(self) -> Trace:
        """Return the samples at the stamps of a clock from the first to the last at which every channel has a value."""
        if self.origin is None or not self.channels:
            return self
        known = np.logical_and.reduce(
            [~np.isnan(values.reshape(len(self), -1)).any(axis=1) for values in self.channels.values()]
        )
        if (known[0] and known[-1]) or not known.any():
            return self
        kept = slice(int(np.argmax(known)), len(self) - int(np.argmax(known[::-1])))
        return self._at(kept, self.times[kept])

    def with_channels(self, change: Callable[[str, FloatArray], FloatArray]) -> Trace:
        """Return this trace with other values: ``change(name, values)`` of every channel's own samples."""
        if self.messages:
            changed = {n: replace(one, values=change(n, one.values)) for n, one in self.messages.items()}
            return self._with_messages(changed)
        channels = {name: change(name, values) for name, values in self.channels.items()}
        return self._with_samples(lambda origin: origin.with_channels(change), channels=channels)

    def only(self, names: Iterable[str]) -> Trace:
        """Return this trace with only these channels; of messages, without the stamps of the others."""
        names = list(names)
        units = {name: unit for name, unit in self.units.items() if name in names}
        for name in names:
            if name not in self:
                self[name]  # raises
        if self.messages:
            return self._with_messages({name: self.messages[name] for name in names}, units=units)
        channels = {name: self[name] for name in names}
        return self._with_samples(lambda origin: origin.only(names), channels=channels, units=units)

    # -- other times and names -----------------------------------------------------------------------------------

    def between(self, start: Any, end: Any) -> Trace:
        """Return the samples from ``start`` to ``end``, both included; they keep their times.

        ``meta`` stays as it is, so that the ρ of a trace with a failure is the declared one, also for a part.

        Args:
            start: time [s] on the clock of the trace, or a duration (``timedelta``).
            end: time [s]; ``float("inf")`` for the last sample.

        Raises:
            TraceError: an argument is no time, the end is before the start, or no sample lies between the two.
        """
        low, high = seconds_of(start, "start"), seconds_of(end, "end")
        if not self.messages:
            chosen = inside(self.times, low, high)
            return self._at(chosen, self.times[chosen])._with_samples(
                lambda origin: origin.between(low, high)
            )
        if high < low:
            raise TraceError(f"the end, {high:g} s, is before the start, {low:g} s")
        parts = {name: one.between(low, high) for name, one in self.messages.items()}
        kept = {name: one for name, one in parts.items() if one is not None}
        if len(kept) < len(parts):
            lacking = min(set(parts) - set(kept))
            raise TraceError(f"the channel {lacking!r} has no value from {low:g} s to {high:g} s")
        since = low if self.since is None else max(self.since, low)
        return self._with_messages(kept, since=since, until=self.until if self.ends <= high else high)

    def shift(self, by: Any) -> Trace:
        """Return this trace with all times later by so many seconds (or a ``timedelta``); earlier if negative.

        ``trace.shift(-trace.times[0])`` begins at 0.

        Raises:
            TraceError: the argument is not a finite duration.
        """
        later = finite_seconds(by, "the shift")
        if not self.messages:
            return self._at(slice(None), self.times + later)._with_samples(lambda origin: origin.shift(later))
        moved = {name: one.shifted(later) for name, one in self.messages.items()}
        since, until = (None if end is None else end + later for end in (self.since, self.until))
        return self._with_messages(moved, since=since, until=until)

    def at_busiest(self) -> Trace:
        """Return channels with messages at the stamps of the one with the most, from the first value of each on."""
        if not self.messages:
            return self
        first = max(one.first for one in self.messages.values())
        since = first if self.since is None else max(first, self.since)
        times = np.unique(max(self.messages.values(), key=len).times)
        inner = times[(times > since) & (times <= self.ends)]
        return self.sampled_at(np.concatenate(([since], inner)))

    def resample(self, period: Any, rule: Rule | Mapping[str, Rule] = "hold") -> Trace:
        """Return this trace at regular times, from its first time on.

        The rules are those that join the topics of a log:

            hold     the last sample up to this time, as a controller sees a signal
            linear   between the samples before and after it

        Nothing is extrapolated: the last time is at most the last one of the trace. No filter is applied. So a longer
        period keeps single samples, and noise above half the new rate folds back.

        Args:
            period: time from one sample to the next [s], or a ``timedelta``.
            rule: "hold" or "linear" for all channels; or channel → rule, and the other channels hold.

        Raises:
            TraceError: the period is not positive, is longer than the trace, or gives too many samples; or a rule
                is not one of the two, or is for no channel.
        """
        rules = self._rules(rule)
        times, at = regular(self.times, finite_seconds(period, "the period"))
        for name, (start, end) in self.silences().items():
            warnings.warn(
                f"{name} has no message from t = {start:.6g} s to {end:.6g} s; resampled, it has values there",
                TraceNote,
                stacklevel=2,
            )
        if self.messages:
            return self.sampled_at(times, rules)
        channels = {
            name: values[at] if rules[name] == "hold" else between(times, self.times, values)
            for name, values in self.channels.items()
        }
        fresh = self.times[at] == times
        masks = {
            name: self.own(name)[at] & fresh for name in channels if name in self.masks or not fresh.all()
        }
        return Trace(times, channels, self.units, self.meta, masks=masks)

    def silences(self) -> dict[str, tuple[float, float]]:
        """Return channel → the longest span before its end in which it has no valid value [s]."""
        longest = {}
        for name, one in (self if self.messages else self.as_messages()).messages.items():
            spans = one.silences(self.begin, self.ends)
            inner = [(start, min(end, self.ends)) for start, end in spans if self.begin < start < self.ends]
            if inner:
                longest[name] = max(inner, key=lambda span: span[1] - span[0])
        return longest

    def sampled_at(self, times: FloatArray, rules: Mapping[str, str] | None = None) -> Trace:
        """Return channels with messages at common times: a trace whose requirements are evaluated at these samples.

        Messages between two of the times are left out, and :attr:`masks` tell which samples are a channel's own.

        Args:
            times: (n,) increasing times [s].
            rules: channel → "hold" or "linear"; None for its own rule.
        """
        channels, masks = {}, {}
        for name, one in self.messages.items():
            one = one if rules is None else replace(one, linear=rules[name] == "linear")
            channels[name], masks[name] = one.read(times), one.own(times)
        return Trace(times, channels, self.units, self.meta, masks=masks)

    def rename(self, names: Mapping[str, str]) -> Trace:
        """Return this trace with other names of channels: old name → new name; units go with them.

        Raises:
            TraceError: there is no such channel, or two channels would have one name.
        """
        for old, new in names.items():
            self[old]
            if not isinstance(new, str) or not new:
                raise TraceError(f"the new name of channel {old!r} is {new!r}; it must be a text")
        kept = [names.get(name, name) for name in self.channels]
        units = {names.get(name, name): unit for name, unit in self.units.items()}
        if twice := [name for name in kept if kept.count(name) > 1]:
            raise TraceError(f"two channels would be called {twice[0]!r}; give them different names")
        if self.messages:
            return self._with_messages(dict(zip(kept, self.messages.values(), strict=True)), units=units)
        channels = dict(zip(kept, self.channels.values(), strict=True))
        masks = {names.get(name, name): mask for name, mask in self.masks.items()}
        return self._with_samples(
            lambda origin: origin.rename(names), channels=channels, units=units, masks=masks
        )

    def _rules(self, rule: Rule | Mapping[str, Rule]) -> dict[str, str]:
        """Return channel → its rule.

        Raises:
            TraceError: a rule is not one of the two, or is for no channel.
        """
        rules = dict(rule) if isinstance(rule, Mapping) else dict.fromkeys(self.channels, rule)
        for name, one in rules.items():
            self[name]
            if one not in ("hold", "linear"):
                raise TraceError(f"the rule {one!r} of channel {name!r} is not one of hold, linear")
        return {name: rules.get(name, "hold") for name in self.channels}

    def _with_messages(self, channels: Mapping[str, Messages], **changes: Any) -> Trace:
        """Return this trace with other messages, and other fields."""
        return Trace.of_messages(
            channels,
            **{"units": self.units, "meta": self.meta, "since": self.since, "until": self.until} | changes,
        )

    def _with_samples(self, change: Callable[[Trace], Trace], **fields: Any) -> Trace:
        """Return this trace with other fields, and its origin changed."""
        return replace(self, origin=None if self.origin is None else change(self.origin), **fields)

    def _at(self, chosen: slice, times: FloatArray) -> Trace:
        """Return chosen samples, at these times."""
        channels = {name: values[chosen] for name, values in self.channels.items()}
        masks = {name: mask[chosen] for name, mask in self.masks.items()}
        return replace(self, times=times, channels=channels, masks=masks)

    # -- data frames -----------------------------------------------------------------------------------------------

    @classmethod
    def from_dataframe(
        cls,
        frame: Any,
        time: str | None = None,
        units: Mapping[str, str] | None = None,
        *,
        time_unit: str | None = None,
    ) -> Trace:
        """Return the trace of a data frame of pandas or polars, of an Arrow table, or of another Arrow object.

        A frame is read like a file with the same columns. Columns that hold no numbers are left out, with a warning
        (:class:`~s2r_spec.base.errors.TraceNote`). Columns ``q[0]``, ``q[1]`` make one vector, and a header ``vx
        [m/s]`` states its unit. Needs the extra ``tables``.

        Args:
            frame: the frame.
            time: name of the column, or of the index, with the times; None for the column ``t``, or else for an
                index of dates or durations. Durations become seconds, and dates seconds since the first of them.
            units: channel → unit ("m/s"), on top of those in ``frame.attrs["units"]``.
            time_unit: unit of times that are plain numbers ("ms", "ns"); None for seconds.

        Raises:
            TraceError: there is no column of times, a time is missing, or the times do not increase.
            UsageError: it is not a frame.
        """
        loaded = upper("logs.formats.dataframe").read(frame, time, units, time_unit)
        left_out = [f"the column {name!r} is left out: {reason}" for name, reason in loaded.left_out.items()]
        for note in (*loaded.notes, *left_out):
            warnings.warn(note, TraceNote, stacklevel=2)
        trace: Trace = loaded.trace
        return trace

    def to_dataframe(self, library: Literal["pandas", "polars", "pyarrow"] = "pandas") -> Any:
        """Return a data frame with a column for each channel; a vector has columns ``q[0]``, ``q[1]``.

        A frame of pandas has the times [s] as its index ``t``, and units and meta in ``attrs``. The others have a
        column ``t``. :meth:`from_dataframe` returns the same trace again; a frame of polars holds neither units nor
        meta. Needs the extra ``tables``.

        Raises:
            TraceError: the library is not installed, or two columns would have one name.
        """
        return upper("logs.formats.dataframe").frame_of(self, library)

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset`` over ``t`` [s]; each variable has its unit in ``attrs["units"]``.

        Needs the extra ``tables``.

        Raises:
            TraceError: xarray is not installed, or a channel is called ``t``.
        """
        return upper("logs.formats.dataframe").dataset_of(self)


def thin(trace: Trace, step: float) -> Trace:
    """Return the trace thinned to one sample per ``step`` [s]; the trace itself if it has no more samples than that."""
    times = trace.times - trace.times[0]
    if len(times) < 2 or step < 1.5 * float(np.median(np.diff(times))):
        return trace
    grid = step * np.arange(int(times[-1] / step * (1.0 + 1e-9)) + 1)
    at = np.unique(np.clip(np.searchsorted(times, grid - 1e-9 * step), 0, len(times) - 1))
    return Trace(
        trace.times[at], {n: values[at] for n, values in trace.channels.items()}, trace.units, trace.meta
    )
