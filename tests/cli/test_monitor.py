import json
import subprocess

import numpy as np
import pytest

from s2r_spec.logs import write
from s2r_spec.trace import Trace
from tests import forked
from tests.cli.conftest import SPEC
from tests.errors import states

TIMES = np.arange(16) / 10


def walk(s2r, name: str, *vx: float, column: str = "vx", **meta: object) -> str:
    values = np.full(16, 0.3)
    values[: len(vx)] = vx
    write(Trace(TIMES, {column: values}, {column: "m/s"}, meta), s2r.folder / name)
    return name


@pytest.fixture
def spec(s2r) -> str:
    return s2r.spec(0.1)


def test_what_holds_and_why(s2r, spec):
    done = s2r("monitor", spec, walk(s2r, "good.csv"), "--param", "vd=0.25", code=0)
    name, verdict, decided, there = done.stdout.splitlines()[:4]
    assert (name, verdict) == ("good.csv", "walking holds: ρ = +0.05 m/s")
    assert states(decided, "t = 0.5 s", "`abs(vx - vd) <= 0.1 {m/s}`", "line 3", "+0.05 m/s")
    assert states(there, "vx = 0.3 m/s", "vd = 0.25 m/s")
    assert states(done.stdout, "0.5 s", "1.5 s", "0.1 s", "11 samples")


RULES = """
signal mode
signal b {m}
require equal: always (mode == 2 -> b >= 0 {m})
require strict: always (b > -3 {m})
require never: always not (b <= -3 {m})
require idle: eventually (mode != 2)
"""


def test_the_comparisons_decide_at_zero(s2r):
    (s2r.folder / "rules.stl").write_text(RULES)
    broken = {"equal": False, "strict": False, "never": False, "idle": True}
    for ending in ("csv", "npz", "parquet"):
        name = f"mode.{ending}"
        write(Trace([0, 1, 2], {"mode": [2, 2, 1], "b": [0.5, -1, -3]}), s2r.folder / name)
        (result,) = s2r.json("monitor", "rules.stl", name, code=1)["results"]
        assert {one["requirement"]: one["satisfied"] for one in result["requirements"]} == broken
        assert [one["rho"] for one in result["requirements"]] == [0, 0, 0, 1]
        last = follow(s2r, name, "--json", spec="rules.stl").stdout.splitlines()[-1]
        assert {one["requirement"]: one["satisfied"] for one in json.loads(last)["requirements"]} == broken
    s2r("monitor", "rules.stl", name, "-r", "idle", code=0)


def test_what_must_not_hold_is_said_so(s2r):
    (s2r.folder / "not.stl").write_text("signal f {N}\nrequire n: always not (f >= 80 {N})\n")
    write(Trace([0, 1, 2], {"f": [10, 95, 20]}), s2r.folder / "bad.csv")
    text = s2r("monitor", "not.stl", "bad.csv", code=1).stdout
    assert states(text, "must not hold", "-15 N", "1 s")
    write(Trace([0, 1, 2], {"f": [10, 40, 20]}), s2r.folder / "good.csv")
    text = s2r("monitor", "not.stl", "good.csv", code=0).stdout
    assert states(text, "must not hold", "+40 N", "0 s", "2 s")


def test_one_sample_is_no_trace_of_a_window(s2r, spec):
    write(Trace([0.0], {"vx": [0.3]}), s2r.folder / "one.csv")
    for profile in ("s2r", "breach", "rtamt", "moonlight"):
        s2r("monitor", spec, "one.csv", "-p", "vd=0.3", "--profile", profile, code=3)
    assert follow(s2r, "one.csv", "-p", "vd=0.3").returncode == 3


def test_a_window_that_is_shorter_than_the_period_is_refused(s2r):
    (s2r.folder / "slow.stl").write_text("signal vx {m/s}\nrequire slow: always[0, 1.5 s] vx <= 1\n")
    write(Trace(TIMES * 1000, {"vx": np.full(16, 0.3)}), s2r.folder / "ms.npz")
    for words in (["--online"], []):
        refused = s2r("monitor", "slow.stl", "ms.npz", *words, code=2).stderr
        assert "ms.npz" in refused
        assert "--time-unit ms" in refused
        s2r("monitor", "slow.stl", "ms.npz", "--time-unit", "ms", *words, code=0)
        s2r("monitor", "slow.stl", "ms.npz", "--time-unit", "s", *words, code=0)


