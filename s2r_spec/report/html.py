"""The report as one HTML page that opens offline: verdict first, pictures, and all that it rests on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from s2r_spec.certify import outward
from s2r_spec.certify.certificate import Label
from s2r_spec.certify.check import Verdict
from s2r_spec.errors import UsageError
from s2r_spec.report import checked
from s2r_spec.report.figures.band import band
from s2r_spec.report.figures.canvas import Picture
from s2r_spec.report.figures.interval import interval
from s2r_spec.report.figures.traces import trace_picture, worst_records
from s2r_spec.report.finding import Finding
from s2r_spec.report.recompute import Recomputed, recompute

PACKAGES = ("jinja2", "matplotlib")
SIGNS = {Verdict.HOLDS: "✓", Verdict.VIOLATED: "✗", Verdict.UNKNOWN: "?"}


@dataclass(frozen=True)
class Bar:
    """An interval on a number line that has 0 on it; places in percent of the line."""

    label: str
    words: str
    zero: float
    left: float
    width: float


@dataclass(frozen=True)
class Part:
    """What the page says of one requirement."""

    finding: Finding
    sign: str
    note: str
    bars: tuple[Bar, ...]
    ladder_note: str
    pictures: tuple[Picture, ...]
    settings: tuple[tuple[str, str], ...]
    spec_text: str


def require_packages() -> None:
    """Say what to install if a page cannot be made here.

    Raises:
        UsageError: a package is missing.
    """
    lacking = [name for name in PACKAGES if find_spec(name) is None]
    if lacking:
        raise UsageError(
            f"an HTML report needs {' and '.join(lacking)}, not installed here; try: pip install 's2r[report]'"
        )


def from_runs(folders: Sequence[Path]) -> str:
    """Return the page of these runs' folders; see :func:`render`."""
    return render([recompute(folder) for folder in folders])


def render(runs: Sequence[Recomputed]) -> str:
    """Return the page: the same bytes for the same runs.

    Raises:
        UsageError: a package is missing.
    """
    require_packages()
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    template = (files("s2r_spec.report") / "template.html").read_text(encoding="utf-8")
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["svg"] = Markup
    parts = [_part(run, f"r{number}") for number, run in enumerate(runs)]
    return environment.from_string(template).render(parts=parts, version=runs[0].result.provenance["s2r"])


def _part(run: Recomputed, name: str) -> Part:
    result = run.result
    bars = ladder_bars(run)
    return Part(
        finding=checked.finding(run.spec, result),
        sign=SIGNS[result.verdict],
        note=_note(run),
        bars=bars,
        ladder_note=checked.refuted_words(result),
        pictures=tuple(_pictures(run, name)),
        settings=tuple((key, _plain(value)) for key, value in _settings(run).items()),
        spec_text=run.spec.text,
    )


def ladder_bars(run: Recomputed) -> tuple[Bar, ...]:
    """Return the interval for B, 2B, 4B and 8B, all on one number line."""
    ladder = run.result.certificate.ladder
    ends = [0.0, *(-rung.upper for rung in ladder), *(-rung.lower for rung in ladder)]
    low, high = min(ends), max(ends)
    room = 0.06 * (high - low or 1.0)
    low, high = low - room, high + room

    def place(value: float) -> float:
        return round(100 * (value - low) / (high - low), 3)

    return tuple(
        Bar(
            label=f"B = {rung.B:g} {run.result.unit}".rstrip(),
            words=f"{outward.between(-rung.upper, -rung.lower)} {run.result.unit}".rstrip(),
            zero=place(0.0),
            left=place(-rung.upper),
            width=max(0.5, round(place(-rung.lower) - place(-rung.upper), 3)),
        )
        for rung in ladder
    )


def _pictures(run: Recomputed, name: str) -> list[Picture]:
    if not run.history:
        return []
    pictures = [band(run, f"{name}-band"), interval(run, f"{name}-interval")]
    return pictures + [
        trace_picture(run, record, f"{name}-trace{i}") for i, record in enumerate(worst_records(run))
    ]


def _note(run: Recomputed) -> str:
    if run.result.certificate.label is Label.REFUSED:
        return "The certificate was refused: no band and no interval on this page is a promise."
    if run.waiting:
        return (
            f"This run is unfinished: {run.waiting} rollouts of its last batch are on disk and not counted yet. "
            f"What is shown is valid as it stands."
        )
    return ""


def _settings(run: Recomputed) -> dict[str, Any]:
    source = run.result.provenance
    return {**{key: value for key, value in source.items() if key != "settings"}, **source["settings"]}


def _plain(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list):
        return ", ".join(map(_plain, value)) or "none"
    return str(value)
