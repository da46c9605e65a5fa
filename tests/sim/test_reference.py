"""The reference page of the A1 shows the tables that the code prints."""

from pathlib import Path

import pytest

from benchmarks.a1.reference_tables import TABLES

ROOT = Path(__file__).resolve().parents[2]


SLOW = pytest.mark.slow  # two rollouts of every effect; tests/sim/test_residuals.py has a few of them


@pytest.mark.parametrize(
    "make",
    [pytest.param(make, marks=SLOW if make.__name__ == "residuals" else ()) for make in TABLES],
    ids=lambda make: make.__name__,
)
def test_the_page_has_the_table(make):
    page = (ROOT / "docs" / "reference" / "a1.md").read_text()
    assert make() in page, (
        "run: python -m benchmarks.a1.reference_tables, and put its tables into docs/reference/a1.md"
    )
