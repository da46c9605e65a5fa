"""Walks tests/specs: every good file is accepted, every bad one has the mistakes that ``bad.json`` lists.

A mistake is its code, its line and column, the text that it points at, and the names, units and figures of its message.
The sentence is free. After a mistake was changed on purpose, write the list with
``python -m tests.lang.test_specs`` and read the difference.
"""

import json
import re
from pathlib import Path

import pytest

from s2r_spec.lang.diagnostics import CODES, Diagnostic, SpecError
from s2r_spec.spec import load_spec, parse_spec

SPECS = Path(__file__).parents[1] / "specs"
SHIPPED = sorted((SPECS.parents[1] / "specs").rglob("*.stl"))
GOOD = [*sorted((SPECS / "good").glob("*.stl")), *SHIPPED]
BAD = sorted((SPECS / "bad").glob("*.stl"))
LISTED = SPECS / "bad.json"
UNIT = re.compile(r"\{([^{}]*)\}")
FACT = re.compile(r"`[^`]+`|(?<![\w.])-?\d[\w.e+-]*|\S+")


def facts(mistake: Diagnostic) -> list[str]:
    """Return what a message names: quoted words, figures, and units of the specification; in order, each once."""
    units = set(UNIT.findall(mistake.span.source.text))
    words = (word.rstrip(",;:.?") for word in FACT.findall(f"{mistake.message} {mistake.fix}"))
    return sorted({word for word in words if word[:1] == "`" or re.match(r"-?\d", word) or word in units})


def mistakes(path: Path) -> list[str]:
    """Return a line for each mistake in a file."""
    try:
        parse_spec(path.read_text(encoding="utf-8"), path.name)
    except SpecError as error:
        return [
            f"{found.code} {found.span.line}:{found.span.column} {found.span.text.strip()!r}"
            + (f" declared at {found.declared_at.line}" if found.declared_at else "")
            + "".join(f" {fact}" for fact in facts(found))
            for found in error.diagnostics
        ]
    return []


@pytest.mark.parametrize("path", GOOD, ids=lambda path: path.stem)
def test_good(path: Path) -> None:
    spec = load_spec(path)
    assert spec.requirements


@pytest.mark.parametrize("path", BAD, ids=lambda path: path.stem)
def test_bad(path: Path) -> None:
    assert mistakes(path) == json.loads(LISTED.read_text(encoding="utf-8"))[path.stem]


def test_every_bad_file_is_listed_and_every_code_has_one() -> None:
    listed = json.loads(LISTED.read_text(encoding="utf-8"))
    assert list(listed) == [path.stem for path in BAD]
    assert {line.split()[0] for lines in listed.values() for line in lines} | {"E19", "E22"} == set(CODES)


def test_a_message_draws_its_place() -> None:
    with pytest.raises(SpecError) as caught:
        parse_spec("signal v {m/s}\nlet v := v <= 1\nrequire slow: v", "a.stl")
    head, _, first, *drawn = str(caught.value).splitlines()
    assert "a.stl" in head
    assert first.startswith("error[E08]: `v` ")
    assert drawn[:4] == [" --> a.stl:2:5", "  |", "2 | let v := v <= 1", "  |     ^ declared at line 1"]
    assert drawn[4].startswith("  = ")


if __name__ == "__main__":
    LISTED.write_text(
        json.dumps({bad.stem: mistakes(bad) for bad in BAD}, indent=1, ensure_ascii=False) + "\n",
        encoding="utf-8",
    )
