import json

import numpy as np
import pytest

from s2r_spec.logs import write
from s2r_spec.trace import Trace
from tests.cli.conftest import SPEC

TIMES = np.arange(16) / 10


def walk(s2r, name: str, *vx: float, column: str = "vx", **meta: str) -> str:
    values = np.full(16, 0.3)
    values[: len(vx)] = vx
    write(Trace(TIMES, {column: values}, {column: "m/s"}, meta), s2r.folder / name)
    return name


@pytest.fixture
def spec(s2r) -> str:
    return s2r.spec(0.1)


def test_what_holds_and_why(s2r, spec):
    done = s2r("monitor", spec, walk(s2r, "good.csv"), "--param", "vd=0.25", code=0)
    assert done.stdout == (
        "good.csv\n"
        "walking holds: ρ = +0.05 m/s\n"
        "  decided at t = 0.5 s by `abs(vx - vd) <= 0.1 {m/s}` (line 3): margin +0.05 m/s\n"
        "  there vx = 0.3 m/s, vd = 0.25 m/s\n"
        "  it has to hold at 0.5 s to 1.5 s\n"
    )


def test_several_files_and_the_worst_of_them_is_the_exit_code(s2r, spec):
    bad = walk(s2r, "bad.npz", *[0.3] * 7, 0.7)
    result = s2r.json("monitor", spec, walk(s2r, "good.csv"), bad, "-p", "vd=30 cm/s", code=1)
    assert result["params"] == {"vd": 0.3}
    (good,), (violated,) = (one["requirements"] for one in result["results"])
    assert (good["verdict"], violated["verdict"]) == ("holds", "violated")
    assert violated["rho"] == pytest.approx(-0.3)
    assert violated["instant"] == 0.7
    assert violated["responsible"] == [[0.7, 0.7]]
    assert violated["signals"][0] == {"name": "vx", "value": 0.7, "unit": "m/s"}


def test_a_trace_that_is_too_short_is_unknown(s2r, spec):
    write(Trace(TIMES[:9], {"vx": np.full(9, 0.3)}), s2r.folder / "short.csv")
    done = s2r("monitor", spec, "short.csv", "-p", "vd=0.3", code=3)
    assert "walking unknown: it looks 1.5 s ahead, but the trace lasts 0.8 s" in done.stdout
    s2r("monitor", spec, "short.csv", "-p", "vd=0.3", "--partial", code=0)


def test_columns_are_named(s2r, spec):
    renamed = walk(s2r, "ros.csv", column="velocity.x")
    s2r("monitor", spec, renamed, "-p", "vd=0.3", "--map", "vx=velocity.x", code=0)
    wrong = s2r("monitor", spec, renamed, "-p", "vd=0.3", "--map", "vx=velocity.y", code=2)
    assert "the trace has no channel 'velocity.y'; did you mean 'velocity.x'" in wrong.stderr
    assert "--map is written name=column" in s2r("monitor", spec, renamed, "--map", "vx", code=2).stderr


def test_a_fall_is_what_the_spec_says_it_is(s2r, spec):
    done = s2r("monitor", spec, walk(s2r, "fall.csv", failure="fall"), "-p", "vd=0.3", code=1)
    assert "because the trace ended with 'fall'" in done.stdout


@pytest.mark.parametrize(
    ("param", "message"),
    [
        ("vd", "'vd' does not give a parameter; write for example vd=0.3 or 'vd=30 cm/s'"),
        ("vq=1", "the spec has no parameter 'vq'; it has vd"),
        ("vd=1 kg", "'vd=1 kg': 'vd' is in m/s, to which kg does not convert"),
        ("vd=1 foo", "'vd=1 foo': 'foo' is not a unit"),
    ],
)
def test_parameters_that_do_not_fit(s2r, spec, param, message):
    done = s2r("monitor", spec, walk(s2r, "good.csv"), "--param", param, "--json", code=2)
    assert message in done.stderr
    assert json.loads(done.stdout)["schema"] == "s2r.error/1"


def test_fmt_rewrites_and_check_only_looks(s2r):
    name = s2r.spec(text=SPEC.replace("always[", "G_["))
    assert "would change spec.stl" in s2r("fmt", name, "--check", code=1).stderr
    assert s2r.json("fmt", name, code=0)["changed"] == [name]
    assert "always[0.5 s, 1.5 s]" in (s2r.folder / name).read_text()
    assert s2r("fmt", name, "--check", code=0).stderr == ""
    assert r"\square_{[0.5\,\mathrm{s}, 1.5\,\mathrm{s}]}" in s2r("fmt", name, "--to", "latex", code=0).stdout
    (s2r.folder / "broken.stl").write_text("require")
    assert "error[E01]" in s2r("fmt", "broken.stl", code=2).stderr


def test_lint_points_and_fixes(s2r):
    name = s2r.spec(text="signal x\nsignal y\nrequire a: always x > 0 and x == 1\n")
    found = s2r.json("lint", name, code=1)["findings"]
    assert [(one["code"], one["line"], one["column"]) for one in found] == [
        ("L06", 2, 8), ("L01", 3, 12), ("L04", 3, 31),
    ]  # fmt: skip
    assert "warning[L06]: `y` is not used" in s2r("lint", name, "--fix", code=1).stdout
    assert "require a: (always x > 0) and x == 1" in (s2r.folder / name).read_text()
    s2r("lint", s2r.spec(), code=0)
