"""From a trace to a feature vector: what of a rollout the diagnosis compares.

The same for every robot: the channels alone decide what is computed. Means over
windows of time say where a channel is, the scatter within short blocks says how
it ripples, means over the samples at which a binary channel (stance) is 0 and 1
say in which phase, and products of channels of the same width (a torque residual
with a joint speed) tell laws apart that agree on average; a residual that goes with
the *rate* of another channel is what a delay leaves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend
from s2r_spec.diagnose.equations import Equations, Instruments, Probe
from s2r_spec.diagnose.simulator.experiments import RESIDUAL
from s2r_spec.errors import UsageError
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

WINDOWS = (0.0, 0.1, 0.2, 0.35, 0.55, 0.775, 1.0)
"""Edges of the windows, as parts of a rollout: finer where the command has just changed."""
BLOCKS = 60
"""Ripple is the scatter within blocks of this part of a rollout."""
TWINS = 0.2
"""Two channels are one quantity measured twice when the nominal difference has less than this part of their rms."""
NOTHING = 0.05
"""A difference of two channels counts as nothing below this part of how much the channels vary, and a
residual below this part of how much any channel of its unit varies."""
FLOOR = 0.1
"""Ripple below this part of a column's scale counts as none."""
MANY = 6
"""All products of channels are taken among at most so many of one width; past it, those with residuals."""


@dataclass(frozen=True)
class Block:
    """Columns that are taken from one channel, or from the difference of two."""

    name: str
    source: str
    minus: str | None
    width: int
    residual: bool
    """Whether the nominal model says that it should be (nearly) nothing."""


@dataclass(frozen=True)
class Feature:
    """One number of the feature vector, in words."""

    block: str
    column: int
    statistic: str
    """``mean``, ``ripple``, ``spread``, ``when STANCE=1``, ``times dq``, ``times sign dq``, ``times rate dq``,
    ``survived`` or ``equation``."""
    window: tuple[float, float]
    """Begin and end [s]."""


