"""Walks tests/specs: every good file is accepted, every bad one has exactly the message beside it.

After a message was changed on purpose, write the new ones with
``python tests/lang/test_specs.py`` and read the difference.
"""

import re
from pathlib import Path

import pytest

from s2r_spec.lang.diagnostics import CODES, SpecError
from s2r_spec.spec import load_spec, parse_spec

SPECS = Path(__file__).parents[1] / "specs"
SHIPPED = sorted((SPECS.parents[1] / "specs").glob("*.stl"))
GOOD = [*sorted((SPECS / "good").glob("*.stl")), *SHIPPED]
BAD = sorted((SPECS / "bad").glob("*.stl"))


def message(path: Path) -> str:
    try:
        parse_spec(path.read_text(encoding="utf-8"), path.name)
    except SpecError as error:
        return f"{error}\n"
    return "no mistake\n"


@pytest.mark.parametrize("path", GOOD, ids=lambda path: path.stem)
def test_good(path: Path) -> None:
    spec = load_spec(path)
    assert spec.requirements


@pytest.mark.parametrize("path", BAD, ids=lambda path: path.stem)
def test_bad(path: Path) -> None:
    assert message(path) == path.with_suffix(".txt").read_text(encoding="utf-8")


def test_every_code_has_a_bad_file() -> None:
    shown = {code for path in BAD for code in re.findall(r"error\[(E\d+)\]", message(path))}
    assert shown | {"E19", "E22"} == set(CODES)  # nesting and length are drawn in test_parsing


if __name__ == "__main__":
    for bad in BAD:
        bad.with_suffix(".txt").write_text(message(bad), encoding="utf-8")
