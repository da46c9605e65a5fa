"""From a trace to numbers that two machines can be compared by: the observables of an experiment.

Channels alone decide the observables, so they are the same for every robot. A *quantity* is a channel, a residual,
or the difference of two channels that measure the same (``tau - tau_cmd``). Statistics of a quantity x (n,), with a
flag f (a channel of 0 and 1, such as stance) or another quantity s of the same width:

    bin          means over 50 equal parts of the trace        where traces of healthy machines agree in time
    mean         means over six windows                        where they do not: a motion with a clock of its own
    ripple       log of the scatter within short blocks, for either half;  and log of the scatter of all samples
    flag         means of x where f = 1, and where f = 0       phases of a gait
    product      means of x s, x sign(s) and x ds/dt, of a residual x: what its force law looks like
    innovation   what errors of one-step predictions have in common with the past, of a simulator without residuals
                 (:mod:`.innovations`)

Those of one quantity and one kind of statistic are a *group*. What a trace cannot show is NaN.

Units: quantities are in units of their scale, which is their rms over the nominal traces. Of a residual, and of a
difference, which nearly vanish in a nominal trace, it is at least 5 % of the scatter of a channel of the same unit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.simulator.experiments import RESIDUAL
from s2r_spec.diagnose.simulator.innovations import Innovations, of_columns
from s2r_spec.trace import Trace

BINS = 50
"""Definition: parts of a trace whose means are observables."""
WINDOWS = (0.0, 0.1, 0.2, 0.35, 0.55, 0.775, 1.0)
"""Definition: edges of the windows, as parts of the trace; narrow where a command has just changed."""
BLOCKS = 60
"""Definition: the ripple is the scatter within this part of a trace."""
NEGLIGIBLE = 0.05
"""Tolerance: a residual below this part of a channel's scatter counts as nothing."""
SAME = 0.2
"""Tolerance: two channels measure the same if their nominal difference is below this part of their rms."""
FLOOR = 0.1
"""Tolerance: scatter below this part of the scale does not change the logarithm of the ripple."""


@dataclass(frozen=True)
class ObservedQuantity:
    """A channel, or the difference of two.

    Attributes:
        name: such as "tau", "residual.joint_torque" or "tau - tau_cmd".
        channel, minus: names of the channels; ``minus`` is "" for a channel alone.
        scale: (columns,) unit of the observables.
    """

    name: str
    channel: str
    minus: str
    scale: FloatArray

    @property
    def residual(self) -> bool:
        """Whether the nominal model says that it is (nearly) nothing."""
        return bool(self.minus) or self.channel.startswith(RESIDUAL)

    def of(self, trace: Trace) -> FloatArray:
        """Return (n, columns) samples in units of the scale; NaN if the trace lacks a channel."""
        width = self.scale.size
        names = [self.channel, *filter(None, (self.minus,))]
        if any(name not in trace.channels or _columns(trace, name).shape[1] != width for name in names):
            return np.full((len(trace), width), np.nan)
        values = _columns(trace, self.channel)
        return (values - _columns(trace, self.minus) if self.minus else values) / self.scale


@dataclass(frozen=True)
class ObservableGroup:
    """Observables of one quantity and one kind of statistic: the places ``start`` to ``stop`` of a vector."""

    quantity: str
    statistic: str
    start: int
    stop: int


