"""The reference page of the axis shows the tables that the code prints."""

from pathlib import Path

import pytest

from benchmarks.tables import TABLES
from s2r_emps import EmpsBackend

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("make", TABLES, ids=lambda make: make.__name__)
def test_the_page_has_the_table(make):
    page = (ROOT / "docs" / "reference" / "emps.md").read_text()
    assert make(EmpsBackend()) in page, (
        "run: python -m benchmarks.tables emps, and put its tables into docs/reference/emps.md"
    )