def test_a_bounded_answer_at_the_end_is_named(s2r):
    (s2r.folder / "end.stl").write_text(
        "signal a\nsignal b\nrequire g: always (a >= 3 -> eventually[0, 5 s] b >= 3)\n"
    )
    write(Trace(np.arange(5.0), {"a": [0, 0, 0, 4, 0], "b": [0, 0, 1, 0, 0]}), s2r.folder / "end.csv")
    text = s2r("monitor", "end.stl", "end.csv", code=3).stdout
    assert states(text, "g unknown", "5 s", "t = 3 s", "4 s")
    assert "inf s" not in text + follow(s2r, "end.csv", spec="end.stl").stdout.replace("+inf]", "")


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
    assert states(done.stdout, "walking unknown", "1.5 s", "0.8 s")
    s2r("monitor", spec, "short.csv", "-p", "vd=0.3", "--partial", code=0)


def test_columns_are_named(s2r, spec):
    renamed = walk(s2r, "ros.csv", column="velocity.x")
    s2r("monitor", spec, renamed, "-p", "vd=0.3", "--map", "vx=velocity.x", code=0)
    wrong = s2r("monitor", spec, renamed, "-p", "vd=0.3", "--map", "vx=velocity.y", code=2)
    assert states(wrong.stderr, "'velocity.y'", "did you mean 'velocity.x'")
    assert states(s2r("monitor", spec, renamed, "--map", "vx", code=2).stderr, "--map", "name=column")


def test_a_fall_is_what_the_spec_says_it_is(s2r, spec):
    done = s2r("monitor", spec, walk(s2r, "fall.csv", failure="fall"), "-p", "vd=0.3", code=1)
    assert states(done.stdout, "walking violated", "-0.5 m/s", "'fall'")


def test_as_another_tool_reads_it(s2r):
    (s2r.folder / "spec.stl").write_text(
        "signal vx\nsignal y\n"
        "require crossed: always (vx > 1 or y > 1)\nrequire ahead: always[0.5, 3] vx > 0\n"
    )
    write(Trace([0, 1, 2], {"vx": [3, 0.5, 1], "y": [0.5, 3, 3]}), s2r.folder / "it.csv")
    it = ("monitor", "spec.stl", "it.csv", "--profile")
    lines = s2r(*it, "breach", code=0).stdout.splitlines()
    assert {"crossed holds: ρ = +0.75", "ahead holds: ρ = +0.5"} <= set(lines)
    assert sum("breach" in line for line in lines) == 2
    assert "ahead unknown" in s2r(*it, "moonlight", code=3).stdout
    found = s2r.json(*it, "stlcgpp", "-r", "crossed", code=0)
    assert (found["profile"], found["results"][0]["requirements"][0]["rho"]) == ("stlcgpp", 2)
    assert states(s2r(*it, "matlab", code=2).stderr, "'matlab'", "breach", "moonlight")
    assert "--profile" in s2r(*it, "breach", "--online", code=2).stderr


@pytest.mark.parametrize(
    ("param", "facts"),
    [
        ("vd", ["'vd'", "vd=0.3"]),
        ("vq=1", ["'vq'", "vd"]),
        ("vd=1 kg", ["'vd'", "m/s", "kg"]),
        ("vd=1 foo", ["'vd=1 foo'", "'foo'"]),
    ],
)
def test_parameters_that_do_not_fit(s2r, spec, param, facts):
    done = s2r("monitor", spec, walk(s2r, "good.csv"), "--param", param, "--json", code=2)
    assert states(done.stderr, *facts)
    assert json.loads(done.stdout)["schema"] == "s2r.error/1"


def test_fmt_rewrites_and_check_only_looks(s2r):
    name = s2r.spec(text=SPEC.replace("always[", "G_["))
    assert "spec.stl" in s2r("fmt", name, "--check", code=1).stderr
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
    assert states(s2r("lint", name, "--fix", code=1).stdout, "L06", "`y`")
    assert "require a: (always x > 0) and x == 1" in (s2r.folder / name).read_text()
    s2r("lint", s2r.spec(), code=0)
    (s2r.folder / "turns.stl").write_text("signal n {rpm}\nrequire r: n >= 50 {Hz}\n")
    found = s2r.json("lint", name, "turns.stl", code=1)["findings"]
    assert {(one["file"], one["code"]) for one in found} == {("turns.stl", "E03")}


