"""Draw the pictures of README, index and tutorials: ``python docs/pictures.py [NAME ...]``, minutes for all.

Each tutorial's picture comes from the page's own commands and files, and the diagnosis from a committed run. The
pictures lie in ``docs/pictures``. An SVG has no date in it, so the same numbers give the same file.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

import numpy as np  # noqa: E402

import s2r_spec as s2r  # noqa: E402
from s2r_spec.errors import StoppedError  # noqa: E402
from s2r_spec.report.figures import canvas  # noqa: E402
from s2r_spec.report.figures.canvas import BAD, BAND, GOOD, INK, MUTED  # noqa: E402
from s2r_spec.report.figures.tolerance import Component  # noqa: E402
from s2r_spec.report.figures.traces import Panel, limits, paint_panel  # noqa: E402
from s2r_spec.runs.journal import Journal  # noqa: E402
from s2r_spec.runs.layout import runs_in  # noqa: E402

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from s2r_spec.trace import Trace

FOLDER = ROOT / "docs" / "pictures"
RESULTS = ROOT / "benchmarks" / "results"
TROT = ROOT / "specs" / "a1_velocity.stl"
SMALL, WIDE = (4.2, 3.4), (7.2, 2.7)
"""Sizes [inch]: one of three in a row, and one alone."""


def drawing(
    name: str, alt: str, size: tuple[float, float], paint: Callable[[Figure], None]
) -> str:
    """Return a figure as a file of its own; see :func:`standalone`."""
    return standalone(canvas.draw(name, alt, size, paint))


def standalone(svg: str) -> str:
    """Return an SVG of a report as a file: with the colours of a light page, on white."""
    css = (ROOT / "s2r_spec" / "report" / "style.css").read_text(encoding="utf-8")
    colours = dict(re.findall(r"(--\w+): (#\w+)", css.partition("@media")[0]))
    (width, height), *_ = re.findall(r'viewBox="0 0 (\S+) (\S+)"', svg)
    svg = re.sub(r"var\((--\w+)\)", lambda found: colours[found[1]], svg)
    svg = re.sub(r"(\d\.\d)\d{3,}", r"\1", svg)  # a tenth of a point is enough
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}pt" height="{height}pt" '
    svg = svg.replace("<svg ", head, 1)
    return svg.replace(">", '>\n<rect width="100%" height="100%" fill="#ffffff"/>', 1)


# -- three questions: README and index ------------------------------------------------------------


def _kept(name: str) -> Any:
    """Return what a benchmark kept."""
    return json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))


def _named() -> tuple[str, str]:
    """Return the diagnosed machine, and the simulator with the effects that a committed run names there."""
    kept = _kept("twins_diagnose")["twins"]["ramp"]
    values = [
        f"{effect}.{name}={found['estimate']}"
        for effect in kept["set"]
        for name, found in kept["parameters"][effect].items()
    ]
    return "twin:ramp", "sim:" + ",".join(values)


def trot() -> str:
    """Draw one trot of the simulator and of the machine, with the speeds that the requirement forbids."""
    spec, test = s2r.load_spec(TROT), {"vd": -0.2}
    machine, simulated = (
        s2r.load_backend(name).rollout(test, 0) for name in ("twin:ramp", "sim")
    )
    panel = _panel(spec, machine, test, "vx", beside=(simulated,))

    def paint(figure: Figure) -> None:
        axes = figure.add_subplot()
        paint_panel(axes, panel, None)
        _two_lines(axes, "twin:ramp", "simulator")
        axes.set_xlabel("time [s]")
        axes.set_ylabel("vx [m/s], command −0.2")

    return drawing(
        "trot", "A trot's speed over time, in simulator and twin", SMALL, paint
    )


def worst() -> str:
    """Draw the certified interval of the worst expected ρ, and the means of separate rollouts."""
    kept = _kept("dense_reference")
    lower, upper = (kept["certificate"][end] for end in ("lower", "upper"))
    at = [row["vd"] for row in kept["reference"]]

    def paint(figure: Figure) -> None:
        axes = figure.add_subplot()
        label = "certified: the worst mean is here"
        axes.axhspan(lower, upper, color=BAND, alpha=0.22, lw=0, label=label)
        means, lowest = (
            [row[key] for row in kept["reference"]] for key in ("mean", "lowest")
        )
        axes.vlines(at, lowest, means, color=MUTED, lw=1)
        axes.plot(at, means, "o", color=INK, ms=4, label="means of separate rollouts")
        axes.axhline(0, color=BAD, lw=1.2)
        axes.set_ylim(-0.004, 0.046)
        axes.set_xlabel("vd [m/s]")
        axes.set_ylabel("ρ in simulation [m/s]")
        figure.legend(loc="outside upper left")

    return drawing(
        "worst", "ρ over the test space, and the certified worst mean", SMALL, paint
    )


def gap() -> str:
    """Draw the gap at tests over the space, before and after the named effects are added; fresh rollouts."""
    spec, space = s2r.load_spec(TROT), np.linspace(-0.2, 0.3, 11)
    machine, better = _named()

    def mean(name: str, vd: float, first: int) -> float:
        backend, test = s2r.load_backend(name), {"vd": float(vd)}
        traces = [backend.rollout(test, seed) for seed in (first, first + 1)]
        rho = [spec.robustness(one, params=test)["walking"] for one in traces]
        return float(np.mean(rho))

    real = np.array([mean(machine, vd, 100) for vd in space])
    before, after = (
        real - [mean(name, vd, 200) for vd in space] for name in ("sim", better)
    )

    def paint(figure: Figure) -> None:
        axes = figure.add_subplot()
        axes.vlines(space, before, after, color=MUTED, lw=0.8)
        axes.plot(
            space, before, "o", mfc="none", mec=BAD, mew=1.6, ms=7, label="before"
        )
        label = "after the named effects are added"
        axes.plot(space, after, "o", color=GOOD, ms=6, label=label)
        axes.axhline(0, color=INK, lw=0.8)
        axes.set_xlabel("vd [m/s]")
        axes.set_ylabel("Δρ, twin:ramp − simulator [m/s]")
        figure.legend(loc="outside upper left")

    return drawing("gap", "The gap over the test space, before and after", SMALL, paint)


# -- the tutorials --------------------------------------------------------------------------------


def ten_seconds() -> str:
    """Draw both recorded runs of the page, with the speeds that the requirement forbids."""
    spec = s2r.load_spec(TROT)
    fails, holds = (
        s2r.read_trace(ROOT / "specs" / "traces" / f"a1_velocity_{name}.csv")
        for name in ("fails", "holds")
    )
    return _recording(
        "ten-seconds",
        spec,
        fails,
        {"vd": 0.3},
        "vx",
        ("the run that fails", "the run that holds", holds),
    )


def first_spec() -> str:
    """Draw the recording of the page, with the forces that the requirement forbids."""
    with _page("first-spec") as folder:
        spec = s2r.load_spec(folder / "grip.stl")
        trace = s2r.read_trace(folder / "grip.csv")
    return _recording("first-spec", spec, trace, {"goal": 12.0}, "force", None)


def certify_a1() -> str:
    """Draw the band after the sixteen rollouts of the page."""
    with _page("certify-a1") as folder:
        return _reported(
            folder, "check specs/a1_velocity.stl --backend sim --budget 16"
        )


def own_backend() -> str:
    """Draw the band of the page's lift."""
    with _page("own-backend") as folder:
        return _reported(
            folder, "certify lift.stl --sim lift.py:Lift --real lift.py:Lift:worn"
        )


