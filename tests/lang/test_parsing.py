import sys
from contextlib import suppress
from dataclasses import fields
from importlib.util import cache_from_source
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from s2r_spec.lang import lexing, parsing, syntax
from s2r_spec.lang.diagnostics import SpecError
from s2r_spec.lang.parsing import DEEPEST, parse
from s2r_spec.lang.source import Source
from s2r_spec.spec import parse_spec
from tests.errors import naming
from tests.examples import examples


def shape(node: object) -> str:
    """Print an expression with every pair of brackets."""
    match node:
        case syntax.Number():
            return f"{node.value:g}"
        case syntax.Name():
            return node.name
        case syntax.Minus():
            return f"(-{shape(node.operand)})"
        case syntax.Negation():
            return f"(not {shape(node.operand)})"
        case syntax.Arithmetic():
            return f"({shape(node.left)} {node.operator.text} {shape(node.right)})"
        case syntax.Implication():
            return f"({shape(node.left)} {node.operator} {shape(node.right)})"
        case syntax.Junction():
            return "(" + f" {node.operator} ".join(map(shape, node.operands)) + ")"
        case syntax.Comparison():
            signs = [word.text for word in node.operators]
            return "(" + shape(node.operands[0]) + "".join(
                f" {sign} {shape(part)}" for sign, part in zip(signs, node.operands[1:], strict=True)
            ) + ")"  # fmt: skip
        case syntax.Temporal() | syntax.AdjacentSample():
            return f"({node.operator} {shape(node.operand)})"
        case syntax.Until():
            return (
                f"({shape(node.left)} "
                + " ".join(f"{part.operator} {shape(part.operand)}" for part in node.links)
                + ")"
            )
    raise AssertionError(node)


def parsed(text: str) -> syntax.Expression:
    found = parse(Source(f"let it := {text}"))
    assert not found.diagnostics, str(found.diagnostics[0])
    (statement,) = found.statements
    assert isinstance(statement, syntax.Let)
    return statement.body


@pytest.mark.parametrize(
    ("text", "meaning"),
    [
        ("-a^2", "(-(a ^ 2))"),
        ("a^-b^c", "(a ^ (-(b ^ c)))"),
        ("a - b - c", "((a - b) - c)"),
        ("a / b * c", "((a / b) * c)"),
        ("a + b * -c", "(a + (b * (-c)))"),
        ("a + b <= c", "((a + b) <= c)"),
        ("0 <= a < 2", "(0 <= a < 2)"),
        ("not a <= b", "(not (a <= b))"),
        ("not p and q", "((not p) and q)"),
        ("always p and q", "((always p) and q)"),
        ("always[0, 1] p until q", "((always p) until q)"),
        ("always eventually not p", "(always (eventually (not p)))"),
        ("p until q and r", "((p until q) and r)"),
        ("p and q or r and s", "((p and q) or (r and s))"),
        ("p and q and r", "(p and q and r)"),
        ("p or q -> r", "((p or q) -> r)"),
        ("p -> q -> r", "(p -> (q -> r))"),
        ("p -> q <-> q -> p", "((p -> q) <-> (q -> p))"),
        ("always (p) until (q)", "((always p) until q)"),
        ("next not prev p", "(next (not (prev p)))"),
        ("((a))", "a"),
        ("a<-b", "(a < (-b))"),
    ],
)
def test_ladder(text: str, meaning: str) -> None:
    assert shape(parsed(text)) == meaning


@pytest.mark.parametrize(
    ("foreign", "own"),
    [
        ("G[0, 1] p", "always[0, 1] p"),
        ("alw_[0:1] p", "always[0, 1] p"),
        ("globally (0, 1] p", "always(0, 1] p"),
        ("[]_[0, 1) p", "always[0, 1) p"),
        ("[] p", "always p"),
        ("<> p", "eventually p"),
        ("ev p", "eventually p"),
        ("F (p)", "eventually (p)"),
        ("O[0, 1] H p", "once[0, 1] historically p"),
        ("X p", "next p"),
        ("p U[0, 1] q", "p until[0, 1] q"),
        ("p until_[0, 1] q", "p until[0, 1] q"),
        ("p S q", "p since q"),
        ("p R q", "p release q"),
        ("p W q", "p unless q"),
        ("!p && q || r", "not p and q or r"),
        ("p /\\ q \\/ r => s", "p and q or r -> s"),
        ("p & q | r implies s", "p and q or r -> s"),
        ("p <=> q", "p <-> q"),
    ],
)
def test_other_names_mean_the_same(foreign: str, own: str) -> None:
    assert unplaced(parsed(foreign)) == unplaced(parsed(own))


