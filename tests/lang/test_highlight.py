"""Colours: every word of the language, in Pygments and in the TextMate grammar."""

import json
import re
from pathlib import Path

import pytest
from pygments.token import Error, Keyword, Name

from s2r_spec.lang.functions import FUNCTIONS
from s2r_spec.lang.highlight import FUNCTIONS as COLOURED
from s2r_spec.lang.highlight import STATEMENTS, TEMPORAL, StlLexer

ROOT = Path(__file__).parents[2]
FILES = [*sorted((ROOT / "specs").rglob("*.stl")), *sorted((ROOT / "tests/specs/good").glob("*.stl"))]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_good_file_is_coloured_without_an_error(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    tokens = list(StlLexer().get_tokens(text))
    assert not [value for kind, value in tokens if kind is Error]
    assert "".join(value for _, value in tokens).strip() == text.strip()


def test_words_are_told_from_names() -> None:
    kinds = {value: kind for kind, value in StlLexer().get_tokens("require always_fast: always min(x)")}
    assert (kinds["require"], kinds["always"]) == (Keyword.Declaration, Keyword)
    assert (kinds["always_fast"], kinds["min"], kinds["x"]) == (Name, Name.Builtin, Name)


def test_both_grammars_know_every_word() -> None:
    grammar = json.loads((ROOT / "docs/editor/s2r-stl.tmLanguage.json").read_text(encoding="utf-8"))
    patterns = [item["match"] for item in grammar["patterns"]]
    for pattern in patterns:
        re.compile(pattern)
    known = set(re.findall(r"\w+", " ".join(patterns)))
    assert {*STATEMENTS, *TEMPORAL, *COLOURED} <= known
    assert set(COLOURED) == set(FUNCTIONS)
