"""The formatter: same meaning, nothing lost, and nothing left to do the second time."""

from dataclasses import fields
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from s2r_spec.lang import syntax
from s2r_spec.lang.diagnostics import SpecError
from s2r_spec.lang.imports import imported_names
from s2r_spec.lang.lexing import comments, lex
from s2r_spec.lang.parsing import parse
from s2r_spec.lang.printing import format_text
from s2r_spec.lang.source import Source
from tests.examples import examples
from tests.robustness.drawing import FORMULAS, text_of

SPECS = Path(__file__).parents[1] / "specs"
SHIPPED = sorted((SPECS.parents[1] / "specs").glob("*.stl"))
GOOD = sorted((SPECS / "good").glob("*.stl"))


def meaning(text: str, name: str = "<string>") -> object:
    """Return the syntax of a text without its places and spellings."""
    source = Source.of(text, name)
    parsed = parse(source, imported_names(source))
    assert not parsed.diagnostics, str(parsed.diagnostics[0])
    return unplaced(parsed.statements)


def unplaced(node: object) -> object:
    if isinstance(node, syntax.Node):
        kept = (item.name for item in fields(node) if item.name not in ("span", "word"))
        return type(node).__name__, *(unplaced(getattr(node, name)) for name in kept)
    return tuple(map(unplaced, node)) if isinstance(node, tuple) else node


def check(text: str, name: str = "<string>") -> str:
    """Format a text, and hold the result to what a formatter promises."""
    once = format_text(text, name)
    assert meaning(once, name) == meaning(text, name)
    assert format_text(once, name) == once
    before, after = ([token.lstrip("#/").strip() for token in comments(Source.of(t))] for t in (text, once))
    assert before == after
    assert not any(line != line.rstrip() for line in once.split("\n"))
    return once


@pytest.mark.parametrize("path", [*GOOD, *SHIPPED], ids=lambda path: path.stem)
def test_every_good_file(path: Path) -> None:
    check(path.read_text(encoding="utf-8"), str(path))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_what_is_shipped_is_formatted(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert format_text(text) == text


SPACE = [" ", "  ", "\n", "\n\n\n", "\t", " # why\n", "// so\n", "\n#\n", " # a\n # b\n\n"]


@settings(max_examples=examples(200), deadline=None)
@given(st.lists(FORMULAS, min_size=1, max_size=2), st.randoms(use_true_random=False), st.integers(0, 8))
def test_any_text(formulas, random, plain) -> None:
    text = (
        "signal x {m/s} in [-1, 1] signal y[3] const c {m} = 1 let a = y[0] param p = 2 in [0, 3]"
        + "".join(f" require r{k}: {text_of(formula, Fraction(1, 10))}" for k, formula in enumerate(formulas))
    )
    tokens = [token for statement in lex(Source.of(text)).statements for token in statement]
    spaces = SPACE + [" "] * 2**plain
    check("".join(random.choice(spaces) + token for token in tokens) + "\n")


def test_how_it_looks() -> None:
    assert check(
        "signal x{ m/s }in[0,1]//speed\nconst tol=.1 # tolerance\n\n\n\nlet near= abs(x)<=tol\n"
        "let far   := !near\nrequire a:G_[0:1]near&&F(far)\nrequire longer: x>0||-x^2 *3<=1 => far U(0,1]near\n"
        "# the end"
    ) == (
        "signal x {m/s} in [0, 1]  # speed\n"
        "const  tol = .1           # tolerance\n"
        "\n"
        "let near := abs(x) <= tol\n"
        "let far  := not near\n"
        "require a:      always[0, 1] near and eventually (far)\n"
        "require longer: x > 0 or -x^2 * 3 <= 1 -> far until(0, 1] near\n"
        "# the end\n"
    )


def test_a_long_statement_is_broken_at_its_loosest_operator() -> None:
    part = "always[0, 1] (abs(x) <= 12 or y >= 3)"
    assert check(f"require it: {' and '.join([part] * 3)} # why") == (
        f"require it:\n    {part}\n    and {part}\n    and {part}  # why\n"
    )


def test_a_comment_inside_a_statement_keeps_its_lines() -> None:
    assert check("require it: x>0   # first\n   and   y>0\n and z>0 # last") == (
        "require it: x > 0  # first\n    and y > 0\n    and z > 0      # last\n"
    )


def test_what_does_not_parse_is_not_formatted() -> None:
    with pytest.raises(SpecError, match="E01"):
        format_text("require it: always (x > 0")
    # what only a check would find is no obstacle
    assert format_text("require it: undeclared>0") == "require it: undeclared > 0\n"