def unplaced(node: object) -> object:
    """Return the node as nested tuples without its places and spellings."""
    if isinstance(node, syntax.Word):
        return "word"
    if isinstance(node, syntax.Node):
        return type(node).__name__, *(
            unplaced(getattr(node, item.name)) for item in fields(node) if item.name != "span"
        )
    return tuple(map(unplaced, node)) if isinstance(node, tuple) else node


@pytest.mark.parametrize(
    "text",
    [
        "(" * 500 + "p" + ")" * 500,
        "not " * 500 + "p",
        "p -> " * 500 + "p",
        " + ".join("a" * 500) + " <= 1",
        "-" * 500 + "a <= 1",
    ],
)
def test_deep_nesting_is_refused_with_a_sentence(text: str) -> None:
    with pytest.raises(SpecError, match=naming("E19", "deep.stl:3:", str(DEEPEST))):
        parse_spec(f"signal a\nlet p := a > 0\nrequire it: {text}", "deep.stl")


def test_nesting_counts_through_definitions() -> None:
    chain = "".join(f"let p{n + 1} := not (p{n} and p{n})\n" for n in range(200))
    with pytest.raises(SpecError, match=rf"E19.*`p\d+`.* {DEEPEST} ") as caught:
        parse_spec(f"signal a\nlet p0 := a > 0\n{chain}require it: p200")
    assert len(caught.value.diagnostics) == 1


def test_many_statements_and_wide_formulas() -> None:
    wide = " and ".join(["a > 0"] * 3000)
    many = "".join(f"let p{n} := a > {n}\n" for n in range(1000))
    assert parse_spec(f"signal a\n{many}require it: {wide}").requirements == ("it",)


WORDS = (
    "signal param const let require certify always until not in inf x p vx {m/s} {} 1 0.5e3 [ ] ( ) , : := = <= == -> "
    "- ^ * / # $ \n _ [] <> G U ms delta kernel rbf( é ' \x00 {kg^-3} 1e999"
)
PIECES = st.sampled_from(WORDS.split(" "))


@settings(max_examples=examples(200), deadline=None)
@given(st.one_of(st.text(max_size=60), st.lists(PIECES, max_size=25).map(" ".join)))
def test_any_text_is_a_specification_or_a_list_of_mistakes(text: str) -> None:
    with suppress(SpecError):
        parse_spec(text)


@pytest.mark.parametrize(
    ("condition", "meant"),
    [
        ("|x| <= 1 {m}", "`abs(x)`"),
        ("2 {m} <= 3 * | x - 1 {m} |", "`abs(x - 1 {m})`"),
        ("x >= 2 {m} | |x| <= 1 {m}", "`abs(x)`"),
        ("|x <= 1 {m}", "`abs(…)`"),
    ],
)
def test_the_bars_of_an_absolute_value_are_answered_with_its_function(condition, meant):
    with pytest.raises(SpecError, match=naming(meant)):
        parse_spec(f"signal x {{m}}\nrequire r: always ({condition})")


def test_tables_on_disk_read_like_new_ones_and_damaged_ones_are_made_again(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "pycache_prefix", str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    place = Path(cache_from_source(str(Path(lexing.__file__).with_name("stl.lark"))))
    text = "signal x {m}\nrequire a: always[0, 1 s] (x <= 1 {m}) and\nrequire b: x ^ 2 >= - 1 {m^2} -> x < 3"
    found = []
    for folder, damage in ((False, None), (True, None), (True, None), (True, b"no tables"), (True, None)):
        if folder:
            place.parent.mkdir(parents=True, exist_ok=True)
        if damage is not None:
            (tables,) = place.parent.iterdir()
            tables.write_bytes(damage)
        with monkeypatch.context() as patch:
            parser = lexing.grammar.__wrapped__()
            for module in (lexing, parsing):
                patch.setattr(module, "grammar", lambda parser=parser: parser)
            found.append(parse(Source(text, "a.stl")))
    assert len(found[0].diagnostics) == 1
    assert all(
        (one.statements, one.diagnostics) == (found[0].statements, found[0].diagnostics) for one in found
    )
    (tables,) = place.parent.iterdir()
    assert tables.stat().st_size > 10_000