def gap_and_cause() -> str:
    """Draw the gap over the test space that the page measures first."""
    with _page("gap-and-cause") as folder:
        words = "gap drive.stl --sim turtlebot --real turtlebot:heading_bias.angle=-0.2 --budget 60"
        return _reported(folder, words)


def first_contact() -> str:
    """Draw the walk of the page, through the robot's wire, beside the simulator's."""
    spec = s2r.load_spec(TROT)
    with tempfile.TemporaryDirectory() as folder, _twin(folder) as port:
        name = f"a1:host=127.0.0.1,port={port},velocity=onboard,clock=lockstep"
        with suppress(StoppedError):
            s2r.check(spec, name, f"{folder}/first", budget=8, operator=_Consents())
        (run,) = runs_in(Path(folder, "first"))
        record = Journal.read(run).records()[0]
        walked = s2r.read_trace(run / record.trace)
    simulated = s2r.load_backend("sim").rollout(record.params, 0)
    return _recording(
        "first-contact",
        spec,
        walked,
        record.params,
        "vx",
        ("the twin", "the simulator", simulated),
    )


PICTURES: Mapping[str, Callable[[], str]] = {
    "trot": trot,
    "worst": worst,
    "gap": gap,
    "ten-seconds": ten_seconds,
    "first-spec": first_spec,
    "certify-a1": certify_a1,
    "own-backend": own_backend,
    "gap-and-cause": gap_and_cause,
    "first-contact": first_contact,
}


