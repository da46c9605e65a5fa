"""What a page shows of a diagnosis beside its answer: breaking sizes, the robot, words to point at, names that wrap."""

import base64
import io
import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from s2r_spec.backend import Drawn
from s2r_spec.diagnose.gap.breaking import Breaking, BreakingSize, Crossing
from s2r_spec.diagnose.gap.where import WorstPair
from s2r_spec.diagnose.simulator.axes import EffectAxis
from s2r_spec.errors import UsageError
from s2r_spec.report import diagnosis_page
from s2r_spec.report.diagnosis import markdown, text
from s2r_spec.report.html import prose
from s2r_spec.trace import Trace
from tests.report.made import page_of
from tests.report.test_diagnosed import diagnosis
from tests.report.test_html import Page

FORCE = EffectAxis("friction", "force", "N", 0.0, 2.0, 0.0, 6.0)
MASS = EffectAxis("payload", "mass", "kg", 0.0, 1.0, -1.0, 3.0)
TEST = {"vd": 0.5}
SIZES = (
    BreakingSize(FORCE, 0.75, (0.0, 3.0), None, Crossing(FORCE, 1.0, 2.0, 1.25, TEST)),
    BreakingSize(MASS, 0.05, (-1.0, 3.0), Crossing(MASS, -0.5, -1.0, None, TEST), None),
)
TIMES = np.linspace(0.0, 2.0, 101)


@dataclass(frozen=True)
class Painter:
    """Draws a trace in the colour of its first sample, with a line that moves."""

    able: bool = True

    def draw_trace(self, trace, params, times, beside):
        if not self.able:
            raise UsageError("pictures need off-screen OpenGL")
        images = np.full((len(times), 28, 40, 3), trace["x"][0], dtype=np.uint8)
        images[np.arange(len(times)), :, np.arange(len(times)) % 40] = 120
        lacks = () if trace is beside else ("no log of the place: drawn as in the simulated robot",)
        return Drawn(images, lacks)


def filmed(painter, last=2.0):
    found, spec = diagnosis()
    kept = TIMES[last >= TIMES]
    real, simulated = (
        Trace(t, {"x": np.full(t.size, x)}, {"x": "m"}) for t, x in ((kept, 10.0), (TIMES, 200.0))
    )
    return replace(found, where=replace(found.where, traces=WorstPair(painter, TEST, real, simulated))), spec


def broken(rho=0.2):
    found, spec = diagnosis()
    return replace(found, breaking=Breaking(rho, "m", TEST, SIZES)), spec


def test_every_form_has_the_column_of_breaking_sizes():
    found, spec = broken()
    said = "above 2.5 N (2 to 4 N)"
    rows = {
        line.split(" | ")[0].strip("| "): line for line in markdown(found, spec).splitlines() if "|" in line
    }
    assert rows["parameter"].endswith("| breaks |")
    assert said in rows["friction.force"]
    assert "below a size from -1 to -0.5 kg" in rows["payload.mass"]
    assert rows["delay.time"].endswith("|  |")
    (line,) = (line for line in text(found, spec).splitlines() if "friction.force   " in line)
    assert line.endswith(said)
    page = page_of(diagnosis_page.render, found, spec)
    assert said in page.text
    assert "Each row is one parameter" in page.text
    assert "breaks" not in markdown(*diagnosis())


def test_a_machine_that_fails_has_the_column_of_what_restores_the_requirement():
    found, spec = broken(-0.2)
    assert "| holds again |" in markdown(found, spec)
    assert "restores the requirement" in page_of(diagnosis_page.render, found, spec).text


def images(page):
    return [
        base64.b64decode(data) for data in re.findall(r'src(?:set)?="data:image/webp;base64,([^"]+)"', page)
    ]


def test_the_real_robot_stands_beside_the_simulated_one():
    pil = pytest.importorskip("PIL.Image")
    page = diagnosis_page.render(*filmed(Painter()))
    still, video, *tiles = [pil.open(io.BytesIO(data)) for data in images(page)]
    assert video.n_frames == pytest.approx(25, abs=1)
    assert still.size == video.size
    colour = np.asarray(video.convert("RGB")).mean(axis=2)
    half = colour.shape[1] // 2
    assert colour[:, :half].mean() < 60 < 180 < colour[:, half:].mean()
    assert len(tiles) == 8
    words = Page(page).text
    assert "No log of the place: drawn as in the simulated robot." in words
    assert "ended after" not in words
    assert len(page) < 1_000_000


def test_a_rollout_that_ended_early_keeps_its_last_pose_and_the_page_says_so():
    pytest.importorskip("PIL.Image")
    page = Page(diagnosis_page.render(*filmed(Painter(), last=1.0)))
    assert "The real rollout ended after 1 s, and keeps its last pose." in page.text


def test_without_opengl_the_page_says_why_there_is_no_robot():
    found, spec = filmed(Painter(able=False))
    page = diagnosis_page.render(found, spec)
    assert "Pictures need off-screen OpenGL." in Page(page).text
    assert images(page) == []
    assert images(diagnosis_page.render(*diagnosis())) == []


def test_a_reader_who_points_at_a_plot_sees_its_numbers():
    found, spec = broken()
    page = diagnosis_page.render(found, spec)
    titles = re.findall(r'<g class="hover"><title>([^<]*)</title>', page)
    assert "friction.force: now 1.5 N, breaks above 2.5 N (2 to 4 N)" in titles
    assert any(re.fullmatch(r"t = [\d.]+ s: real -?[\d.]+, simulated -?[\d.]+; x.*", one) for one in titles)
    assert any("of Δρ" in one for one in titles)
    for figure in re.findall(r"<figure>.*?</figure>", page, re.S):
        assert "<title>" in figure


@pytest.mark.parametrize(
    ("words", "html"),
    [
        ("payload.mass", "payload.<wbr>mass"),
        ("at 0.25 m, vd = 1.", "at 0.25 m, vd = 1."),
        ("the predicate is `x <= 1`", "the predicate is <code>x &lt;= 1</code>"),
        ("a single ` is none", "a single  is none"),
        ("20 % of |Δρ|", '20\u00a0% of <span class="whole">|Δρ|</span>'),
        ("0123456789abcdef", "01234567<wbr>89abcdef"),
        ("<b> & more", "&lt;b&gt; &amp; more"),
    ],
)
def test_prose_wraps_names_at_dots_and_has_no_backticks(words, html):
    assert str(prose(words)) == html


def test_a_cell_of_a_stacked_table_says_what_it_is():
    page = diagnosis_page.render(*broken())
    for row in re.findall(r"<tr>(.*?)</tr>", page, re.S):
        assert row.count("<td") == row.count('<td data-head="')
