"""Every specification that is shipped holds on one of its traces and fails on the other."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from s2r_spec.errors import TraceNote
from s2r_spec.lang.lints import lint
from s2r_spec.lang.printing import format_text
from s2r_spec.logs import read
from s2r_spec.spec import load_spec
from tests import forked
from tests.logs.robot_logs import EXAMPLE, example
from tests.specs.twins import FLIGHTS, TWINS, WORDS, flight

ROOT = Path(__file__).parents[2]
SPECS = ROOT / "specs"
SHIPPED = sorted(SPECS.rglob("*.stl"))
NAMES = [path.relative_to(SPECS).with_suffix("").as_posix() for path in SHIPPED]
IN_FOLDERS = [name for name in NAMES if "/" in name]
LOG = "aerial/flight_log"
SOURCE = re.compile(r"^# Source: (.+)$", re.M)


def test_every_trace_has_its_specification() -> None:
    endings = {name: "ulg" if name == LOG else "csv" for name in NAMES}
    names = {f"{name}_{word}.{ending}" for name, ending in endings.items() for word in WORDS}
    traces = SPECS / "traces"
    found = {path.relative_to(traces).as_posix() for path in traces.rglob("*.*")}
    assert found == names | {EXAMPLE.name}


def test_the_shipped_log_is_what_its_script_makes(tmp_path) -> None:
    columns = {"vx": "/odom.twist.linear.x", "vx_cmd": "/cmd_vel.linear.x"}
    with pytest.warns(TraceNote):
        shipped, made = (
            read(path, columns, [*columns]) for path in (EXAMPLE, example(tmp_path / "drive.mcap"))
        )
    for name in columns:
        assert np.allclose(shipped[name], made[name], atol=1e-12)


@pytest.mark.parametrize("name", [name for name in NAMES if name != LOG])
def test_holds_and_fails(name: str) -> None:
    spec = load_spec(SPECS / f"{name}.stl")
    for word in WORDS:
        trace = read(SPECS / "traces" / f"{name}_{word}.csv")
        params = trace.meta.get("params", {})
        rho = spec.robustness(trace, params)
        assert (min(rho.values()) >= 0) == (word == "holds"), rho
        for requirement, value in rho.items():
            assert spec.explain(trace, requirement, params).rho == value


@pytest.mark.parametrize(("word", "code"), [("holds", 0), ("fails", 1)])
def test_the_command_in_the_comment_judges_a_flight(word: str, code: int) -> None:
    """A PX4 log has no channel names of its own: the comment of the specification maps them."""
    text = (SPECS / f"{LOG}.stl").read_text(encoding="utf-8")
    comment = "".join(
        line[1:].strip().rstrip("\\") for line in text.partition("# Source")[0].splitlines()[1:]
    )
    command = shlex.split(comment.replace("FLIGHT.ulg", f"traces/{LOG}_{word}.ulg"))
    done = forked.run(command[1:], SPECS)
    assert done.returncode == code, done.stderr


@pytest.mark.parametrize("name", TWINS)
def test_a_twin_is_what_its_script_makes(name: str) -> None:
    for word, make in zip(WORDS, TWINS[name], strict=True):
        shipped, made = read(SPECS / "traces" / f"{name}_{word}.csv"), make()
        assert dict(shipped.meta["params"]) == dict(made.meta["params"])
        for channel in made.channels:
            assert np.allclose(shipped[channel], made[channel], atol=2e-5), channel


def test_a_flight_is_what_its_script_makes() -> None:
    for word, drop in FLIGHTS.items():
        assert (SPECS / "traces" / f"{LOG}_{word}.ulg").stat().st_size == len(flight(drop))


@pytest.mark.parametrize("name", NAMES)
def test_no_specification_needs_a_second_look(name: str) -> None:
    text = (SPECS / f"{name}.stl").read_text(encoding="utf-8")
    assert not lint(text)
    assert format_text(text) == text


def test_the_table_lists_every_specification_with_its_source() -> None:
    page = (ROOT / "docs/reference/specs.md").read_text(encoding="utf-8")
    row = re.compile(r"^\| \[`([\w/]+)`\]\(../../specs/\1\.stl\) \|.*\| (.*) \|$", re.M)
    rows = dict(row.findall(page))
    assert sorted(rows) == sorted(NAMES)
    for name in IN_FOLDERS:
        assert SOURCE.findall((SPECS / f"{name}.stl").read_text(encoding="utf-8")) == [rows[name]]


def test_the_walks_read_channels_of_the_simulated_a1() -> None:
    """All but the actions, which its controller does not have."""
    from s2r_sim import SimBackend

    backend = SimBackend()
    channels = {one.name for one in backend.channels}
    parameters = {one.name for one in backend.parameters}
    for name in IN_FOLDERS:
        if name.startswith("legged/") and name != "legged/action_smoothness":
            spec = load_spec(SPECS / f"{name}.stl")
            assert set(spec.signals) <= channels, name
            assert set(spec.params) <= parameters, name


def test_the_margins_of_a_requirement_have_one_unit() -> None:
    """Else the size of ρ has no meaning, and no certificate can be given."""
    for name in IN_FOLDERS:
        spec = load_spec(SPECS / f"{name}.stl")
        assert "mixed" not in map(spec.unit, spec.requirements), name