# -- parts ----------------------------------------------------------------------------------------


def _panel(
    spec: s2r.Spec,
    trace: Trace,
    test: Mapping[str, float],
    channel: str,
    beside: Sequence[Trace],
) -> Panel:
    (requirement,) = spec.formulas
    component = Component(channel)
    others = tuple((one.times, one[channel]) for one in beside)
    allowed = limits(spec, requirement, trace, test, component)
    label = canvas.with_unit(channel, spec.signals[channel].unit)
    return Panel(label, trace.times, trace[channel], (), others, allowed)


def _two_lines(axes: Axes, solid: str, dashed: str) -> None:
    axes.plot([], [], color=INK, lw=1.6, label=solid)
    axes.plot([], [], color=BAND, lw=1.6, ls=(0, (5, 2)), label=dashed)
    axes.figure.legend(loc="outside upper left", ncols=2)


def _recording(
    name: str,
    spec: s2r.Spec,
    trace: Trace,
    test: Mapping[str, float],
    channel: str,
    beside: tuple[str, str, Trace] | None,
) -> str:
    """Draw a trace over the values that the requirement forbids; ``beside`` names it and a second one."""
    (requirement,) = spec.formulas
    panel = _panel(spec, trace, test, channel, beside[2:] if beside else ())

    def paint(figure: Figure) -> None:
        axes = figure.add_subplot()
        paint_panel(axes, panel, spec.explain(trace, requirement, test))
        axes.set_xlabel("time [s]")
        if beside:
            _two_lines(axes, *beside[:2])

    return drawing(
        name, f"{channel} over time; red is what the requirement forbids", WIDE, paint
    )


@contextmanager
def _page(name: str) -> Iterator[Path]:
    """Write the files of a tutorial into an empty folder."""
    page = (ROOT / "docs" / "tutorials" / f"{name}.md").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        for file, text in re.findall(
            r"<!-- file: (\S+) -->\n```\w*\n(.*?)```", page, re.S
        ):
            Path(folder, file).write_text(text, encoding="utf-8")
        Path(folder, "specs").symlink_to(ROOT / "specs")
        yield Path(folder)


def _reported(folder: Path, command: str) -> str:
    """Run a command of a page, and return the first picture of its report."""
    _s2r(folder, *command.split(), "--run", "run", "--quiet")
    _s2r(folder, "report", "run")
    page = (folder / "run" / "report.html").read_text(encoding="utf-8")
    return standalone(re.findall(r"<svg .*?</svg>", page, re.S)[0])


def _s2r(folder: Path, *words: str) -> None:
    """Run s2r in a folder, whose backend it finds."""
    paths = [str(folder), str(ROOT), str(ROOT / "backends")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run(
        [sys.executable, "-m", "s2r_spec", *words],
        cwd=folder,
        env=environment,
        check=False,
    )
    assert done.returncode in (0, 1, 3), done.returncode


class _Consents:
    """An operator who gives both consents to a twin, lets it walk once, and ends the run."""

    walked = False

    def say(self, text: str) -> None:
        print(text)

    def type_word(self, question: str, word: str) -> None:
        print(question, word)

    def line(self, question: str) -> str:
        raise StoppedError(question)

    def choose(self, question: str, answers: Mapping[str, str]) -> str:
        print(question)
        if self.walked:
            raise StoppedError("one walk is enough")
        self.walked = True
        return "3"


@contextmanager
def _twin(folder: str) -> Iterator[int]:
    """Start the page's twin on a free port; its guard ends with it."""
    os.environ["S2R_A1_RUN"] = folder
    words = [
        "-m",
        "s2r_a1.twin",
        "--place",
        "nominal",
        "--clock",
        "lockstep",
        "--port",
        "0",
    ]
    paths = os.pathsep.join((str(ROOT), str(ROOT / "backends")))
    environment = os.environ | {"PYTHONPATH": paths}
    process = subprocess.Popen(
        [sys.executable, *words], stdout=subprocess.PIPE, text=True, env=environment
    )
    assert process.stdout is not None
    try:
        yield int(
            process.stdout.readline().partition("127.0.0.1:")[2].partition(",")[0]
        )
    finally:
        for word in ("damp", "stop"):
            subprocess.run(
                [sys.executable, "-m", "s2r_a1.guard", word],
                env=environment,
                check=False,
            )
        process.terminate()
        process.wait()


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name in sys.argv[1:] or PICTURES:
        (FOLDER / f"{name}.svg").write_text(PICTURES[name](), encoding="utf-8")
        print(f"docs/pictures/{name}.svg")
