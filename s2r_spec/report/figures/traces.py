"""The worst rollouts: the signals that the requirement reads, inside what it allows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from s2r_spec import logs
from s2r_spec.errors import S2RError
from s2r_spec.report.checked import test_words
from s2r_spec.report.figures.canvas import BAD, INK, MUTED, Picture, draw, with_unit
from s2r_spec.report.figures.tolerance import Margins, held, margins, reads
from s2r_spec.report.recompute import Recomputed
from s2r_spec.rollouts.journal import Record
from s2r_spec.spec import Explanation
from s2r_spec.trace import Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

_MOST_TRACES = 2
_MOST_PANELS = 6
_MOST_SIBLINGS = 8
_VALUES = 121


@dataclass(frozen=True)
class _Panel:
    """One signal, or one component of it."""

    label: str
    times: FloatArray
    samples: FloatArray
    others: tuple[tuple[FloatArray, FloatArray], ...]
    limits: tuple[Margins, ...]


def worst_records(run: Recomputed) -> list[Record]:
    """Return the rollout of the lowest ρ at each of the lowest tests, lowest first."""
    chosen: dict[tuple[float, ...], Record] = {}
    for record in sorted(run.records, key=lambda record: (record.rho, record.query, record.replicate)):
        chosen.setdefault(tuple(record.params.values()), record)
    return list(chosen.values())[:_MOST_TRACES]


def trace_picture(run: Recomputed, record: Record, name: str) -> Picture:
    """Draw one rollout over time, with others at the same test behind it."""
    unit = f" {run.result.unit}" if run.result.unit else ""
    test = test_words(record.params, run.spec.space.units)
    title = f"Rollout {record.query}.{record.replicate}: ρ = {record.rho:+.4f}{unit} at {test}"
    trace = read_trace(run, record)
    if trace is None:
        why = record.failure or "its trace is not on disk"
        return Picture(title, f"There is nothing to draw: {why}.", "", "")
    reason = _explained(run, trace, record)
    panels = _panels(run, trace, record)

    def paint(figure: Figure) -> None:
        rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, panel in zip(rows, panels, strict=True):
            _paint(axes, panel, reason)
        rows[-1].set_xlabel("time [s]")

    signals = ", ".join(panel.label for panel in panels)
    alt = f"{signals} over time in the rollout with ρ = {record.rho:+.4f}{unit}"
    fell = f" It ended with a {record.failure}, which counts as the declared ρ." if record.failure else ""
    caption = f"{_words(reason)}{fell} Shaded red is what the requirement forbids" + (
        ", thin lines are other rollouts at this test." if panels[0].others else "."
    )
    return Picture(title, caption, alt, draw(name, alt, (7.2, 0.7 + 1.9 * len(panels)), paint))


def read_trace(run: Recomputed, record: Record) -> Trace | None:
    """Return the trace of a rollout, or None if there is none."""
    if record.trace is None:
        return None
    try:
        return logs.read(run.result.folder / record.trace)
    except S2RError:
        return None  # somebody tidied up: a report can do without


def _explained(run: Recomputed, trace: Trace, record: Record) -> Explanation | None:
    try:
        return run.spec.explain(trace, run.result.requirement, record.params)
    except S2RError:
        return None


def _words(reason: Explanation | None) -> str:
    if reason is None or reason.instant is None:
        return ""
    margin = f"{reason.margin:+.4f} {reason.margin_unit}".rstrip()
    return f"Decided at t = {reason.instant:g} s by {reason.predicate} (margin {margin})."


def _panels(run: Recomputed, trace: Trace, record: Record) -> list[_Panel]:
    same = [other for other in run.records if other.params == record.params and other is not record][
        :_MOST_SIBLINGS
    ]
    others = [found for other in same if (found := read_trace(run, other)) is not None]
    panels = []
    for name in run.spec.channels(run.result.requirement):
        columns = range(trace[name].shape[1]) if trace[name].ndim == 2 else [None]
        for column in columns:
            panels.append(_panel(run, trace, others, record, name, column))
    return panels[:_MOST_PANELS]


def _panel(
    run: Recomputed, trace: Trace, others: list[Trace], record: Record, name: str, column: int | None
) -> _Panel:
    def samples(one: Trace) -> FloatArray:
        return one[name] if column is None else one[name][:, column]

    unit = trace.units.get(name, run.spec.signals[name].unit)
    own = samples(trace)
    low, high = float(own.min()), float(own.max())
    span = (high - low) or abs(high) or 1.0
    values = np.linspace(low - 2 * span, high + 2 * span, _VALUES)
    limits = [
        margins(run.spec, trace, record.params, must, name, column, values)
        for must in held(run.spec.formulas[run.result.requirement])
        if reads(must.predicate, name, column)
    ]
    return _Panel(
        with_unit(name if column is None else f"{name}[{column}]", unit),
        trace.times,
        own,
        tuple((one.times, samples(one)) for one in others),
        tuple(limit for limit in limits if limit is not None),
    )


def _paint(axes: Axes, panel: _Panel, reason: Explanation | None) -> None:
    edges: list[float] = []
    for limit in panel.limits:
        forbidden = limit.margins < 0
        if forbidden.any():
            worst = float(limit.margins.min())
            axes.contourf(
                limit.times, limit.values, limit.margins, [worst - 1, 0.0], colors=[BAD], alpha=0.16
            )
        if forbidden.any() and not forbidden.all():
            axes.contour(limit.times, limit.values, limit.margins, [0.0], colors=[BAD], linewidths=1)
            rows = np.flatnonzero((forbidden[1:] != forbidden[:-1]).any(axis=1))
            edges += [float(limit.values[rows[0]]), float(limit.values[rows[-1] + 1])]
    for times, samples in panel.others:
        axes.plot(times, samples, color=MUTED, lw=0.6, alpha=0.6)
    axes.plot(panel.times, panel.samples, color=INK, lw=1.6)
    if reason is not None and reason.instant is not None:
        axes.axvline(reason.instant, color=BAD, lw=1, ls=(0, (4, 3)))
        at = float(np.interp(reason.instant, panel.times, panel.samples))
        axes.plot(reason.instant, at, "o", color="none", mec=BAD, mew=2, ms=9)
    seen = [
        *edges,
        *(float(end(s)) for s in (panel.samples, *(o[1] for o in panel.others)) for end in (np.min, np.max)),
    ]
    room = 0.15 * (max(seen) - min(seen) or 1.0)
    axes.set_ylim(min(seen) - room, max(seen) + room)
    axes.set_ylabel(panel.label)