@dataclass(frozen=True)
class Observables:
    """The observables of an experiment, fixed once from nominal traces.

    Attributes:
        duration: of a whole trace [s].
        quantities: channels and differences.
        flags: (name, width) of the channels of 0 and 1.
        clocked: whether traces of healthy machines agree in time.
        innovations: of a simulator without residuals.
    """

    duration: float
    quantities: tuple[ObservedQuantity, ...]
    flags: tuple[tuple[str, int], ...]
    clocked: bool = True
    innovations: Innovations | None = None

    @classmethod
    def of_nominal(cls, traces: Sequence[Trace], healthy: Sequence[Trace] = ()) -> Observables:
        """Choose the quantities from whole traces with residuals; at least one trace.

        ``healthy`` has whole traces of machines with small amounts of all effects. The phase of a gait is the same in
        runs of one model, and another in the next one.
        """
        names = [name for name in traces[0].channels if all(name in trace.channels for trace in traces)]
        samples = {name: np.concatenate([_columns(trace, name) for trace in traces]) for name in names}
        flags = tuple(
            (name, x.shape[1])
            for name, x in samples.items()
            if np.isin(x, (0.0, 1.0)).all() and np.ptp(x) > 0
        )
        plain = {
            name: x
            for name, x in samples.items()
            if np.isfinite(x).all() and name not in dict(flags) and (np.any(x) or name.startswith(RESIDUAL))
        }
        units = traces[0].units
        quantities = tuple(_quantities(plain, {name: units.get(name, "") for name in plain}))
        observables = cls(max(trace.duration for trace in traces), quantities, flags)
        observables = replace(
            observables, clocked=observables._agrees(healthy if len(healthy) > 1 else traces)
        )
        if any(quantity.channel.startswith(RESIDUAL) for quantity in quantities):
            return observables
        channels = observables.channels
        rows = [np.hstack([one.of(trace) for one in channels]) for trace in traces]
        return replace(observables, innovations=Innovations.of_nominal(rows))

    @cached_property
    def groups(self) -> tuple[ObservableGroup, ...]:
        """The groups of a vector, in its order."""
        groups, start = [], 0
        for quantity, statistic, size in self._layout:
            groups.append(ObservableGroup(quantity.name, statistic, start, start + size))
            start += size
        return tuple(groups)

    @property
    def size(self) -> int:
        """The number m of observables."""
        return sum(size for _, _, size in self._layout)

    @cached_property
    def channels(self) -> list[ObservedQuantity]:
        """The quantities that are channels, of which the others are made."""
        return [quantity for quantity in self.quantities if not quantity.residual]

    def columns(self, quantity: ObservedQuantity) -> slice:
        """Return the columns of a channel among those of all channels."""
        return self._columns[quantity.name]

    @cached_property
    def _columns(self) -> dict[str, slice]:
        ends = np.cumsum([one.scale.size for one in self.channels]).tolist()
        return {
            one.name: slice(end - one.scale.size, end) for one, end in zip(self.channels, ends, strict=True)
        }

    def innovation_shift(self, trace: Trace, noise: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Return channel → by how much white noise, of channel → (columns,) variance, moves its innovations."""
        if not self.innovations:
            return {}
        values = np.hstack([one.of(trace) for one in self.channels])
        variance = np.concatenate([noise[one.name] for one in self.channels])
        each = self.innovations.shift(values, trace.times - trace.times[0], self.duration, variance)
        return {one.name: of_columns(each, self.columns(one)) for one in self.channels}

    def innovation_scatter(self, trace: Trace) -> dict[str, FloatArray]:
        """Return channel → variances of its innovations in one trace; nothing where it has none."""
        if not self.innovations:
            return {}
        values = np.hstack([one.of(trace) for one in self.channels])
        each = self.innovations.scatter(values, trace.times - trace.times[0], self.duration)
        found = {one.name: of_columns(each, self.columns(one)) for one in self.channels}
        return {name: own for name, own in found.items() if own.size}

    def vector(self, trace: Trace) -> FloatArray:
        """Return (m,) the observables of a trace with residuals."""
        values = {quantity.name: quantity.of(trace) for quantity in self.quantities}
        if not values:
            return np.zeros(0)
        times = trace.times - trace.times[0]
        wide = np.hstack(list(values.values()))
        edges = np.linspace(0.0, 1.0, BINS + 1) if self.clocked else np.array(WINDOWS)
        rows = {"bin" if self.clocked else "mean": _means(wide, times, self.duration * edges)}
        if any(statistic == "ripple" for _, statistic, _ in self._layout):
            rows["ripple"] = _ripple(wide, times, self.duration)
        ends = np.cumsum([quantity.scale.size for quantity in self.quantities])
        own = {q.name: slice(end - q.scale.size, end) for q, end in zip(self.quantities, ends, strict=True)}
        forms = {name: _forms(values[name], times, self.duration) for name in self._factors}
        errors: dict[int, FloatArray] = {}
        if self.innovations:
            channels = np.hstack([values[one.name] for one in self.channels])
            errors = self.innovations.of(channels, times, self.duration)
        parts = []
        for quantity, statistic, _ in self._layout:
            x = values[quantity.name]
            if statistic in rows:
                parts.append(rows[statistic][:, own[quantity.name]].ravel())
            elif statistic == "innovation":
                parts.append(of_columns(errors, self.columns(quantity)))
            elif statistic == "flag":
                parts += [_in_phases(x, trace, flag, width) for flag, width in self._flags_of(quantity)]
            else:
                products = (form for name in self._partners(quantity) for form in forms[name])
                parts += [np.einsum("ij,ij->j", x, form) / len(x) for form in products]
        return np.concatenate(parts)

    def _agrees(self, traces: Sequence[Trace]) -> bool:
        """Whether means over 50 parts, of all channels in units of their scales, differ more in time than by run."""
        edges = np.linspace(0.0, self.duration, BINS + 1)
        noise = signal = 0.0
        for quantity in self.quantities:
            if quantity.residual:
                continue
            parts = np.array([_means(quantity.of(t), t.times - t.times[0], edges) for t in traces])
            scatter = float(parts.var(axis=0, ddof=1).mean()) if len(traces) > 1 else 0.0
            noise += scatter
            signal += float(parts.mean(axis=0).var(axis=0).mean()) - scatter / len(traces)
        return noise <= signal

    def _partners(self, one: ObservedQuantity) -> list[str]:
        """Return the names of the channels with which a residual is multiplied."""
        channels = [q for q in self.quantities if one.residual and not q.residual]
        return [q.name for q in channels if q.scale.size == one.scale.size]

    @cached_property
    def _factors(self) -> set[str]:
        """Names of the channels with which any residual is multiplied."""
        return {name for quantity in self.quantities for name in self._partners(quantity)}

    def _flags_of(self, one: ObservedQuantity) -> list[tuple[str, int]]:
        width = one.scale.size
        return [(name, k) for name, k in self.flags if width % k == 0 and (k > 1 or width == 1)]

    @cached_property
    def _layout(self) -> tuple[tuple[ObservedQuantity, str, int], ...]:
        """Quantity, statistic and size of every group."""
        return tuple(self._sizes())

    def _sizes(self) -> Iterator[tuple[ObservedQuantity, str, int]]:
        for quantity in self.quantities:
            width = quantity.scale.size
            yield (
                (quantity, "bin", BINS * width)
                if self.clocked
                else (quantity, "mean", (len(WINDOWS) - 1) * width)
            )
            if quantity.residual or not self.innovations:
                yield quantity, "ripple", 3 * width
            if flags := self._flags_of(quantity):
                yield quantity, "flag", 2 * len(flags) * width
            if partners := self._partners(quantity):
                yield quantity, "product", 3 * len(partners) * width
            elif self.innovations and not quantity.residual:
                yield quantity, "innovation", self.innovations.size(self.columns(quantity))


def _quantities(samples: dict[str, FloatArray], units: dict[str, str]) -> Iterator[ObservedQuantity]:
    """Yield every channel and residual, and the difference of two channels that measure the same."""
    scatter = {
        name: float(np.min(x.std(axis=0)))
        for name, x in samples.items()
        if not name.startswith(RESIDUAL) and np.min(x.std(axis=0)) > 0.0
    }
    for name, x in samples.items():
        alike = [
            scatter[other] for other in scatter if name.startswith(RESIDUAL) and units[other] == units[name]
        ]
        yield ObservedQuantity(name, name, "", _scale(x, NEGLIGIBLE * min(alike, default=0.0)))
    for a, b in combinations(scatter, 2):
        if units[a] == units[b] != "" and samples[a].shape == samples[b].shape:
            difference = samples[a] - samples[b]
            if _rms(difference) < SAME * min(_rms(samples[a]), _rms(samples[b])):
                yield ObservedQuantity(
                    f"{a} - {b}", a, b, _scale(difference, NEGLIGIBLE * min(scatter[a], scatter[b]))
                )


def _scale(x: FloatArray, least: float) -> FloatArray:
    """Return (columns,) the rms of each column, at least ``least``; the channel's rms for a column of nothing."""
    rms = np.sqrt((x**2).mean(axis=0))
    rms = np.maximum(np.where(rms > 1e-9 * _rms(x), rms, _rms(x)), least)
    return np.where(rms > 0.0, rms, 1.0)


def _means(x: FloatArray, times: FloatArray, edges: FloatArray) -> FloatArray:
    """Return (parts, columns) the means between edges [s]; NaN for a part of which less than half was recorded."""
    places = np.searchsorted(times, edges - 1e-9)
    count = np.diff(places)
    period = times[-1] / max(len(times) - 1, 1)
    whole = (times[-1] + period > (edges[:-1] + edges[1:]) / 2) & (count > 0)
    means = np.full((count.size, x.shape[1]), np.nan)
    if whole.any():
        # Parts without samples have no width here, so the others follow one another.
        sums = np.add.reduceat(x[: places[-1]], places[:-1][count > 0], axis=0)
        means[whole] = sums[whole[count > 0]] / count[whole][:, None]
    return means


def _forms(s: FloatArray, times: FloatArray, duration: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (n, columns) s, its sign and its derivative, with which residuals are multiplied."""
    rate = np.gradient(s, times, axis=0) * duration if len(times) > 1 else np.zeros_like(s)
    return s, np.sign(s), rate


def _ripple(x: FloatArray, times: FloatArray, duration: float) -> FloatArray:
    """Return (3, columns) logarithms of the scatter within blocks of either half, and of all samples."""
    block = np.minimum((times / (duration / BLOCKS) + 1e-9).astype(int), BLOCKS - 1)
    starts = np.flatnonzero(np.diff(block, prepend=-1))
    counts = np.diff(np.append(starts, len(times)))[:, None]
    means = np.add.reduceat(x, starts) / counts
    squares = np.maximum(np.add.reduceat(x**2, starts) / counts - means**2, 0.0)
    late = block[starts] >= BLOCKS // 2
    halves = [
        np.sqrt(squares[part].mean(axis=0)) if part.any() else np.full(x.shape[1], np.nan)
        for part in (~late, late)
    ]
    return np.log(np.array([*halves, x.std(axis=0)]) + FLOOR)


def _in_phases(x: FloatArray, trace: Trace, flag: str, width: int) -> FloatArray:
    """Return the means where a flag is 1 and where it is 0, flat; NaN for a phase that did not occur."""
    if flag not in trace.channels:
        return np.full(2 * x.shape[1], np.nan)
    on = np.repeat(_columns(trace, flag), x.shape[1] // width, axis=1)
    means = []
    for weight in (on, 1.0 - on):
        total = weight.sum(axis=0)
        mean = np.einsum("ij,ij->j", weight, x) / np.where(total > 0, total, 1.0)
        means.append(np.where(total > 0, mean, np.nan))
    return np.concatenate(means)


def _columns(trace: Trace, name: str) -> FloatArray:
    values = trace.channels[name]
    return values[:, None] if values.ndim == 1 else values


def _rms(x: FloatArray) -> float:
    return float(np.sqrt((x**2).mean()))
