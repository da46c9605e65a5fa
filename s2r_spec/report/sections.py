"""The sections of an HTML page, one for each result: text, pictures and number lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from s2r_spec.certify.bound.certificate import Certificate, Label
from s2r_spec.certify.bound.rounding import interval_text
from s2r_spec.certify.result.check_result import Tested, group_by_test
from s2r_spec.certify.result.compose import Composition
from s2r_spec.certify.result.gap_result import Pair
from s2r_spec.certify.search.pairing import SIMULATED_PER_REAL
from s2r_spec.report import certify as certify_report
from s2r_spec.report import check as check_report
from s2r_spec.report import gap as gap_report
from s2r_spec.report.figures.band import Field, band, interval
from s2r_spec.report.figures.canvas import Picture
from s2r_spec.report.figures.traces import JournalRollouts, pair_picture, trace_picture, worst_records
from s2r_spec.report.finding import Finding
from s2r_spec.report.recompute import Recomputed, RecomputedCertify, RecomputedGap, Run
from s2r_spec.runs.journal import Record

_WIDE = "The search spends few rollouts where the worst case cannot lie, so the band stays wide there."


@dataclass(frozen=True)
class Bar:
    """An interval on a number line that includes 0; positions in percent of the line's length."""

    label: str
    words: str
    zero: float
    left: float
    width: float


@dataclass(frozen=True)
class Bars:
    """Intervals on one number line."""

    title: str
    intro: str
    rows: tuple[Bar, ...]
    note: str


@dataclass(frozen=True)
class Section:
    """The section of the page on one requirement."""

    command: str
    finding: Finding
    note: str
    bars: tuple[Bars, ...]
    pictures: tuple[Picture, ...]
    settings: tuple[tuple[str, str], ...]
    spec_text: str
    version: str


def section(run: Run, name: str) -> Section:
    """Return the section of the page on a run; ``name`` makes the names of its pictures unique."""
    if isinstance(run, RecomputedCertify):
        return _certify(run, name)
    result = run.result
    if isinstance(run, Recomputed):
        command, symbol, finding = "s2r check", "ρ", check_report.finding(run.spec, run.result)
    else:
        command, symbol, finding = "s2r gap", "Δ", gap_report.finding(run.spec, run.result)
    return Section(
        command,
        finding,
        _note(run),
        (_ladder(f"worst expected {symbol}", result.certificate, result.unit),),
        tuple(_pictures(run, name)),
        _settings(result.provenance),
        run.spec.text,
        result.provenance["s2r"],
    )


def _certify(run: RecomputedCertify, name: str) -> Section:
    result, gap, composed = run.result, run.gap, run.result.composition
    simulated, unit = run.simulated.result, run.simulated.result.unit
    bars = [_ladder("worst expected ρ in simulation", simulated.certificate, unit)]
    pictures: list[Picture] = []
    settings = _settings(simulated.provenance, "simulation: ")
    note = _note(run.simulated)
    if gap is not None:
        bars.append(_ladder("worst expected Δ", gap.result.certificate, unit))
        settings += _settings(gap.result.provenance, "gap: ")
        note = note or _note(gap)
        if composed is not None:
            bars.insert(0, _summands(run, composed))
            pictures.append(band(_composed_field(run, gap, composed), f"{name}-promise"))
        pictures += _pictures(gap, f"{name}-gap")
    pictures += _pictures(run.simulated, f"{name}-simulation", worst=False)
    if gap is None and run.simulated.history:
        pictures += _worst_traces(run.simulated, name)
    return Section(
        "s2r certify",
        certify_report.finding(run.spec, result),
        note,
        tuple(bars),
        tuple(pictures),
        settings,
        run.spec.text,
        simulated.provenance["s2r"],
    )


# -- pictures ------------------------------------------------------------------------------------


def _pictures(run: Recomputed | RecomputedGap, name: str, worst: bool = True) -> list[Picture]:
    """Draw the bound over the test space, its interval after each batch, and the ``worst`` rollouts."""
    if not run.history:
        return []
    result = run.result
    if isinstance(run, Recomputed):
        symbol, quantity, tests, of = "ρ", "expected robustness", group_by_test(run.records), "rollouts"
        title, remark = f"The bound over the test space, in {result.provenance['backend']}", _WIDE
        batches, counted = "The interval after each batch", "rollouts"
    else:
        symbol, quantity, tests, of = "Δ", "expected gap", _tested_pairs(run.pairs), "pairs"
        title = "The gap between simulator and real machine"
        remark = f"Below 0 the real machine does worse than the simulator. {_WIDE}"
        batches = "The bound on the gap after each batch"
        counted = f"rollouts of {result.provenance['real']['backend']}"
    field = Field(
        space=run.spec.space,
        searches=(run.search,),
        tests=tuple(tests),
        mark=result.worst.params,
        height=result.worst.mean,
        pointed="worst test",
        lower=result.lower,
        upper=result.upper,
        symbol=symbol,
        name=quantity,
        unit=result.unit,
        title=title,
        dots=f"means over a test's {of}",
        remark=remark,
    )
    history = (*run.history[:-1], result.certificate)
    closed = interval(history, f"worst expected {symbol}", result.unit, batches, f"{name}-interval", counted)
    pictures = [band(field, f"{name}-band"), closed]
    if isinstance(run, RecomputedGap):
        return [*pictures, _worst_pair(run, name)]
    return [*pictures, *(_worst_traces(run, name) if worst else ())]


