"""The reference page of the axis shows the tables that the code prints."""

import importlib.util
from pathlib import Path

import pytest

from s2r_emps import EmpsBackend

ROOT = Path(__file__).resolve().parents[2]


def tables():
    spec = importlib.util.spec_from_file_location("backend_tables", ROOT / "benchmarks" / "backend_tables.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.TABLES


@pytest.mark.parametrize("make", tables(), ids=lambda make: make.__name__)
def test_the_page_has_the_table(make):
    page = (ROOT / "docs" / "reference" / "emps.md").read_text()
    assert make(EmpsBackend()) in page, (
        "run: python benchmarks/backend_tables.py emps, and put its tables into docs/reference/emps.md"
    )
