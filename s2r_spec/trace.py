"""A trace: what one rollout recorded, as the specification reads it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from s2r_spec.errors import TraceError, one_of, suggest
from s2r_spec.printable import one_line

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trace:
    """Channels over common time stamps. Frozen: arrays are read-only copies.

    Args:
        times: (n,) time stamps [s], strictly increasing, n ≥ 1.
        channels: name → (n,) or (n, k) samples, read as float64.
        units: name → unit as a string ("m/s"); a missing name has no declared unit.
        meta: anything that can be written as JSON. ``meta["failure"]`` is
            reserved: a short word ("fall") when the rollout ended early, see
            :attr:`failure`.

    Raises:
        TraceError: times not increasing or not finite, or a channel of another length.
    """

    times: FloatArray
    channels: Mapping[str, FloatArray]
    units: Mapping[str, str] = field(default_factory=dict)
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Copy, check and freeze."""
        times = _frozen(self.times, "t")
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
                f"times must increase strictly, but sample {bad} is at {times[bad]:g} s "
                f"after {times[bad - 1]:g} s"
            )
        channels = {name: _frozen(values, name) for name, values in self.channels.items()}
        for name, values in channels.items():
            if values.ndim not in (1, 2) or values.shape[0] != times.size:
                raise TraceError(
                    f"channel {name!r} has shape {values.shape}, but there are {times.size} time stamps; "
                    f"it must be ({times.size},) or ({times.size}, k)"
                )
        unknown = set(self.units) - set(channels)
        if unknown:
            raise TraceError(
                f"units are given for {one_of(unknown)}, which the trace does not have: {one_of(channels)}"
            )
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "channels", MappingProxyType(channels))
        object.__setattr__(self, "units", MappingProxyType(dict(self.units)))
        object.__setattr__(self, "meta", MappingProxyType(dict(self.meta)))

    def __len__(self) -> int:
        return int(self.times.size)

    def __getitem__(self, name: str) -> FloatArray:
        """Return the samples of a channel; a wrong name lists the right ones."""
        try:
            return self.channels[name]
        except KeyError:
            raise TraceError(
                f"the trace has no channel {name!r}{suggest(name, self.channels)} "
                f"it has {one_of(self.channels)}"
            ) from None

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle through the constructor: read-only mappings do not pickle by themselves."""
        return Trace, (self.times, dict(self.channels), dict(self.units), dict(self.meta))

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.times[-1] - self.times[0])

    @property
    def failure(self) -> str | None:
        """Why the rollout ended early ("fall"), or None. Its ρ is the spec's declared value."""
        word = self.meta.get("failure")
        return None if word is None else one_line(word)

    def only(self, names: Iterable[str]) -> Trace:
        """Return the same trace with just these channels."""
        kept = {name: self[name] for name in names}
        units = {name: unit for name, unit in self.units.items() if name in kept}
        return Trace(self.times, kept, units, self.meta)


def _frozen(values: ArrayLike, name: str) -> FloatArray:
    try:
        array = np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise TraceError(f"channel {name!r} is not numeric: {error}") from None
    array.setflags(write=False)
    return array


def between(times: FloatArray, own: FloatArray, values: FloatArray) -> FloatArray:
    """Return (m,) or (m, k) values at other times (m,): straight lines between those (n,) or (n, k) at ``own``."""
    if values.ndim == 1:
        return np.interp(times, own, values)
    return np.stack([np.interp(times, own, column) for column in values.T], axis=1)


def thinned(trace: Trace, step: float) -> Trace:
    """Return the samples of a trace that are ``step`` [s] apart, or next after that; all where they are that far."""
    times = trace.times - trace.times[0]
    if len(times) < 2 or step < 1.5 * float(np.median(np.diff(times))):
        return trace
    wanted = step * np.arange(int(times[-1] / step * (1.0 + 1e-9)) + 1)
    at = np.unique(np.clip(np.searchsorted(times, wanted - 1e-9 * step), 0, len(times) - 1))
    return Trace(
        trace.times[at], {n: values[at] for n, values in trace.channels.items()}, trace.units, trace.meta
    )
