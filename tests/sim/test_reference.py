"""The reference page of the A1 shows the tables that the code prints."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def tables():
    spec = importlib.util.spec_from_file_location("a1_reference", ROOT / "benchmarks" / "a1_reference.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.TABLES


SLOW = pytest.mark.slow  # two rollouts of every effect; tests/sim/test_residuals.py has a few of them


@pytest.mark.parametrize(
    "make",
    [pytest.param(make, marks=SLOW if make.__name__ == "residuals" else ()) for make in tables()],
    ids=lambda make: make.__name__,
)
def test_the_page_has_the_table(make):
    page = (ROOT / "docs" / "reference" / "a1.md").read_text()
    assert make() in page, (
        "run: python benchmarks/a1_reference.py, and put its tables into docs/reference/a1.md"
    )
