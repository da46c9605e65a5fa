"""A matplotlib figure as SVG for a page, with the page's colours and with text as text.

Colours are drawn as tokens, hex numbers that no colour map contains, and then replaced by CSS variables.
One picture therefore suits a light page, a dark page and paper.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from io import StringIO
from typing import TYPE_CHECKING, Any

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.printable import spell_unit

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage


INK, MUTED, RULE, BAND, GOOD, BAD = (f"#1aa00{digit}" for digit in range(1, 7))
PAPER = "#1aa007"
_VARIABLES = {
    INK: "var(--ink)",
    MUTED: "var(--muted)",
    RULE: "var(--rule)",
    BAND: "var(--accent)",
    GOOD: "var(--good)",
    BAD: "var(--bad)",
    PAPER: "var(--paper)",
}
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "text.parse_math": False,  # a name with two dollar signs is a name
    "axes.unicode_minus": True,
    "font.family": ["DejaVu Sans"],
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "grid.color": RULE,
    "axes.grid": True,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 9,
}
WIDTH = 5.2
"""Definition: width of a figure in a page [inch]. On a phone 390 pixels wide, text is then 10 pixels high."""
_IN_A_PAGE: dict[Any, Any] = dict.fromkeys(("font.size", "axes.titlesize", "legend.fontsize"), 10.5)
_WIDEST_NAME = 40
_HOVER = "hover: "
"""Definition: how the name of something drawn begins whose rest a reader sees who points at it."""


@dataclass(frozen=True)
class Picture:
    """A figure with a title, a caption, and a text alternative for readers who cannot see it."""

    title: str
    caption: str
    alt: str
    svg: str


def pictured(
    title: str, caption: str, alt: str, name: str, height: float, paint: Callable[[Figure], None]
) -> Picture:
    """Return a figure for a page, of a height [inch], named uniquely in it; ``paint`` draws on an empty figure."""
    return Picture(title, caption, alt, draw(name, alt, (WIDTH, height), paint, _IN_A_PAGE))


def draw(
    name: str,
    alt: str,
    size: tuple[float, float],
    paint: Callable[[Figure], None],
    style: Mapping[Any, Any] | None = None,
) -> str:
    """Return a figure of a size [inch] as SVG, named uniquely in its page; ``paint`` draws on an empty figure."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    file = StringIO()
    with mpl.rc_context({**_STYLE, **(style or {}), "svg.hashsalt": name}), warnings.catch_warnings():
        # The reader's browser has glyphs that the font for measuring lacks.
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        figure = Figure(figsize=size, layout="constrained")
        paint(figure)
        figure.savefig(file, format="svg", metadata={"Date": None})
    return _embed(file.getvalue(), name, alt)


def shorten(text: str) -> str:
    """Return a name that fits under an axis."""
    return text if len(text) <= _WIDEST_NAME else text[: _WIDEST_NAME - 1] + "…"


def with_unit(name: str, unit: str) -> str:
    """Return the label of an axis: ``vd [m/s]``."""
    return f"{shorten(name)} [{spell_unit(unit)}]" if unit else shorten(name)


def panels(figure: Figure, count: int, columns: int) -> list[Axes]:
    """Return ``count`` axes with one scale upwards, in rows of at most ``columns``."""
    columns = min(columns, count)
    grid = figure.subplots(-(-count // columns), columns, squeeze=False, sharey=True)
    for axes in grid.flat[count:]:
        axes.set_visible(False)
    return list(grid.flat[:count])


def paint_map(
    axes: Axes, values: FloatArray, extent: tuple[float, float, float, float], scale: float, between: str
) -> AxesImage:
    """Draw (rows, columns) values in colours: white at 0, the deepest at ±``scale``; ``between`` interpolates them."""
    return axes.imshow(
        values, origin="lower", extent=extent, aspect="auto", cmap="RdBu", vmin=-scale, vmax=scale,
        interpolation=between,
    )  # fmt: skip


def add_scale(
    figure: Figure, image: AxesImage, beside: list[Axes], label: str, extend: str = "neither"
) -> None:
    """Draw the colours of a map and their values."""
    bar = figure.colorbar(image, ax=beside, extend=extend, pad=0.01)
    bar.set_label(label)
    if bar.solids is not None:
        bar.solids.set_rasterized(True)  # 256 little paths otherwise


def shade_violation(axes: Axes) -> None:
    """Shade ρ < 0 without changing the limits of the axes."""
    low, high = axes.get_ylim()
    if low < 0:
        axes.axhspan(low, min(0.0, high), color=BAD, alpha=0.08, lw=0)
    axes.axhline(0, color=BAD, lw=1.2)
    axes.set_ylim(low, high)


def hover(artist: Artist, words: str) -> None:
    """Give something drawn the words that a reader sees who points at it."""
    artist.set_gid(_HOVER + words)


def hover_points(axes: Axes, x: Iterable[float], y: Iterable[float], words: Iterable[str]) -> None:
    """Lay an unseen dot with words over each of some points."""
    for at, height, text in zip(x, y, words, strict=True):
        hover(axes.plot([at], [height], "o", ms=12, mew=0, color=INK, alpha=0, zorder=9)[0], text)


def hover_strips(axes: Axes, edges: Sequence[float], words: Iterable[str]) -> None:
    """Lay an unseen strip with words over each part of an axis, from one edge to the next."""
    for low, high, text in zip(edges[:-1], edges[1:], words, strict=True):
        hover(axes.axvspan(low, high, color=INK, alpha=0, lw=0, zorder=9), text)


def _embed(svg: str, name: str, alt: str) -> str:
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.S)
    svg = re.sub(r"<style[^>]*>.*?</style>", "", svg, flags=re.S)
    quoted = escape(alt).replace("\\", r"\\")
    attributes = f' xmlns:xlink="http://www.w3.org/1999/xlink" role="img" aria-label="{quoted}"'
    svg = re.sub(r'<svg[^>]*?(viewBox="[^"]*")[^>]*>', rf"<svg \1{attributes}>", svg, count=1, flags=re.S)
    svg = re.sub(rf'<g id="{_HOVER}([^"]*)">', r'<g class="hover"><title>\1</title>', svg)
    # Several figures share a page: their names must differ.
    svg = re.sub(r'\bid="', f'id="{name}-', svg)
    svg = re.sub(r'(url\(|xlink:href=")#', rf"\1#{name}-", svg)
    svg = re.sub(r"'DejaVu Sans'(, [^;\"]*)?", "system-ui, sans-serif", svg)
    return re.sub("|".join(_VARIABLES), lambda token: _VARIABLES[token[0]], svg)
