"""A trace: the channels that one rollout recorded, as a specification reads them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isnan
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from s2r_spec.base.errors import TraceError, TraceNote, one_of, suggest
from s2r_spec.base.printable import html_table, one_line
from s2r_spec.base.upper import upper
from s2r_spec.trace import stamps
from s2r_spec.trace.instants import instant
from s2r_spec.trace.messages import Messages, union
from s2r_spec.trace.samples import Rule, describe_sampling, finite_seconds, inside, regular, seconds_of
from s2r_spec.trace.samples import between as between

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SHOWN = 8
"""Definition: signals that the one line of a trace names."""


@dataclass(frozen=True, eq=False, repr=False)
class Trace:
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

    times: FloatArray
    channels: Mapping[str, FloatArray]
    units: Mapping[str, str] = field(default_factory=dict)
    meta: Mapping[str, Any] = field(default_factory=dict)
    since: float | None = None
    until: float | None = None
    masks: Mapping[str, BoolArray] = field(default_factory=dict)
    origin: Trace | None = None

    def __post_init__(self) -> None:
        """Copy, check and freeze."""
        if not isinstance(self.meta, Mapping):
            raise TraceError(f"meta is {self.meta!r}; it must map names to values")
        _failure(self.meta)
        object.__setattr__(self, "meta", MappingProxyType(dict(self.meta)))
        messages = messages_of(self.channels)
        if messages:
            self._of_messages(messages)
        else:
            self._of_samples()

    def _of_messages(self, messages: Mapping[str, Messages]) -> None:
        if len(messages) < len(self.channels):
            raise TraceError("some channels are messages and some are samples; all must be of one kind")
        recorded = max(one.recorded_until for one in messages.values())
        messages = {name: one.in_log_until(recorded) for name, one in messages.items()}
        object.__setattr__(self, "channels", _Held(messages, self.since, self.until))
        object.__setattr__(self, "units", MappingProxyType(_check_units(_texts(self.units), messages)))
        object.__setattr__(self, "masks", MappingProxyType({}))
        # All stamps of all channels take more memory than the messages, and often nobody needs them.
        object.__delattr__(self, "times")

    def __getattr__(self, name: str) -> Any:
        """Make the times of messages when they are first needed."""
        if name != "times" or not isinstance(self.__dict__.get("channels"), _Held):
            raise AttributeError(name)
        return self.channels.times  # type: ignore[attr-defined]

    def _of_samples(self) -> None:
        times, _ = _frozen(self.times, "t", dates=True)
        if times.ndim != 1 or times.size == 0:
            raise TraceError(f"a trace needs times of shape (n,) with n >= 1, not {times.shape}")
        if not np.isfinite(times).all():
            bad = int(np.argmin(np.isfinite(times)))
            raise TraceError(
                f"time stamp {bad} is {times[bad]}; every time must be a finite number of seconds"
            )
        steps = np.diff(times)
        if (steps <= 0).any():
            bad = int(np.argmax(steps <= 0)) + 1
            raise TraceError(
                f"times must increase strictly, but sample {bad} is at {instant(times[:1], times[bad])} "
                f"after {instant(times[:1], times[bad - 1])}"
            )
        frozen = {name: _frozen(values, name) for name, values in self.channels.items()}
        channels = {name: values for name, (values, _) in frozen.items()}
        units = _texts(self.units) | {name: unit for name, (_, unit) in frozen.items() if unit is not None}
        for name, values in channels.items():
            if values.ndim not in (1, 2) or values.shape[0] != times.size:
                raise TraceError(
                    f"channel {name!r} has shape {values.shape}, but there are {times.size} time stamps; "
                    f"it must be ({times.size},) or ({times.size}, k)"
                )
        masks = {name: _mask(mask, times.size, name) for name, mask in self.masks.items() if name in channels}
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "channels", MappingProxyType(channels))
        object.__setattr__(self, "units", MappingProxyType(_check_units(units, channels)))
        object.__setattr__(self, "masks", MappingProxyType(masks))
        object.__setattr__(self, "since", None)
        object.__setattr__(self, "until", None)

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

    def __len__(self) -> int:
        return int(self.times.size)

    __iter__ = None  # its length counts samples, but its keys are names: neither is meant by a loop

    def __contains__(self, name: object) -> bool:
        """Return whether there is a channel of this name."""
        return name in self.channels

    def __getitem__(self, name: str) -> FloatArray:
        """Return the samples of a channel.

        Raises:
            TraceError: there is no such channel; the message lists all channels.
        """
        try:
            return self.channels[name]
        except KeyError:
            raise TraceError(
                f"the trace has no channel {name!r}{suggest(str(name), self.channels)} "
                f"it has {one_of(self.channels)}"
            ) from None

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle through the constructor, because read-only mappings cannot be pickled."""
        if self.messages:
            fields = dict(self.messages), dict(self.units), dict(self.meta), self.since, self.until
            return Trace.of_messages, fields
        channels, masks = dict(self.channels), dict(self.masks)
        return Trace, (
            self.times,
            channels,
            dict(self.units),
            dict(self.meta),
            None,
            None,
            masks,
            self.origin,
        )

    @property
    def messages(self) -> Mapping[str, Messages]:
        """Channel → its messages; empty if the channels have common samples."""
        return messages_of(self.channels)

    def own(self, name: str) -> BoolArray:
        """Return (n,): whether the sample of a channel at each time is its own, and not held or interpolated.

        Raises:
            TraceError: there is no such channel.
        """
        self[name]
        if name in self.messages:
            return self.messages[name].own(self.times)
        return self.masks.get(name, np.ones(len(self), dtype=bool))

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
        origin = None if self.origin is None else self.origin.with_channels(change)
        return replace(self, channels=channels, origin=origin)

    @property
    def begin(self) -> float:
        """The first time [s]."""
        if not self.messages:
            return float(self.times[0])
        return (
            min(float(one.times[0]) for one in self.messages.values()) if self.since is None else self.since
        )

    @property
    def ends(self) -> float:
        """The time until which the trace was recorded [s]."""
        if not self.messages:
            return float(self.times[-1])
        if self.until is not None:
            return self.until
        known = (one.log_end for one in self.messages.values() if not isnan(one.log_end))
        return max([*(one.recorded_until for one in self.messages.values()), *known])

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        if not self.messages:
            return float(self.times[-1] - self.times[0])
        ends = np.array([self.ends])
        last = [float(one.times[max(int(one.index(ends)[0]), 0)]) for one in self.messages.values()]
        return max(*last, self.begin) - self.begin

    @property
    def failure(self) -> str | None:
        """Word for why the rollout ended early ("fall"), or None. Its ρ is the value that the spec declares."""
        return _failure(self.meta)

    def only(self, names: Iterable[str]) -> Trace:
        """Return this trace with only these channels; of messages, without the stamps of the others."""
        names = list(names)
        units = {name: unit for name, unit in self.units.items() if name in names}
        if self.messages:
            for name in names:
                if name not in self:
                    self[name]  # raises
            return self._with_messages({name: self.messages[name] for name in names}, units=units)
        origin = None if self.origin is None else self.origin.only(names)
        return replace(self, channels={name: self[name] for name in names}, units=units, origin=origin)

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
        if self.messages:
            return self._messages_between(low, high)
        chosen = inside(self.times, low, high)
        origin = None if self.origin is None else self.origin.between(low, high)
        return replace(self._at(chosen, self.times[chosen]), origin=origin)

    def _messages_between(self, low: float, high: float) -> Trace:
        if high < low:
            raise TraceError(f"the end, {high:g} s, is before the start, {low:g} s")
        parts = {name: one.between(low, high) for name, one in self.messages.items()}
        kept = {name: one for name, one in parts.items() if one is not None}
        if len(kept) < len(parts):
            lacking = min(set(parts) - set(kept))
            raise TraceError(f"the channel {lacking!r} has no value from {low:g} s to {high:g} s")
        since = low if self.since is None else max(self.since, low)
        until = self.until if self.ends <= high else high
        return self._with_messages(kept, since=since, until=until)

    def shift(self, by: Any) -> Trace:
        """Return this trace with all times later by so many seconds (or a ``timedelta``); earlier if negative.

        ``trace.shift(-trace.times[0])`` begins at 0.

        Raises:
            TraceError: the argument is not a finite duration.
        """
        later = finite_seconds(by, "the shift")
        if self.messages:
            moved = {name: one.shifted(later) for name, one in self.messages.items()}
            since = None if self.since is None else self.since + later
            until = None if self.until is None else self.until + later
            return self._with_messages(moved, since=since, until=until)
        origin = None if self.origin is None else self.origin.shift(later)
        return replace(self._at(slice(None), self.times + later), origin=origin)

    def at_busiest(self) -> Trace:
        """Return channels with messages at the stamps of the one with the most, from the first value of each on."""
        if not self.messages:
            return self
        busiest = max(self.messages.values(), key=len)
        first = max(float(one.times[0]) for one in self.messages.values())
        since = first if self.since is None else max(first, self.since)
        times = np.unique(busiest.times)
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
        messages = (self if self.messages else self.as_messages()).messages
        spans = {name: one.silences(self.begin, self.ends) for name, one in messages.items()}
        inner = {
            name: [
                (start, min(end, self.ends))
                for start, end in silent
                if start > self.begin and self.ends > start
            ]
            for name, silent in spans.items()
        }
        return {
            name: max(silent, key=lambda span: span[1] - span[0]) for name, silent in inner.items() if silent
        }

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
        origin = None if self.origin is None else self.origin.rename(names)
        return replace(self, channels=channels, units=units, masks=masks, origin=origin)

    def _with_messages(self, channels: Mapping[str, Messages], **changes: Any) -> Trace:
        """Return this trace with other messages, and other fields."""
        return Trace.of_messages(
            channels,
            **{"units": self.units, "meta": self.meta, "since": self.since, "until": self.until} | changes,
        )

    def _at(self, chosen: slice, times: FloatArray) -> Trace:
        """Return chosen samples, at these times."""
        channels = {name: values[chosen] for name, values in self.channels.items()}
        masks = {name: mask[chosen] for name, mask in self.masks.items()}
        return replace(self, times=times, channels=channels, masks=masks)

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

    # -- for readers -----------------------------------------------------------------------------------------------

    def __repr__(self) -> str:
        """Return one line: samples, rate, span, and the signals with their units."""
        names = [self._signal(name) for name in list(self.channels)[:SHOWN]]
        if len(self.channels) > SHOWN:
            names.append(f"and {len(self.channels) - SHOWN} more")
        failed = f"; failure: {self.failure}" if self.failure else ""
        return f"Trace({describe_sampling(self.times)}; {', '.join(names) or 'no signals'}{failed})"

    def _repr_html_(self) -> str:
        """Return a small table for a notebook: range and unit of every signal."""
        rows = []
        for name, values in self.channels.items():
            known = values[~np.isnan(values)]
            ends = (f"{known.min():.6g}", f"{known.max():.6g}") if known.size else ("", "")
            missing = values.size - known.size
            rows.append((self._signal(name, unit=False), self.units.get(name, ""), *ends, str(missing or "")))
        failed = f"; failure: {self.failure}" if self.failure else ""
        head = ("signal", "unit", "lowest", "highest", "missing")
        return html_table(f"Trace: {describe_sampling(self.times)}{failed}", head, rows)

    def _signal(self, name: str, unit: bool = True) -> str:
        """Return a signal with the width of a vector, and with its unit."""
        values = self.channels[name]
        width = f"({values.shape[1]})" if values.ndim == 2 else ""
        return one_line(
            f"{name}{width} [{self.units[name]}]" if unit and name in self.units else f"{name}{width}"
        )


