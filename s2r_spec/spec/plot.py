"""A plot of a rollout's signals and the values that the requirement allows."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any

from s2r_spec.base.errors import UsageError, one_of, require
from s2r_spec.base.files import saving
from s2r_spec.base.printable import one_line
from s2r_spec.robustness.explain import Explanation
from s2r_spec.robustness.tolerances import Tolerances

ENDINGS = (".svg", ".png", ".pdf")


@dataclass(frozen=True, repr=False)
class Plot:
    """A plot of a requirement on a trace; a notebook shows it.

    Attributes:
        figure: the ``matplotlib.figure.Figure``, to change or to add to.
        title: what it shows, in one line.
    """

    figure: Any
    title: str

    def save(self, path: str | PathLike[str]) -> Path:
        """Write the plot to a file that ends in ``.svg``, ``.png`` or ``.pdf``, and return its path.

        Raises:
            UsageError: the file name has another ending, or the file cannot be written.
        """
        file = _checked(path)
        with saving(file) as temporary:
            self.figure.savefig(temporary, dpi=150)
        return file

    def __repr__(self) -> str:
        """Return one line."""
        return one_line(f"Plot({self.title})")

    def _repr_svg_(self) -> str:
        """Return the picture for a notebook: the same text for the same plot."""
        import matplotlib as mpl

        file = BytesIO()
        with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "s2r"}):
            self.figure.savefig(file, format="svg", metadata={"Date": None})
        return file.getvalue().decode()


def plot(tolerances: Tolerances, explanation: Explanation, title: str, path: Path) -> None:
    """Draw a plot into a file; see :func:`draw`.

    Raises:
        UsageError: the file name has another ending, or matplotlib is not installed.
    """
    _checked(path)
    draw(tolerances, explanation, title).save(path)


def _checked(path: str | PathLike[str]) -> Path:
    file = Path(path)
    if file.suffix.lower() not in ENDINGS:
        raise UsageError(f"{file.name!r}: the file name of a plot ends in one of {one_of(ENDINGS)}")
    return file


def draw(tolerances: Tolerances, explanation: Explanation, title: str = "") -> Plot:
    """Draw every signal that the requirement reads, its tubes, and the instant that decides ρ.

    Raises:
        UsageError: matplotlib is not installed.
    """
    require("plots need", "matplotlib")
    # Not pyplot, which keeps figures in memory and looks for a screen.
    from matplotlib.figure import Figure

    count = max(1, len(tolerances.signals))
    figure = Figure(figsize=(7.5, 1.2 + 2.4 * count), layout="constrained")
    axes = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    for axis, label in zip(axes, tolerances.signals, strict=False):
        _signal(axis, tolerances, label)
    if explanation.instant is not None:
        _instant(axes, tolerances, explanation)
    for axis in axes[: len(tolerances.signals)]:
        axis.legend(loc="best", fontsize="small")
    axes[-1].set_xlabel("t [s]")
    verdict = f"{explanation.requirement}: ρ = {explanation.rho:+.4g} {explanation.unit}".rstrip()
    why = explanation.reason or (
        f"decided at t = {explanation.when} by {explanation.predicate}: "
        f"margin {explanation.margin:+.4g} {explanation.margin_unit}".rstrip()
    )
    # A dollar sign would begin a formula.
    words = "\n".join(filter(None, (title, verdict, why)))
    figure.suptitle(words.replace("$", r"\$"), fontsize="small")
    return Plot(figure, verdict)


def _signal(axis: Any, tolerances: Tolerances, label: str) -> None:
    """Draw one signal over its tubes."""
    samples, unit = tolerances.signals[label], tolerances.units[label]
    axis.plot(tolerances.times, samples, color="C0", label=label)
    for name, value in tolerances.levels[label].items():
        axis.axhline(value, color="0.3", linestyle="--", linewidth=1.0, label=name)
    tubes = [tube for tube in tolerances.tubes if tube.signal == label]
    ends = [end for tube in tubes for band in tube.bands for end in band if abs(end) < float("inf")]
    low, high = min([*samples, *ends]), max([*samples, *ends])
    room = 0.08 * (high - low) or 0.1
    axis.set_ylim(low - room, high + room)
    for number, tube in enumerate(tubes):
        for start, stop in tube.bands:
            axis.fill_between(
                [tube.start, tube.end],
                max(start, low - room),
                min(stop, high + room),
                color=f"C{number + 1}",
                alpha=0.2,
                linewidth=0.0,
                label=tube.predicate.replace("$", r"\$"),
            )
    axis.set_ylabel(f"{label} [{unit}]" if unit else label)


def _instant(axes: Any, tolerances: Tolerances, explanation: Explanation) -> None:
    """Mark the instant that decides ρ, and the signals' values there."""
    for axis in axes:
        axis.axvline(explanation.instant, color="C3", linestyle=":", linewidth=1.0)
    labels = list(tolerances.signals)
    for observed in explanation.signals:
        if observed.name in labels:
            axes[labels.index(observed.name)].plot([explanation.instant], [observed.value], "o", color="C3")