ROWS = "t,vx [m/s]\n0,0.3\n0.5,0.28\n1,0.15\n1.5,0.3\n"
SAID = (
    "t = 0 s  walking unknown: ρ in [-inf, +0.1] m/s\n"
    "t = 0.5 s  walking unknown: ρ in [-inf, +0.08] m/s\n"
    "t = 1 s  walking violated: ρ in [-inf, -0.05] m/s\n"
    "t = 1.5 s  walking violated: ρ = -0.05 m/s\n"
    "walking violated: ρ = -0.05 m/s\n"
)


def follow(s2r, *words: str, rows: str = ROWS, spec: str = "spec.stl") -> subprocess.CompletedProcess[str]:
    return forked.run(["monitor", "--online", spec, *words], s2r.folder, rows)


def test_online_says_when_something_changes(s2r, spec):
    (s2r.folder / "walk.csv").write_text(ROWS)
    assert s2r("monitor", "--online", spec, "walk.csv", "-p", "vd=0.3", code=1).stdout == SAID
    command = s2r.command("monitor", "--online", spec, "-", "-p", "vd=0.3")
    done = subprocess.run(command, cwd=s2r.folder, input=ROWS, capture_output=True, text=True, timeout=120)
    assert (done.stdout, done.returncode) == (SAID, 1)  # through a pipe, as a robot's driver would


def test_online_as_json_lines(s2r, spec):
    rows = (
        ROWS.replace("vx [m/s]", "v [cm/s]").replace("0.3", "30").replace("0.28", "28").replace("0.15", "30")
    )
    done = follow(s2r, "-", "-p", "vd=0.3", "--map", "vx=v", "--json", "--period", "0.5", rows=rows)
    *changes, last = map(json.loads, done.stdout.splitlines())
    assert [(one["time"], one["verdict"]) for one in changes] == [
        (0, "unknown"), (0.5, "unknown"), (1.5, "holds"),
    ]  # fmt: skip
    assert (changes[1]["lower"], changes[1]["upper"]) == ("-inf", pytest.approx(0.08))
    assert (last["exit_code"], done.returncode) == (0, 0)
    assert last["requirements"][0]["verdict"] == "holds"
    assert last["requirements"][0]["lower"] == last["requirements"][0]["upper"] == pytest.approx(0.08)


def test_online_of_a_trace_that_ends_too_early(s2r, spec):
    short = "".join(ROWS.splitlines(keepends=True)[:3])
    done = follow(s2r, "-", "-p", "vd=0.3", rows=short)
    assert done.returncode == 3
    assert states(done.stdout, "walking unknown", "[-inf, +0.08] m/s")
    assert follow(s2r, "-", "-p", "vd=0.3", "--partial", rows=short).returncode == 0


@pytest.mark.parametrize(
    ("words", "rows", "facts"),
    [
        (["-"], "t,vx\n0,fast\n", ["line 2", "column 2 (vx)", "'fast'"]),
        (["-"], "", ["empty"]),
        (["-"], "t,vx\n", ["no sample"]),
        (["-"], "t,vx\n0,1\n0,1\n", ["sample 1", "0 s"]),
        (["-"], "t,v\n0,1\n", ["'vx'", "v"]),
        (["-"], "t,vx [kg]\n0,1\n", ["'vx'", "kg", "m/s"]),
        (["-", "-"], "", ["--online", "one"]),
    ],
)
def test_online_refuses_in_one_sentence(s2r, spec, words, rows, facts):
    done = follow(s2r, *words, "-p", "vd=0.3", rows=rows)
    assert done.returncode == 2
    assert states(done.stderr, *facts)
    assert len(done.stderr.splitlines()) == 1


def test_online_of_a_fall_is_what_the_spec_says(s2r, spec):
    done = follow(s2r, "-", "-p", "vd=0.3", rows='# s2r {"meta": {"failure": "fall"}}\nt,vx\n0,0.3\n')
    assert (done.stdout.splitlines()[-1], done.returncode) == ("walking violated: ρ = -0.5 m/s", 1)
    assert "are for --online" in s2r("monitor", spec, "x.csv", "--period", "1", code=2).stderr


