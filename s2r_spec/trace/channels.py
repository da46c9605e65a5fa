"""What a trace holds: channels over time, checked, copied and frozen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isnan
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from s2r_spec.base.arrays import BoolArray, FloatArray
from s2r_spec.base.errors import TraceError, one_of, suggest
from s2r_spec.base.printable import html_table, one_line
from s2r_spec.trace.contract import failure_word, frozen_floats, frozen_mask, unit_texts
from s2r_spec.trace.instants import instant
from s2r_spec.trace.messages import HeldChannels, Messages, messages_of
from s2r_spec.trace.samples import describe_sampling

if TYPE_CHECKING:
    from s2r_spec.trace.trace import Trace

SHOWN = 8
"""Definition: signals that the one line of a trace names."""


@dataclass(frozen=True, eq=False, repr=False)
class Channels:
    """The channels of a :class:`~s2r_spec.trace.trace.Trace`, which says what the fields are."""

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
        failure_word(self.meta)
        self._set(meta=MappingProxyType(dict(self.meta)))
        messages = messages_of(self.channels)
        if messages:
            self._set_messages(messages)
        else:
            self._set_samples()

    def _set(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _set_messages(self, messages: Mapping[str, Messages]) -> None:
        if len(messages) < len(self.channels):
            raise TraceError("some channels are messages and some are samples; all must be of one kind")
        recorded = max(one.recorded_until for one in messages.values())
        messages = {name: one.in_log_until(recorded) for name, one in messages.items()}
        units = MappingProxyType(unit_texts(self.units, messages))
        channels = HeldChannels(messages, self.since, self.until)
        self._set(channels=channels, units=units, masks=MappingProxyType({}))
        # All stamps of all channels take more memory than the messages, and often nobody needs them.
        object.__delattr__(self, "times")

    def __getattr__(self, name: str) -> Any:
        """Make the times of messages when they are first needed."""
        if name != "times" or not isinstance(self.__dict__.get("channels"), HeldChannels):
            raise AttributeError(name)
        return self.channels.times  # type: ignore[attr-defined]

    def _set_samples(self) -> None:
        times, _ = frozen_floats(self.times, "t", dates=True)
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
        frozen = {name: frozen_floats(values, name) for name, values in self.channels.items()}
        channels = {name: values for name, (values, _) in frozen.items()}
        units = unit_texts(self.units, channels)
        for name, values in channels.items():
            if values.ndim not in (1, 2) or values.shape[0] != times.size:
                raise TraceError(
                    f"channel {name!r} has shape {values.shape}, but there are {times.size} time stamps; "
                    f"it must be ({times.size},) or ({times.size}, k)"
                )
        masks = {
            name: frozen_mask(mask, times.size, name) for name, mask in self.masks.items() if name in channels
        }
        units |= {name: unit for name, (_, unit) in frozen.items() if unit is not None}
        self._set(times=times, channels=MappingProxyType(channels), units=MappingProxyType(units))
        self._set(masks=MappingProxyType(masks), since=None, until=None)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle through the constructor, because read-only mappings cannot be pickled."""
        times = None if self.messages else self.times
        channels = dict(self.messages or self.channels)
        rest = self.since, self.until, dict(self.masks), self.origin
        return type(self), (times, channels, dict(self.units), dict(self.meta), *rest)

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

    @property
    def begin(self) -> float:
        """The first time [s]."""
        if not self.messages:
            return float(self.times[0])
        return min(one.first for one in self.messages.values()) if self.since is None else self.since

    @property
    def ends(self) -> float:
        """The time until which the trace was recorded [s]."""
        if not self.messages:
            return float(self.times[-1])
        if self.until is not None:
            return self.until
        ends = [end for one in self.messages.values() for end in (one.recorded_until, one.log_end)]
        return max(end for end in ends if not isnan(end))

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
        return failure_word(self.meta)

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
