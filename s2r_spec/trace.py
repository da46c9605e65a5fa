"""A trace: the channels that one rollout recorded, as a specification reads them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from s2r_spec import stamps
from s2r_spec.errors import TraceError, one_of, suggest
from s2r_spec.instants import instant
from s2r_spec.printable import one_line

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trace:
    """Channels over common time stamps. Frozen: arrays are read-only copies.

    Args:
        times: (n,) time stamps [s], strictly increasing, n ≥ 1. Durations (``timedelta64``) become
            seconds; dates (``datetime64``, ``datetime``) seconds since the first of them.
        channels: name → (n,) or (n, k) samples, read as float64. Masked samples become NaN, and durations seconds.
        units: name → unit as a text ("m/s"); a channel without an entry has no unit.
        meta: values that can be written as JSON. ``meta["failure"]`` is reserved for a short word ("fall") if the
            rollout ended early; see :attr:`failure`.

    Raises:
        TraceError: times do not increase or are not finite, a channel has another length or no numbers, a unit is no
            text, or ``meta["failure"]`` is not a word.
    """

    times: FloatArray
    channels: Mapping[str, FloatArray]
    units: Mapping[str, str] = field(default_factory=dict)
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Copy, check and freeze."""
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
        unknown = set(units) - set(channels)
        if unknown:
            raise TraceError(
                f"units are given for {one_of(unknown)}, which the trace does not have: {one_of(channels)}"
            )
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "channels", MappingProxyType(channels))
        if not isinstance(self.meta, Mapping):
            raise TraceError(f"meta is {self.meta!r}; it must map names to values")
        _failure(self.meta)
        object.__setattr__(self, "units", MappingProxyType(units))
        object.__setattr__(self, "meta", MappingProxyType(dict(self.meta)))

    def __len__(self) -> int:
        return int(self.times.size)

    def __getitem__(self, name: str) -> FloatArray:
        """Return the samples of a channel.

        Raises:
            TraceError: there is no such channel; the message lists all channels.
        """
        try:
            return self.channels[name]
        except KeyError:
            raise TraceError(
                f"the trace has no channel {name!r}{suggest(name, self.channels)} "
                f"it has {one_of(self.channels)}"
            ) from None

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle through the constructor, because read-only mappings cannot be pickled."""
        return Trace, (self.times, dict(self.channels), dict(self.units), dict(self.meta))

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.times[-1] - self.times[0])

    @property
    def failure(self) -> str | None:
        """Word for why the rollout ended early ("fall"), or None. Its ρ is the value that the spec declares."""
        return _failure(self.meta)

    def only(self, names: Iterable[str]) -> Trace:
        """Return this trace with only these channels."""
        kept = {name: self[name] for name in names}
        units = {name: unit for name, unit in self.units.items() if name in kept}
        return Trace(self.times, kept, units, self.meta)


def _frozen(values: ArrayLike, name: str, *, dates: bool = False) -> tuple[FloatArray, str | None]:
    """Return a read-only copy as float64, and the unit that the type states: "s" for durations, else None."""
    unit = None
    try:
        raw = stamps.typed(np.asarray(_filled(values)))
        if stamps.is_typed(raw) and raw.dtype.kind == "M" and not dates:
            raise TypeError("it holds dates")
        if raw.dtype.kind == "c":
            raise TypeError("it holds complex numbers")
        if stamps.is_typed(raw):
            raw, unit = stamps.seconds(raw.ravel()).reshape(raw.shape), "s"
        array = np.array(raw, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise TraceError(f"channel {name!r} is not numeric: {error}") from None
    array.setflags(write=False)
    return array, unit


def _filled(values: Any) -> Any:
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


def between(times: FloatArray, own: FloatArray, values: FloatArray) -> FloatArray:
    """Return (m,) or (m, k) values at times (m,), by linear interpolation of (n,) or (n, k) values at ``own`` (n,)."""
    if values.ndim == 1:
        return np.interp(times, own, values)
    return np.stack([np.interp(times, own, column) for column in values.T], axis=1)


def thinned(trace: Trace, step: float) -> Trace:
    """Return the trace thinned to one sample per ``step`` [s]; the trace itself if it has no more samples than that."""
    times = trace.times - trace.times[0]
    if len(times) < 2 or step < 1.5 * float(np.median(np.diff(times))):
        return trace
    grid = step * np.arange(int(times[-1] / step * (1.0 + 1e-9)) + 1)
    at = np.unique(np.clip(np.searchsorted(times, grid - 1e-9 * step), 0, len(times) - 1))
    return Trace(
        trace.times[at], {n: values[at] for n, values in trace.channels.items()}, trace.units, trace.meta
    )
