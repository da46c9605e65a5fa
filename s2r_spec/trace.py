"""A trace: the channels that one rollout recorded, as a specification reads them."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from s2r_spec import stamps
from s2r_spec.errors import TraceError, TraceNote, one_of, suggest
from s2r_spec.instants import instant
from s2r_spec.printable import html_table, one_line
from s2r_spec.samples import Rule, finite_seconds, inside, regular, sampling, seconds_of
from s2r_spec.samples import between as between
from s2r_spec.upper import upper

FloatArray = NDArray[np.float64]

SHOWN = 8
"""Definition: signals that the one line of a trace names."""


@dataclass(frozen=True, eq=False, repr=False)
class Trace:
    """Channels over common time stamps. Frozen: arrays are read-only copies.

    Args:
        times: (n,) time stamps [s], strictly increasing, n ≥ 1. Durations (``timedelta64``) become
            seconds; dates (``datetime64``, ``datetime``) seconds since the first of them.
        channels: name → (n,) or (n, k) samples, read as float64. Masked samples become NaN, and durations seconds. A
            pint Quantity keeps its unit.
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
        chosen = inside(self.times, seconds_of(start, "start"), seconds_of(end, "end"))
        return self._at(chosen, self.times[chosen])

    def shift(self, by: Any) -> Trace:
        """Return this trace with all times later by so many seconds (or a ``timedelta``); earlier if negative.

        ``trace.shift(-trace.times[0])`` begins at 0.

        Raises:
            TraceError: the argument is not a finite duration.
        """
        return self._at(slice(None), self.times + finite_seconds(by, "the shift"))

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
        channels = {
            name: values[at] if rules[name] == "hold" else between(times, self.times, values)
            for name, values in self.channels.items()
        }
        return Trace(times, channels, self.units, self.meta)

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
        if twice := [name for name in kept if kept.count(name) > 1]:
            raise TraceError(f"two channels would be called {twice[0]!r}; give them different names")
        channels = dict(zip(kept, self.channels.values(), strict=True))
        return Trace(
            self.times, channels, {names.get(n, n): unit for n, unit in self.units.items()}, self.meta
        )

    def _at(self, chosen: slice, times: FloatArray) -> Trace:
        """Return chosen samples, at these times."""
        channels = {name: values[chosen] for name, values in self.channels.items()}
        return Trace(times, channels, self.units, self.meta)

    def _rules(self, rule: Rule | Mapping[str, Rule]) -> dict[str, str]:
        """Return channel → its rule.

        Raises:
            TraceError: a rule is not one of the two, or is for no channel.
        """
        given = dict(rule) if isinstance(rule, Mapping) else dict.fromkeys(self.channels, rule)
        for name, one in given.items():
            self[name]
            if one not in ("hold", "linear"):
                raise TraceError(f"the rule {one!r} of channel {name!r} is not one of hold, linear")
        return {name: given.get(name, "hold") for name in self.channels}

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
        (:class:`~s2r_spec.errors.TraceNote`). Columns ``q[0]``, ``q[1]`` make one vector, and a header ``vx [m/s]``
        states its unit. Needs the extra ``tables``.

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
        loaded = upper("logs.dataframe").read(frame, time, units, time_unit)
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
        return upper("logs.dataframe").frame_of(self, library)

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset`` over ``t`` [s]; each variable has its unit in ``attrs["units"]``.

        Needs the extra ``tables``.

        Raises:
            TraceError: xarray is not installed, or a channel is called ``t``.
        """
        return upper("logs.dataframe").dataset_of(self)

    # -- for readers -----------------------------------------------------------------------------------------------

    def __repr__(self) -> str:
        """Return one line: samples, rate, span, and the signals with their units."""
        names = [self._signal(name) for name in list(self.channels)[:SHOWN]]
        if len(self.channels) > SHOWN:
            names.append(f"and {len(self.channels) - SHOWN} more")
        failed = f"; failure: {self.failure}" if self.failure else ""
        return f"Trace({sampling(self.times)}; {', '.join(names) or 'no signals'}{failed})"

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
        return html_table(f"Trace: {sampling(self.times)}{failed}", head, rows)

    def _signal(self, name: str, unit: bool = True) -> str:
        """Return a signal with the width of a vector, and with its unit."""
        values = self.channels[name]
        width = f"({values.shape[1]})" if values.ndim == 2 else ""
        return one_line(
            f"{name}{width} [{self.units[name]}]" if unit and name in self.units else f"{name}{width}"
        )


def _frozen(values: ArrayLike, name: str, *, dates: bool = False) -> tuple[FloatArray, str | None]:
    """Return a read-only copy as float64, and the unit that the type states: "s" for durations, else None."""
    values, unit = _magnitude(values, dates)
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