def _worst_traces(run: Recomputed, name: str) -> list[Picture]:
    runs = _runs(run, run.records)
    return [trace_picture(runs, record, f"{name}-trace{i}") for i, record in enumerate(worst_records(runs))]


def _worst_pair(run: RecomputedGap, name: str) -> Picture:
    """Draw the pair of the most negative Δ over the values that the requirement allows."""
    lowest = run.result.lowest.query, run.result.lowest.replicate
    record = next(one for one in run.real if (one.query, one.replicate) == lowest)
    matching = [one for one in run.simulated if (one.query, one.replicate // SIMULATED_PER_REAL) == lowest]
    real, simulated = _runs(run, run.real, "real"), _runs(run, run.simulated, "sim")
    return pair_picture(real, record, simulated, matching, f"{name}-pair")


def _runs(run: Recomputed | RecomputedGap, records: tuple[Record, ...], system: str = "") -> JournalRollouts:
    result = run.result
    source = result.provenance[system] if system else result.provenance
    made = source["backend"], source["model_hash"]
    return JournalRollouts(run.spec, result.requirement, result.unit, result.folder / system, records, *made)


def _composed_field(run: RecomputedCertify, gap: RecomputedGap, composed: Composition) -> Field:
    """Return the sum of both bands: the bound for the real machine at each test."""
    return Field(
        space=run.spec.space,
        searches=(run.simulated.search, gap.search),
        tests=tuple(group_by_test(gap.real)),
        mark=composed.worst,
        height=composed.lower,
        pointed="lowest bound",
        lower=composed.lower,
        upper=composed.upper,
        symbol="ρ",
        name="expected robustness",
        unit=run.simulated.result.unit,
        title=f"The bound for {run.result.real} at each test",
        dots="means over a test's real rollouts",
        remark="The band is the sum of the simulation's band and the gap's band.",
    )


def _tested_pairs(pairs: Sequence[Pair]) -> list[Tested]:
    """Group pairs by test; in the result a rollout means a pair, and ρ means Δ."""
    groups: dict[tuple[float, ...], list[Pair]] = {}
    for pair in pairs:
        groups.setdefault(tuple(pair.params.values()), []).append(pair)
    return [
        Tested(
            group[0].params,
            len(group),
            sum(pair.gap for pair in group) / len(group),
            min(pair.gap for pair in group),
            max(pair.gap for pair in group),
        )
        for group in groups.values()
    ]


# -- number lines --------------------------------------------------------------------------------


def bars(intervals: Sequence[tuple[str, float, float]], unit: str) -> tuple[Bar, ...]:
    """Return (label, lower, upper) intervals on one number line."""
    ends = [0.0, *(end for _, *ends_ in intervals for end in ends_)]
    low, high = min(ends), max(ends)
    room = 0.06 * (high - low or 1.0)
    low, high = low - room, high + room

    def place(value: float) -> float:
        return round(100 * (value - low) / (high - low), 3)

    return tuple(
        Bar(
            label=label,
            words=f"{interval_text(lower, upper)} {unit}".rstrip(),
            zero=place(0.0),
            left=place(lower),
            width=max(0.5, round(place(upper) - place(lower), 3)),
        )
        for label, lower, upper in intervals
    )


def _ladder(what: str, certificate: Certificate, unit: str) -> Bars:
    return Bars(
        f"Interval for larger B: {what}",
        f"The {what} if the norm is at most B. All rows hold at once. The red mark is 0.",
        bars(
            [(f"B = {rung.B:g} {unit}".rstrip(), -rung.upper, -rung.lower) for rung in certificate.ladder],
            unit,
        ),
        check_report.refuted_words(certificate, unit),
    )


def _summands(run: RecomputedCertify, composed: Composition) -> Bars:
    simulated, gap = run.result.simulated, run.result.gap
    assert gap is not None  # a composed bound has a gap
    rows = [
        ("worst ρ in simulation", simulated.lower, simulated.upper),
        ("Δ at any test", gap.low, gap.high),
        (f"worst ρ of {run.result.real}", composed.lower, composed.upper),
        ("the paper's sum", composed.paper_lower, composed.upper),
    ]
    return Bars(
        "The parts of the bound",
        "Intervals of expected values; the red mark is 0.",
        bars(rows, simulated.unit),
        f"The bound for {run.result.real} adds both bounds test by test. The paper adds the worst cases of both "
        "searches, wherever they lie, and gives only a lower end.",
    )


# -- words ---------------------------------------------------------------------------------------


def _note(run: Recomputed | RecomputedGap) -> str:
    if run.result.certificate.label is Label.ONE_SIDED:
        return (
            "Only the upper end of the worst expected ρ is certified, and it holds for every B. No band and no "
            "interval on this page is certified."
        )
    if not run.result.certificate.label.bounds:
        return "The certificate was refused: no band and no interval on this page is certified."
    if run.waiting:
        return (
            f"This run is unfinished: {run.waiting} rollouts of its last batch are on disk and not counted yet. "
            "The bounds on this page are valid."
        )
    return ""


def _settings(source: Mapping[str, Any], prefix: str = "") -> tuple[tuple[str, str], ...]:
    flat = {**{key: value for key, value in source.items() if key != "settings"}, **source["settings"]}
    return tuple((prefix + key, _plain_text(value)) for key, value in flat.items())


def _plain_text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list):
        return ", ".join(map(_plain_text, value)) or "none"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_plain_text(one)}" for key, one in value.items())
    return str(value)
