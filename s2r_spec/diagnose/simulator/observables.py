"""From a trace to numbers that two machines can be compared by: the observables of an experiment.

Channels alone decide the observables, so they are the same for every robot. A *quantity* is a channel, a residual,
or the difference of two channels that measure the same (``tau - tau_cmd``). Statistics of a quantity x (n,), with a
flag f (a channel of 0 and 1, such as stance) or another quantity s of the same width:

    bin          means over 50 equal parts of the trace        where two nominal traces agree in time
    mean         means over six windows                        where they do not: a motion whose clock begins anywhere
    ripple       log of the scatter within short blocks, for either half;  and log of the scatter of all samples
    flag         means of x where f = 1, and where f = 0       phases of a gait
    product      means of x s, x sign(s) and x ds/dt, of a residual x: what its force law looks like

Those of one quantity and one kind of statistic are a *group*. What a trace cannot show is NaN.

Units: quantities are in units of their scale, which is their rms over the nominal traces. Of a residual, and of a
difference, which nearly vanish in a nominal trace, it is at least 5 % of the scatter of a channel of the same unit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.simulator.experiments import RESIDUAL
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
        clocked: whether two nominal traces agree in time.
    """

    duration: float
    quantities: tuple[ObservedQuantity, ...]
    flags: tuple[tuple[str, int], ...]
    clocked: bool = True

    @classmethod
    def of_nominal(cls, traces: Sequence[Trace]) -> Observables:
        """Choose the quantities from whole traces with residuals; at least one trace."""
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
        return replace(observables, clocked=observables._agrees(traces))

    @property
    def groups(self) -> tuple[ObservableGroup, ...]:
        """The groups of a vector, in its order."""
        groups, start = [], 0
        for quantity, statistic, size in self._layout():
            groups.append(ObservableGroup(quantity.name, statistic, start, start + size))
            start += size
        return tuple(groups)

    @property
    def size(self) -> int:
        """The number m of observables."""
        return sum(size for _, _, size in self._layout())

    def vector(self, trace: Trace) -> FloatArray:
        """Return (m,) the observables of a trace with residuals."""
        values = {quantity.name: quantity.of(trace) for quantity in self.quantities}
        parts = [
            self._statistic(quantity, statistic, values, trace) for quantity, statistic, _ in self._layout()
        ]
        return np.concatenate(parts) if parts else np.zeros(0)

    def _agrees(self, traces: Sequence[Trace]) -> bool:
        """Whether means over 50 parts, of all channels in units of their scales, differ more in time than by run."""
        edges = np.linspace(0.0, self.duration, BINS + 1)
        noise = signal = 0.0
        for quantity in self.quantities:
            if quantity.residual:
                continue
            parts = np.array([_means(quantity.of(t), t.times - t.times[0], edges) for t in traces])
            parts = parts.reshape(len(traces), BINS, -1)
            scatter = float(parts.var(axis=0, ddof=1).mean()) if len(traces) > 1 else 0.0
            noise += scatter
            signal += float(parts.mean(axis=0).var(axis=0).mean()) - scatter / len(traces)
        return noise <= signal

    def _partners(self, one: ObservedQuantity) -> list[str]:
        """Return the names of the channels with which a residual is multiplied."""
        channels = [q for q in self.quantities if one.residual and not q.residual]
        return [q.name for q in channels if q.scale.size == one.scale.size]

    def _flags_of(self, one: ObservedQuantity) -> list[tuple[str, int]]:
        width = one.scale.size
        return [(name, k) for name, k in self.flags if width % k == 0 and (k > 1 or width == 1)]

    def _statistic(
        self, quantity: ObservedQuantity, statistic: str, values: Mapping[str, FloatArray], trace: Trace
    ) -> FloatArray:
        x, times = values[quantity.name], trace.times - trace.times[0]
        if statistic == "bin":
            return _means(x, times, np.linspace(0.0, self.duration, BINS + 1))
        if statistic == "mean":
            return _means(x, times, self.duration * np.array(WINDOWS))
        if statistic == "ripple":
            return _ripple(x, times, self.duration)
        if statistic == "flag":
            phases = [_in_phases(x, trace, flag, width) for flag, width in self._flags_of(quantity)]
            return np.concatenate(phases)
        rows = []
        for s in (values[partner] for partner in self._partners(quantity)):
            rate = np.gradient(s, times, axis=0) * self.duration if len(times) > 1 else np.zeros_like(s)
            rows += [(x * s).mean(axis=0), (x * np.sign(s)).mean(axis=0), (x * rate).mean(axis=0)]
        return np.concatenate(rows)

    def _layout(self) -> Iterator[tuple[ObservedQuantity, str, int]]:
        for quantity in self.quantities:
            width = quantity.scale.size
            yield (
                (quantity, "bin", BINS * width)
                if self.clocked
                else (quantity, "mean", (len(WINDOWS) - 1) * width)
            )
            yield quantity, "ripple", 3 * width
            if flags := self._flags_of(quantity):
                yield quantity, "flag", 2 * len(flags) * width
            if partners := self._partners(quantity):
                yield quantity, "product", 3 * len(partners) * width


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
    """Return the means between edges [s], flat; NaN for a part of which less than half was recorded."""
    rows = []
    period = times[-1] / max(len(times) - 1, 1)
    for low, high in pairwise(edges):
        inside = slice(*np.searchsorted(times, (low - 1e-9, high - 1e-9)))
        whole = times[-1] + period > (low + high) / 2 and x[inside].size
        rows.append(x[inside].mean(axis=0) if whole else np.full(x.shape[1], np.nan))
    return np.concatenate(rows)


def _ripple(x: FloatArray, times: FloatArray, duration: float) -> FloatArray:
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
    return np.log(np.concatenate([*halves, x.std(axis=0)]) + FLOOR)


def _in_phases(x: FloatArray, trace: Trace, flag: str, width: int) -> FloatArray:
    """Return the means where a flag is 1 and where it is 0, flat; NaN for a phase that did not occur."""
    if flag not in trace.channels:
        return np.full(2 * x.shape[1], np.nan)
    on = np.repeat(_columns(trace, flag), x.shape[1] // width, axis=1)
    means = []
    for weight in (on, 1.0 - on):
        total = weight.sum(axis=0)
        means.append(np.where(total > 0, (weight * x).sum(axis=0) / np.where(total > 0, total, 1.0), np.nan))
    return np.concatenate(means)


def _columns(trace: Trace, name: str) -> FloatArray:
    values = trace.channels[name]
    return values[:, None] if values.ndim == 1 else values


def _rms(x: FloatArray) -> float:
    return float(np.sqrt((x**2).mean()))
