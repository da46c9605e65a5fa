"""Every specification that is shipped holds on one of its traces and fails on the other."""

from pathlib import Path

import numpy as np
import pytest

from s2r_spec.errors import TraceNote
from s2r_spec.logs import read
from s2r_spec.spec import load_spec
from tests.logs.robot_logs import EXAMPLE, example

SPECS = Path(__file__).parents[2] / "specs"
SHIPPED = sorted(SPECS.glob("*.stl"))


def test_every_trace_has_its_specification() -> None:
    names = {f"{path.stem}_{word}.csv" for path in SHIPPED for word in ("holds", "fails")}
    assert {path.name for path in (SPECS / "traces").iterdir()} == names | {EXAMPLE.name}


def test_the_shipped_log_is_what_its_script_makes(tmp_path) -> None:
    columns = {"vx": "/odom.twist.linear.x", "vx_cmd": "/cmd_vel.linear.x"}
    with pytest.warns(TraceNote):
        shipped, made = (
            read(path, columns, [*columns]) for path in (EXAMPLE, example(tmp_path / "drive.mcap"))
        )
    for name in columns:
        assert np.allclose(shipped[name], made[name], atol=1e-12)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_holds_and_fails(path: Path) -> None:
    spec = load_spec(path)
    for word in ("holds", "fails"):
        trace = read(SPECS / "traces" / f"{path.stem}_{word}.csv")
        params = trace.meta.get("params", {})
        rho = spec.robustness(trace, params)
        assert (min(rho.values()) >= 0) == (word == "holds"), rho
        for name, value in rho.items():
            assert spec.explain(trace, name, params).rho == value