def test_each_broken_file_has_its_sentence_and_the_others_their_answers(s2r, spec):
    good, bad = walk(s2r, "good.csv"), walk(s2r, "bad.csv", *[0.3] * 7, 0.7)
    (s2r.folder / "none.csv").write_text("t,vx\n0,fast\n1,slow\n")
    (s2r.folder / "gap.csv").write_text("t,vx\n0,0.3\n1,\n2,0.3\n")
    files = (good, "none.csv", bad, "missing.npz", "gap.csv")
    done = s2r("monitor", spec, *files, "-p", "vd=0.3", "--json", code=2)
    for name, words in {"none.csv": "'fast'", "missing.npz": "No such file", "gap.csv": "--nan hold"}.items():
        assert any(name in line and words in line for line in done.stderr.splitlines())
    results = {one["trace"]: one for one in json.loads(done.stdout)["results"]}
    assert [name for name, one in results.items() if "error" in one] == ["none.csv", "missing.npz", "gap.csv"]
    assert results[good]["requirements"][0]["verdict"] == "holds"
    assert results[bad]["requirements"][0]["verdict"] == "violated"
    done = s2r("monitor", spec, good, "none.csv", "-p", "vd=0.3", code=2)
    assert "walking holds" in done.stdout


def test_a_missing_sample_can_be_held(s2r, spec):
    (s2r.folder / "gap.csv").write_text("t,vx\n0,0.3\n0.5,\n1,0.28\n1.5,nan\n")
    assert "gap.csv" in s2r("monitor", spec, "gap.csv", "-p", "vd=0.3", code=2).stderr
    held = s2r.json("monitor", spec, "gap.csv", "-p", "vd=0.3", "--nan", "hold", code=0)
    assert held["results"][0]["requirements"][0]["rho"] == pytest.approx(0.08)
    s2r("monitor", spec, "gap.csv", "-p", "vd=0.3", "--nan", "hold", "--online", code=0)
    assert states(s2r("monitor", spec, "gap.csv", "--nan", "skip", code=2).stderr, "--nan", "error", "hold")


def test_times_in_another_unit_and_a_row_that_is_cut(s2r, spec):
    (s2r.folder / "ns.csv").write_text(
        "%time,mode,vx\n" + "".join(f"{1718 * 10**15 + k * 10**8},walk,0.3\n" for k in range(17)) + "171800"
    )
    asked = ("monitor", spec, "ns.csv", "-p", "vd=0.3", "-m", "t=%time")
    assert "--time-unit ns" in s2r(*asked, code=2).stderr
    done = s2r(*asked, "--time-unit", "ns", code=0)
    assert "line 19" in done.stderr
    assert "2024-06-10T06:13:20" in done.stderr
    s2r(*asked, "--time-unit", "ns", "--online", code=0)
    assert states(s2r(*asked, "--time-unit", "V", code=2).stderr, "'V'", "ms")


def test_parameters_that_the_trace_recorded(s2r, spec):
    recorded = walk(s2r, "recorded.csv", params={"vd": 0.25, "other": "x"})
    done = s2r("monitor", spec, recorded, code=0)
    assert states(done.stdout, "vd = 0.25", "recorded")
    found = s2r.json("monitor", spec, recorded, "-p", "vd=0.1", code=1)
    assert found["results"][0]["params"] == {"vd": 0.1}
    assert "0.25" in s2r("monitor", spec, recorded, "-p", "vd=0.1", code=1).stderr
    last = json.loads(s2r("monitor", spec, recorded, "--online", "--json", code=0).stdout.splitlines()[-1])
    assert last["params"] == {"vd": 0.25}
    wrong = walk(s2r, "wrong.csv", params={"vd": [1]})
    assert "vd = [1]" in s2r("monitor", spec, wrong, code=2).stderr


@pytest.mark.parametrize("online", [(), ("--online",)])
def test_windows_that_a_short_trace_cuts_to_nothing_decide_nothing(s2r, online):
    (s2r.folder / "late.stl").write_text("signal v {m}\nrequire ok: always[2 s, 3 s] (v <= 1 {m})\n")
    (s2r.folder / "early.csv").write_text("t,v\n0,5\n1,6\n")
    shown = s2r("monitor", "late.stl", "early.csv", "--partial", *online, code=3)
    assert "unknown" in shown.stdout