@dataclass(frozen=True)
class Features:
    """What is computed from every trace, fixed once from nominal rollouts.

    Attributes:
        duration: of a rollout [s].
        blocks: channels and differences.
        scale: (columns,) rms of each column over the nominal rollouts; 1 where that is nothing.
        reference: (columns,) how much the quantity itself varies, in ``scale``, where the column is a
            difference or a residual of it; 0 for a channel.
        flags: binary channels → width.
        products: pairs of block names whose columns are multiplied.
        rates: pairs of block names; the first is multiplied with how fast the second changes.
        pace: (columns,) rms rate of each column over the nominal rollouts, in ``scale`` per second.
        little: (columns,) rms that a little of every effect makes of a residual and the equations do not explain, in
            ``scale``; 0 if that is not known.
        probes: effects of which the equations of motion are asked; see :mod:`s2r_spec.diagnose.equations`.
        voids: residual → g, one number a probe, where a model without mass and motors would explain it.
        instrumented: whether the nominal simulator's own motions are instruments for that.
    """

    duration: float
    blocks: tuple[Block, ...]
    scale: FloatArray
    reference: FloatArray
    flags: Mapping[str, int]
    products: tuple[tuple[str, str], ...]
    rates: tuple[tuple[str, str], ...]
    pace: FloatArray
    little: FloatArray
    probes: tuple[Probe, ...] = ()
    voids: Mapping[str, Sequence[float]] = field(default_factory=dict)
    instrumented: bool = False

    @classmethod
    def of_nominal(cls, traces: Sequence[Trace], duration: float) -> Features:
        """Choose from traces with residuals."""
        names = [n for n in traces[0].channels if all(n in t.channels for t in traces)]
        stacked = {n: np.concatenate([_columns(t, n) for t in traces]) for n in names}
        flags = {n: x.shape[1] for n, x in stacked.items() if np.isin(x, (0.0, 1.0)).all() and np.ptp(x) > 0}
        blocks = [
            Block(n, n, None, x.shape[1], n.startswith(RESIDUAL))
            for n, x in stacked.items()
            if np.isfinite(x).all()
        ]
        units = traces[0].units
        least: dict[str, FloatArray] = {}
        kept = {b.name: stacked[b.name] for b in blocks}
        for a, b in combinations([n for n in kept if n not in flags and not n.startswith(RESIDUAL)], 2):
            if kept[a].shape[1] == kept[b].shape[1] and units.get(a, "") == units.get(b, "") != "":
                difference = kept[a] - kept[b]
                if _rms(difference) < TWINS * min(_rms(kept[a]), _rms(kept[b])):
                    name = f"{a} - {b}"
                    blocks.append(Block(name, a, b, difference.shape[1], True))
                    stacked[name] = difference
                    least[name] = NOTHING * np.minimum(kept[a].std(axis=0), kept[b].std(axis=0))
        spreads: dict[str, float] = {}
        for n, x in kept.items():
            if n not in flags and not n.startswith(RESIDUAL):
                for spread in x.std(axis=0):
                    if spread > 1e-9:
                        unit = units.get(n, "")
                        spreads[unit] = min(spreads.get(unit, np.inf), float(spread))
        for block in blocks:
            if block.source.startswith(RESIDUAL) and (unit := units.get(block.source, "")) in spreads:
                least[block.name] = np.full(block.width, NOTHING * spreads[unit])
        scale = np.concatenate([np.sqrt((stacked[b.name] ** 2).mean(axis=0)) for b in blocks])
        own = np.concatenate([np.full(b.width, _rms(stacked[b.name])) for b in blocks])
        # A column that is nothing is measured in the scale of its channel.
        scale = np.where(scale > 1e-9 * own, scale, np.where(own > 1e-12, own, 1.0))
        nothing = np.concatenate([least.get(b.name, np.zeros(b.width)) for b in blocks])
        scale = np.maximum(scale, nothing)
        moved = [np.concatenate([_rate(_block(t, b), t.times) for t in traces if len(t) > 1]) for b in blocks]
        pace = np.concatenate([np.sqrt((m**2).mean(axis=0)) for m in moved]) / scale
        return cls(
            duration,
            tuple(blocks),
            scale,
            nothing / NOTHING / scale,
            flags,
            _products(blocks, flags),
            _rates(blocks, flags),
            np.where(pace > 1e-12, pace, 1.0),
            np.zeros(len(scale)),
        )

    def names(self) -> tuple[Feature, ...]:
        """Return what each entry of :meth:`vector`, and then of :meth:`equations`, is."""
        edges = self.duration * np.array(WINDOWS)
        whole = (0.0, self.duration)
        half = self.duration / 2
        columns = [(b, i) for b in self.blocks for i in range(b.width)]
        out = [
            Feature(b.name, i, "mean", (float(low), float(high)))
            for low, high in pairwise(edges)
            for b, i in columns
        ]
        for window in ((0.0, half), (half, self.duration)):
            out += [Feature(b.name, i, "ripple", window) for b, i in columns]
        out += [Feature(b.name, i, "spread", whole) for b, i in columns]
        for flag, width in self.flags.items():
            for b in self.blocks:
                if _in_phase(b, flag, width):
                    out += [
                        Feature(b.name, i, f"when {flag}={v}", whole) for v in (1, 0) for i in range(b.width)
                    ]
        for a, s in self.products:
            width = self._width(a)
            out += [Feature(a, i, f"times {s}", whole) for i in range(width)]
            out += [Feature(a, i, f"times sign {s}", whole) for i in range(width)]
        for a, s in self.rates:
            out += [Feature(a, i, f"times rate {s}", whole) for i in range(self._width(a))]
        out.append(Feature("", 0, "survived", whole))
        out += [Feature(p.name, 0, "equation", whole) for p in self.probes]
        return tuple(out)

    def residual_units(self) -> dict[str, FloatArray]:
        """Return residual → (columns,) in which the equations measure it: what they leave of it where nothing is wrong.

        A model that is exact leaves next to nothing of its own motions; no machine is without a little of everything.
        """
        units = self.scale * np.hypot(1.0, self.little)
        return {
            block.source.removeprefix(RESIDUAL): units[part]
            for block, part in zip(self.blocks, self._slices(), strict=True)
            if block.source.startswith(RESIDUAL)
        }

    def of_residuals(self, values: Mapping[str, FloatArray]) -> FloatArray:
        """Return (columns,) the values that residuals have, by name, and 0 for all else."""
        out = np.zeros(len(self.scale))
        for block, part in zip(self.blocks, self._slices(), strict=True):
            if block.source.startswith(RESIDUAL):
                out[part] = values[block.source.removeprefix(RESIDUAL)]
        return out

    def equations(
        self,
        trace: Trace,
        backend: Backend,
        params: Mapping[str, float],
        instruments: Instruments | None = None,
    ) -> FloatArray:
        """Return (probes,): see :meth:`s2r_spec.diagnose.equations.Equations.regressed`."""
        return self.asked(backend).regressed(trace, params, instruments) if self.probes else np.zeros(0)

    def asked(self, backend: Backend) -> Equations:
        """Return what the equations of motion of a backend are asked."""
        return Equations(backend, self.probes, self.residual_units(), self.voids)

    def referred(self, feature: Feature) -> float:
        """Return ``reference`` of a feature's column."""
        place = {b.name: part.start for b, part in zip(self.blocks, self._slices(), strict=True)}
        return float(self.reference[place[feature.block] + feature.column])

    def vector(self, trace: Trace) -> FloatArray:
        """Return (p,) features; NaN where the trace ended before, or lacks the channel."""
        times = trace.times - trace.times[0]
        x = np.concatenate([_block(trace, b) for b in self.blocks], axis=1) / self.scale
        end = times[-1] + (times[-1] / max(len(times) - 1, 1))
        out = []
        edges = self.duration * np.array(WINDOWS)
        for low, high in pairwise(edges):
            inside = (times >= low - 1e-9) & (times < high - 1e-9)
            # A window of which less than half was recorded says nothing.
            out.append(x[inside].mean(axis=0) if inside.any() and end > (low + high) / 2 else _none(x))
        block = np.minimum((times / (self.duration / BLOCKS) + 1e-9).astype(int), BLOCKS - 1)
        starts = np.flatnonzero(np.diff(block, prepend=-1))
        counts = np.diff(np.append(starts, len(times)))[:, None]
        means = np.add.reduceat(x, starts) / counts
        squares = np.maximum(np.add.reduceat(x**2, starts) / counts - means**2, 0.0)
        late = block[starts] >= BLOCKS // 2
        for part in (~late, late):
            ripple = np.sqrt(squares[part].mean(axis=0)) if part.any() else _none(x)
            out.append(np.log(ripple + FLOOR))
        out.append(np.log(x.std(axis=0) + FLOOR))
        place = dict(zip((b.name for b in self.blocks), self._slices(), strict=True))
        for flag, width in self.flags.items():
            f = _columns(trace, flag) if flag in trace.channels else np.full((len(times), width), np.nan)
            for b in self.blocks:
                if _in_phase(b, flag, width):
                    weight = np.repeat(f, b.width // width, axis=1)
                    for w in (weight, 1.0 - weight):
                        total = w.sum(axis=0)
                        sums = (w * x[:, place[b.name]]).sum(axis=0)
                        out.append(np.where(total > 0, sums / np.where(total > 0, total, 1.0), np.nan))
        for a, s in self.products:
            left, right = x[:, place[a]], x[:, place[s]]
            out.append((left * right).mean(axis=0))
            out.append((left * np.sign(right)).mean(axis=0))
        if self.rates:
            rate = _rate(x, times) / self.pace
            out += [(x[:, place[a]] * rate[:, place[s]]).mean(axis=0) for a, s in self.rates]
        out.append(np.array([min(1.0, end / self.duration)]))
        return np.concatenate(out)

    def _width(self, name: str) -> int:
        return next(b.width for b in self.blocks if b.name == name)

    def _slices(self) -> list[slice]:
        ends = np.cumsum([b.width for b in self.blocks])
        return [slice(int(e) - b.width, int(e)) for e, b in zip(ends, self.blocks, strict=True)]


def _columns(trace: Trace, name: str) -> FloatArray:
    values = trace.channels[name]
    return values[:, None] if values.ndim == 1 else values


def _block(trace: Trace, block: Block) -> FloatArray:
    if block.source not in trace.channels or (block.minus is not None and block.minus not in trace.channels):
        return np.full((len(trace), block.width), np.nan)
    x = _columns(trace, block.source)
    if x.shape[1] != block.width:
        raise UsageError(
            f"channel {block.source!r} has {x.shape[1]} columns, and the simulator's has {block.width}"
        )
    return x if block.minus is None else x - _columns(trace, block.minus)


def _rate(x: FloatArray, times: FloatArray) -> FloatArray:
    """Return (n, columns) per second; 0 of a single sample."""
    return np.asarray(np.gradient(x, times, axis=0)) if len(times) > 1 else np.zeros_like(x)


def _rms(x: FloatArray) -> float:
    return float(np.sqrt((x**2).mean()))


def _none(x: FloatArray) -> FloatArray:
    return np.full(x.shape[1], np.nan)


def _in_phase(block: Block, flag: str, width: int) -> bool:
    return (
        block.source != flag
        and block.minus != flag
        and block.width % width == 0
        and (width > 1 or block.width == 1)
    )


def _products(blocks: Sequence[Block], flags: Mapping[str, int]) -> tuple[tuple[str, str], ...]:
    plain = [b for b in blocks if not b.residual and b.name not in flags]
    pairs = [(r.name, s.name) for r in blocks if r.residual for s in plain if s.width == r.width]
    for width in sorted({b.width for b in plain}):
        alike = [b.name for b in plain if b.width == width]
        if len(alike) <= MANY:
            pairs += list(combinations(alike, 2))
    return tuple(pairs)


def _rates(blocks: Sequence[Block], flags: Mapping[str, int]) -> tuple[tuple[str, str], ...]:
    plain = [b for b in blocks if not b.residual and b.name not in flags]
    return tuple((r.name, s.name) for r in blocks if r.residual for s in plain if s.width == r.width)
