"""The plugin gives tests the fixture ``assert_robust``, and costs every other run of pytest next to nothing."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import s2r_spec as s2r
from s2r_spec.errors import UsageError

ROOT = Path(__file__).parents[1]
SPEC = "signal v {m/s}\nparam vd {m/s} in [0, 2]\nrequire slow: always (v <= vd)\nrequire low: always (v <= 9 {m/s})\n"
FAST = s2r.Trace([0, 1], {"v": [0.5, 2.0]}, {"v": "m/s"}, {"params": {"vd": 1.0}})
TESTS = """
from s2r_spec import assert_robust as imported

def test_fixture(assert_robust):
    assert_robust("fast.npz", "slow.stl")

def test_import():
    imported("fast.npz", "slow.stl", "slow")

def test_holds(assert_robust):
    assert assert_robust("fast.npz", "slow.stl", params={"vd": "2.5 m/s"})["slow"] == 0.5
"""


@pytest.fixture
def place(tmp_path):
    """A folder with tests, and with the entry point of the plugin as pip would have installed it."""
    group = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["pytest11"]
    about = tmp_path / "s2r_plugin-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: s2r-plugin\nVersion: 1.0\n")
    points = "".join(f"{name} = {value}\n" for name, value in group.items())
    (about / "entry_points.txt").write_text(f"[pytest11]\n{points}")
    (tmp_path / "slow.stl").write_text(SPEC)
    s2r.write_trace(FAST, tmp_path / "fast.npz")
    return tmp_path


def run(place, code, *options):
    """Run pytest in a process of its own, as a stranger's project does."""
    (place / "test_it.py").write_text(code)
    path = os.pathsep.join((str(place), str(ROOT)))
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "no:cacheprovider",
        "-q",
        "--rootdir",
        str(place),
        *options,
    ]
    return subprocess.run(
        command, cwd=place, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False
    )


def test_a_failure_shows_the_four_lines_of_the_explanation(place):
    done = run(place, TESTS, "-n", "0")
    assert re.search("2 failed, 1 passed", done.stdout), done.stdout + done.stderr
    lines = str(s2r.parse_spec(SPEC).explain(FAST, "slow", {"vd": 1})).splitlines()
    assert len(lines) == 4
    for line in lines:
        assert done.stdout.count(line) >= 2, line  # of both tests, in whole lines
    assert "low" not in done.stdout.replace("slow", "")
    assert "assertion.py" not in done.stdout  # the traceback ends in the test


@pytest.mark.slow  # beside it, the fixture runs in one process
def test_it_works_with_xdist(place):
    done = run(place, TESTS, "-n", "1")
    assert re.search("2 failed, 1 passed", done.stdout), done.stdout + done.stderr


@pytest.mark.parametrize("options", [(), ("-p", "no:s2r")])
def test_a_run_without_the_fixture_loads_nothing_of_it(place, options):
    plugin = {"s2r_spec", "s2r_spec.pytest_plugin", "s2r_spec.testing", "s2r_spec.testing.pytest_plugin"}
    code = (
        "import sys\n\ndef test_it():\n    loaded = {name for name in sys.modules if name.startswith('s2r_spec')}\n"
        f"    assert loaded == {set() if options else plugin}\n"
        "    assert not {'numpy', 'torch', 'lark'} & sys.modules.keys()\n"
    )
    done = run(place, code, "-p", "no:hypothesispytest", "-n", "0", *options)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_function_takes_objects_and_returns_the_robustness():
    spec = s2r.parse_spec(SPEC)
    assert s2r.assert_robust(FAST, spec, params={"vd": 2}) == {"slow": 0.0, "low": 7.0}
    with pytest.raises(AssertionError, match=r"slow holds.*\n.*\n.*\n.*\n.*at least 0\.1 m/s"):
        s2r.assert_robust(FAST, spec, "slow", params={"vd": 2}, at_least=0.1)
    with pytest.raises(AssertionError, match=r"slow violated: ρ = -1 m/s"):
        s2r.assert_robust(FAST, spec)
    for trace, given in ((3, spec), (FAST, None), (FAST.only([]), spec)):
        with pytest.raises(UsageError):
            s2r.assert_robust(trace, given)
