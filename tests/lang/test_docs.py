"""The reference says what the language does: examples parse, every word and code is in it."""

import json
import re
from pathlib import Path

import pytest

from s2r_spec.lang.diagnostics import CODES as ERRORS
from s2r_spec.lang.functions import FUNCTIONS
from s2r_spec.lang.highlight import STATEMENTS, TEMPORAL
from s2r_spec.lang.lints import CODES as LINTS
from s2r_spec.spec import parse_spec

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs/reference/language.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```stl\n(.*?)```", TEXT, re.DOTALL)


@pytest.mark.parametrize("text", EXAMPLES)
def test_examples_are_specifications(text: str) -> None:
    assert parse_spec(text).requirements


def test_the_example_prints_what_it_says(capsys) -> None:
    code, printed = re.search(r"```python\n(.*?)```\n\n```\n(.*?)```", TEXT, re.DOTALL).groups()
    exec(code, {})
    assert capsys.readouterr().out == printed


def test_every_code_is_listed() -> None:
    assert set(re.findall(r"^\| ([EL]\d\d) \|", TEXT, re.MULTILINE)) == {*ERRORS, *LINTS}


def test_every_word_is_explained() -> None:
    words = set(re.findall(r"[a-z]+", TEXT))
    assert {*STATEMENTS, *TEMPORAL, *FUNCTIONS} <= words


def test_the_costs_of_the_language_page_are_those_of_the_benchmark() -> None:
    rows = json.loads((ROOT / "benchmarks" / "results" / "peers.json").read_text())["rows"]
    online = [row for row in rows if "online" in row]
    single = [row["us one by one"] for row in online]
    words = r"about ([\d.]+) µs a sample.*?(\d+) to (\d+) µs one by one.*?takes ([\d.]+) ms"
    found = re.search(words, TEXT, re.DOTALL)
    assert found is not None
    blocks, low, high, start = map(float, found.groups())
    assert blocks == round(max(row["us in blocks"] for row in online), 1)
    assert [low, high] == [round(min(single)), round(max(single))]
    assert start == round(next(row["ms"] for row in rows if row.get("at time 0") == "always"), 2)
