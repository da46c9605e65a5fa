"""What a plot needs, and what it says without it."""

from pathlib import Path

import numpy as np
import pytest

from s2r_spec.base import errors
from s2r_spec.errors import UsageError
from s2r_spec.spec import parse_spec
from s2r_spec.spec import plot as module
from s2r_spec.trace import Trace
from tests.errors import naming

SPEC = parse_spec("signal v {m/s}\nrequire slow: always[0 s, 1 s] (v <= 1 {m/s})\n")
TRACE = Trace(np.linspace(0.0, 1.0, 11), {"v": np.linspace(0.0, 0.5, 11)}, {"v": "m/s"})


def test_without_matplotlib_a_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setattr(errors, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=naming("matplotlib", "pip install", "[pictures]")):
        module.plot(SPEC.tolerances(TRACE, "slow"), SPEC.explain(TRACE, "slow"), "toy", Path("a.svg"))


def test_a_plot_is_written(tmp_path):
    pytest.importorskip("matplotlib")
    path = tmp_path / "a.png"
    module.plot(SPEC.tolerances(TRACE, "slow"), SPEC.explain(TRACE, "slow"), "toy", path)
    assert path.read_bytes().startswith(b"\x89PNG")


def test_a_plot_of_a_spec_is_shown_and_saved(tmp_path):
    pytest.importorskip("matplotlib")
    plot = SPEC.plot(TRACE, "slow")
    assert repr(plot) == "Plot(slow: ρ = +0.5 m/s)"
    assert plot._repr_svg_() == SPEC.plot(TRACE, "slow")._repr_svg_()
    assert "<script" not in plot._repr_svg_()
    assert plot.save(str(tmp_path / "a.svg")).read_text().count("<svg") == 1
    with pytest.raises(UsageError, match=naming("a.gif")):
        plot.save(tmp_path / "a.gif")


def test_a_spec_is_one_line():
    assert repr(SPEC) == "Spec('<string>': slow; signals v [m/s])"