class _Held(Mapping[str, FloatArray]):
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
    if isinstance(channels, _Held):
        return channels.messages
    return {name: one for name, one in channels.items() if isinstance(one, Messages)}


def _mask(mask: ArrayLike, count: int, name: str) -> BoolArray:
    """Return a read-only copy of a mask.

    Raises:
        TraceError: it has another length.
    """
    array = np.array(mask, dtype=bool)
    if array.shape != (count,):
        raise TraceError(f"the mask of {name!r} has shape {array.shape}, but there are {count} time stamps")
    array.setflags(write=False)
    return array


def _check_units(units: dict[str, str], channels: Mapping[str, Any]) -> dict[str, str]:
    """Return the units.

    Raises:
        TraceError: a unit is for no channel.
    """
    if unknown := set(units) - set(channels):
        raise TraceError(
            f"units are given for {one_of(unknown)}, which the trace does not have: {one_of(channels)}"
        )
    return units


def _frozen(values: ArrayLike, name: str, *, dates: bool = False) -> tuple[FloatArray, str | None]:
    """Return a read-only copy as float64, and the unit that the type states: "s" for durations, else None."""
    values, unit = _magnitude(values, dates)
    try:
        raw = stamps.as_nanoseconds(np.asarray(_fill(values)))
        if stamps.is_typed(raw) and raw.dtype.kind == "M" and not dates:
            raise TypeError("it holds dates")
        if raw.dtype.kind == "c":
            raise TypeError("it holds complex numbers")
        if stamps.is_typed(raw):
            raw, unit = stamps.seconds(raw.ravel()).reshape(raw.shape), "s"
        frozen = raw.dtype == np.float64 and raw.flags.owndata and not raw.flags.writeable
        array = raw if frozen and raw.flags.c_contiguous else np.array(raw, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise TraceError(f"channel {name!r} is not numeric: {error}") from None
    array.setflags(write=False)
    return array, unit


def _magnitude(values: Any, times: bool) -> tuple[Any, str | None]:
    """Return the numbers and the unit of a pint Quantity, times in seconds; any other value, and None.

    Raises:
        TraceError: the times are of another dimension.
    """
    if not (hasattr(values, "magnitude") and hasattr(values, "units")):
        return values, None
    if not times:
        return values.magnitude, f"{values.units:~C}"
    try:
        return values.to("s").magnitude, None
    except Exception as error:  # of pint, which the caller has loaded
        raise TraceError(f"the times are in {values.units}, which is not a unit of time: {error}") from None


def _fill(values: Any) -> Any:
    """Return a masked array of numbers with NaN for masked values; numpy's own conversion would unmask them."""
    masked = isinstance(values, np.ma.MaskedArray) and values.dtype.kind in "biuf"
    return values.astype(np.float64).filled(np.nan) if masked else values


def _texts(units: Any) -> dict[str, str]:
    """Return the units after a check that they are texts.

    Raises:
        TraceError: a unit is not a string.
    """
    if not isinstance(units, Mapping):
        raise TraceError(f"units are {units!r}; they must map names of channels to texts, such as 'm/s'")
    for name, unit in units.items():
        if not isinstance(unit, str):
            raise TraceError(f"the unit of channel {name!r} is {unit!r}; it must be a string, such as 'm/s'")
    return dict(units)


def _failure(meta: Mapping[str, Any]) -> str | None:
    """Return the word for a failure; None, False, 0 and "" mean no failure.

    Raises:
        TraceError: the value is not a word.
    """
    word = meta.get("failure")
    if word is None or isinstance(word, str):
        return one_line(word.strip()) or None if word else None
    if isinstance(word, bool | np.bool_ | int | float):
        return "failure" if word else None
    raise TraceError(f'meta["failure"] is {word!r}; it must be a short word, such as "fall"')


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
