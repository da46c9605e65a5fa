"""Pictures of the worst rollouts: the signals that the requirement reads, and the values that it allows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from s2r_spec import logs
from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import S2RError
from s2r_spec.report.check import test_words
from s2r_spec.report.figures.canvas import BAD, BAND, INK, MUTED, Picture, hover_strips, pictured, with_unit
from s2r_spec.report.figures.tolerance import Component, Margins, held_predicates, margins, reads
from s2r_spec.runs.journal import Record
from s2r_spec.runs.scorer import Scorer
from s2r_spec.runs.task import run_task
from s2r_spec.spec import Explanation, Spec
from s2r_spec.trace import Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

_MOST_TRACES = 2
_MOST_PANELS = 6
_MOST_SIBLINGS = 8
_VALUES = 121
_STRIPS = 32
"""Definition: parts of the time axis at which a reader can point."""


@dataclass(frozen=True)
class JournalRollouts:
    """The rollouts of one journal, in its folder, with their spec and requirement.

    Attributes:
        called: name of their backend: "sim", "twin:lab".
        model_hash: the hash of the backend when it ran.
    """

    spec: Spec
    requirement: str
    unit: str
    folder: Path
    records: tuple[Record, ...]
    called: str
    model_hash: str


@dataclass(frozen=True)
class Panel:
    """One signal, or one component of it."""

    label: str
    times: FloatArray
    samples: FloatArray
    others: tuple[tuple[FloatArray, FloatArray], ...]
    beside: tuple[tuple[FloatArray, FloatArray], ...]
    limits: tuple[Margins, ...]


def worst_records(runs: JournalRollouts) -> list[Record]:
    """Return the rollout of the lowest ρ at each of the lowest tests, lowest first."""
    chosen: dict[tuple[float, ...], Record] = {}
    for record in sorted(runs.records, key=lambda record: (record.rho, record.query, record.replicate)):
        chosen.setdefault(tuple(record.params.values()), record)
    return list(chosen.values())[:_MOST_TRACES]


def trace_picture(runs: JournalRollouts, record: Record, name: str) -> Picture:
    """Draw one rollout over time, with others at the same test behind it."""
    test = test_words(record.params, runs.spec.space.units)
    title = f"Rollout {record.query}.{record.replicate}: ρ = {_number(record.rho, runs.unit)} at {test}"
    return _picture(runs, record, title, (), name)


def pair_picture(
    real: JournalRollouts, record: Record, simulated: JournalRollouts, matching: Sequence[Record], name: str
) -> Picture:
    """Draw a real rollout, and beside it the simulated ones that it was compared with."""
    test = test_words(record.params, real.spec.space.units)
    mean = float(np.mean([other.rho for other in matching]))
    title = (
        f"Pair {record.query}.{record.replicate} at {test}: ρ = {_number(mean, real.unit)} in {simulated.called}, "
        f"{_number(record.rho, real.unit)} in {real.called}, Δ = {_number(record.rho - mean, real.unit)}"
    )
    beside = [sibling for other in matching if (sibling := read_trace(simulated, other)) is not None]
    return _picture(real, record, title, tuple(beside), name, simulated.called)


def _picture(
    runs: JournalRollouts, record: Record, title: str, beside: tuple[Trace, ...], name: str, other: str = ""
) -> Picture:
    trace = read_trace(runs, record)
    if trace is None:
        why = record.failure or "its trace is not on disk"
        return Picture(title, f"There is nothing to draw: {why}.", "", "")
    reason, decided = None, ""
    with suppress(S2RError):
        reason = runs.spec.explain(trace, runs.requirement, record.params)
        if reason.instant is not None:
            margin = f"{reason.margin:+.4f} {reason.margin_unit}".rstrip()
            decided = f"Decided at t = {reason.when} by {reason.predicate} (margin {margin})."
    panels = _panels(runs, trace, record, beside)

    def paint(figure: Figure) -> None:
        rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, panel in zip(rows, panels, strict=True):
            paint_panel(axes, panel, reason, (runs.called, other))
        if beside:
            lines = legend_lines(rows[0], runs.called, other)
            rows[0].legend(handles=lines, loc="upper left", ncols=2, borderaxespad=0, bbox_to_anchor=(0, 1.2))
        rows[-1].set_xlabel("time [s]")

    signals = ", ".join(panel.label for panel in panels)
    alt = f"{signals} over time in the rollout with ρ = {_number(record.rho, runs.unit)}"
    if beside:
        alt += f", beside {len(beside)} of {other} at the same test"
    fell = f" It ended with a {record.failure}, which counts as the declared ρ." if record.failure else ""
    caption = f"{decided}{fell} The requirement forbids the red area" + (
        "; thin lines are other rollouts at this test." if panels[0].others else "."
    )
    return pictured(title, caption, alt, name, 0.7 + 1.6 * len(panels), paint)


def legend_lines(axes: Axes, own: str, beside: str) -> list[Line2D]:
    """Return lines as :func:`paint_panel` draws them, with their names."""
    return [
        *axes.plot([], [], color=INK, lw=1.6, label=own),
        *axes.plot([], [], color=BAND, lw=1.6, ls=(0, (5, 2)), label=beside),
    ]


def read_trace(runs: JournalRollouts, record: Record) -> Trace | None:
    """Return the trace of a rollout, or None if there is none."""
    with suppress(S2RError):  # if the file is gone, the report is made without the picture
        if record.trace is not None:
            return logs.read(runs.folder / record.trace)
        if record.failure is None and runs.called.startswith("log:"):
            # A recording is not copied into the run: it is drawn if its file is unchanged.
            scorer = Scorer.for_spec(runs.spec, runs.requirement, runs.called)
            task = scorer.task(record.query, record.replicate, record.params, record.seed)
            return run_task(replace(task, model_hash=runs.model_hash))[0]
    return None


def _number(rho: float, unit: str) -> str:
    return f"{rho:+.4f} {unit}".rstrip()


def _panels(runs: JournalRollouts, trace: Trace, record: Record, beside: tuple[Trace, ...]) -> list[Panel]:
    same = [other for other in runs.records if other.params == record.params and other is not record]
    others = [sibling for other in same[:_MOST_SIBLINGS] if (sibling := read_trace(runs, other)) is not None]
    panels = []
    for name in runs.spec.channels(runs.requirement):
        unit = trace.units.get(name, runs.spec.signals[name].unit)
        for column in range(trace[name].shape[1]) if trace[name].ndim == 2 else [None]:
            one = Component(name, column)
            panel = Panel(
                with_unit(one.label, unit),
                trace.times,
                one.samples(trace),
                tuple((other.times, one.samples(other)) for other in others),
                tuple((other.times, one.samples(other)) for other in beside),
                limits(runs.spec, runs.requirement, trace, record.params, one),
            )
            panels.append(panel)
    return panels[:_MOST_PANELS]


def limits(
    spec: Spec,
    requirement: str,
    trace: Trace,
    params: Mapping[str, float],
    component: Component,
    around: FloatArray | None = None,
    reach: float = 0.0,
) -> tuple[Margins, ...]:
    """Return the requirement's margins for other values of one component of a signal, around its samples.

    With ``around`` (samples of the trace,) the values are differences from these; ``reach`` is how far the recorded
    samples are from them [unit of the signal].
    """
    own = component.samples(trace)
    low, high = float(own.min()), float(own.max())
    span = (high - low) or abs(high) or 1.0
    ends = low - 2 * span, high + 2 * span
    curves = []
    for must in held_predicates(spec.formulas[requirement]):
        if reads(must.predicate, component):
            margins_at = partial(margins, spec, trace, params, must, component, around=around)
            if around is not None and (here := margins_at(np.zeros(1))) is not None:
                far = 2.5 * max(reach, float(np.abs(here.margins).max()))
                ends = -far, far
            curves.append(margins_at(np.linspace(*ends, _VALUES)))
    return tuple(limit for limit in curves if limit is not None)


def paint_panel(axes: Axes, panel: Panel, reason: Explanation | None, names: tuple[str, str]) -> None:
    """Draw one signal and its forbidden values; with a reason, also the instant that decides ρ.

    ``names`` are those of the signal's source, and of what is drawn beside it.
    """
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
    for times, samples in panel.beside:
        axes.plot(times, samples, color=BAND, lw=1.6, ls=(0, (5, 2)))
    axes.plot(panel.times, panel.samples, color=INK, lw=1.6)
    if reason is not None and reason.instant is not None:
        axes.axvline(reason.instant, color=BAD, lw=1, ls=(0, (4, 3)))
        at = float(np.interp(reason.instant, panel.times, panel.samples))
        axes.plot(reason.instant, at, "o", color="none", mec=BAD, mew=2, ms=9)
    drawn = (panel.samples, *(samples for _, samples in (*panel.others, *panel.beside)))
    shown = [*edges, *(float(end(samples)) for samples in drawn for end in (np.min, np.max))]
    room = 0.15 * (max(shown) - min(shown) or 1.0)
    axes.set_ylim(min(shown) - room, max(shown) + room)
    axes.set_ylabel(panel.label)
    edges = np.linspace(panel.times[0], panel.times[-1], _STRIPS + 1).tolist()
    hover_strips(axes, edges, [_told(panel, names, (a + b) / 2) for a, b in pairwise(edges)])


def _told(panel: Panel, names: tuple[str, str], time: float) -> str:
    """Return the values at a time: "t = 0.52 s: real 0.31, simulated 0.28; vx [m/s]"."""
    drawn = [(names[0], (panel.times, panel.samples)), *((names[1], one) for one in panel.beside[:1])]
    values = ", ".join(f"{name} {np.interp(time, *samples):.3g}" for name, samples in drawn)
    return f"t = {time:.3g} s: {values}; {panel.label}"
