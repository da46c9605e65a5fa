"""Every specification that is shipped holds on one of its traces and fails on the other."""

from pathlib import Path

import pytest

from s2r_spec.logs import read
from s2r_spec.spec import load_spec

SPECS = Path(__file__).parents[2] / "specs"
SHIPPED = sorted(SPECS.glob("*.stl"))


def test_every_trace_has_its_specification() -> None:
    names = {f"{path.stem}_{word}.csv" for path in SHIPPED for word in ("holds", "fails")}
    assert {path.name for path in (SPECS / "traces").iterdir()} == names


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
