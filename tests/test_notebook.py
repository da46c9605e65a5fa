"""The notebook of ten everyday things does what it shows, each in at most three lines."""

import json
import re
from pathlib import Path

import nbformat
import pytest

from tests import notebook

PATH = Path(__file__).parents[1] / "docs" / "tutorials" / "ten-things.ipynb"
PAGE = json.loads(PATH.read_text(encoding="utf-8"))
CELLS = notebook.code_of(PAGE)


def numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"[-+]?\d+\.\d+", text)]


def test_it_shows_ten_things_of_at_most_three_lines():
    text = "\n".join("".join(cell["source"]) for cell in PAGE["cells"])
    titles = re.findall(r"^## (\d+)\.", text, re.M)
    assert titles == [str(number) for number in range(1, 11)]
    _, *things = CELLS  # the first cell is the example
    assert len(things) == 10
    for cell in things:
        assert len(cell["source"]) <= 3, "".join(cell["source"])


def test_its_cells_show_what_it_keeps(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for cell, outputs in zip(CELLS, notebook.executed(PAGE), strict=True):
        shown, found = notebook.plain(cell["outputs"]), notebook.plain(outputs)
        assert re.sub(r"\d+\.\d+", "#", found) == re.sub(r"\d+\.\d+", "#", shown)
        assert numbers(found) == pytest.approx(numbers(shown), abs=2e-4)


def test_jupyter_opens_it():
    nbformat.validate(nbformat.reads(PATH.read_text(encoding="utf-8"), 4))
    assert "/tmp" not in PATH.read_text(encoding="utf-8")
