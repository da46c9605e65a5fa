"""Every lint fires where it should, and its edits change no meaning."""

from pathlib import Path

import pytest

from s2r_spec.lang.latex import to_latex
from s2r_spec.lang.lints import CODES, apply_fixes, lint
from tests.lang.test_printing import meaning

SHIPPED = sorted((Path(__file__).parents[2] / "specs").glob("*.stl"))
HEAD = "signal x {m} in [-5, 5]\nsignal y\nparam p in [-1, 1]\nparam q = 1 in [1, 2]\n"
USES = "require used: x >= 0 and y >= p and y >= q\n"

CASES = [
    ("always x > 0 and y > 0", ["L01"]),
    ("always eventually x > 0 -> y > 0", ["L01"]),
    ("always not x > 0 or y > 0", ["L01"]),
    ("always (x > 0) and y > 0", []),
    ("(always x > 0) and y > 0", []),
    ("y > 0 and always x > 0", []),
    ("x > 0 and y > 0 or y < 1", ["L02"]),
    ("(x > 0 and y > 0) or y < 1", []),
    ("x > 0 -> y > 0 -> y < 1", ["L03"]),
    ("x > 0 -> (y > 0 -> y < 1)", []),
    ("0 <= y == p", ["L04"]),
    ("sign(p) * y <= 1", ["L05"]),
    ("sign(q) * y <= 1", []),
    ("sign(y) * y <= 1", ["L05"]),
    ("x <= 600 {cm}", ["L07"]),
    ("6 < x", ["L07"]),
    ("-5 <= x", ["L07"]),
    ("x <= 4", []),
]


@pytest.mark.parametrize(("formula", "codes"), CASES)
def test_where_lints_fire(formula: str, codes: list[str]) -> None:
    text = f"{HEAD}{USES}require it: {formula}"
    found = lint(text)
    assert [finding.code for finding in found] == codes
    assert meaning(apply_fixes(text, found)) == meaning(text)
    assert not any(finding.edits for finding in lint(apply_fixes(text, found)))


LENGTHS = [
    ("p {m} in [-0.3, 0.3]", "matern52(150)", "150 mm"),
    ("p {rad} in [0, 1]", "rbf(20)", "20 deg"),
    ("p {m/s} in [0, 2]", "rbf(1.5, 30)", "30 cm/s"),
    ("p in [0, 1]", "rbf(2)", ""),
    ("p {m} in [-0.3, 0.3]", "rbf(0.6)", None),
    ("p {m} in [-0.3, 0.3]", "rbf(150 {mm})", None),
]


@pytest.mark.parametrize(("declared", "kernel", "meant"), LENGTHS)
def test_a_length_scale_longer_than_its_range(declared: str, kernel: str, meant: str | None) -> None:
    first = "param n in [0, 2]\n" if "," in kernel else ""
    text = f"signal y\n{first}param {declared}\nrequire it: y > 0\ncertify it: kernel = {kernel}"
    found = [finding for finding in lint(text) if finding.code == "L08"]
    assert [finding.span.text for finding in found] == (
        [] if meant is None else [kernel[:-1].split("(")[1].split(", ")[-1]]
    )
    assert all("`p`" in finding.message and (meant or "") in finding.fix for finding in found)


def test_every_code_is_tried() -> None:
    unused = lint(f"{HEAD}require it: y > 0")
    assert [finding.span.text for finding in unused] == ["x", "q"]
    tried = {code for _, codes in CASES for code in codes} | {finding.code for finding in unused}
    assert tried | {"L08"} == set(CODES)


def test_the_picture() -> None:
    text = "signal x\nrequire it: always x > 0 and x < 1"
    head, *picture, fix = str(lint(text, "a.stl")[0]).split("\n")
    assert head.startswith("warning[L01]: ")
    assert "`always`" in head
    assert picture == [
        " --> a.stl:2:13",
        "  |",
        "2 | require it: always x > 0 and x < 1",
        "  |             ^^^^^^^^^^^^",
    ]
    assert fix.startswith("  = ")


def test_two_edits_at_one_place() -> None:
    text = "signal x require it: always x > 0 and x < 2 or x > 1"
    assert apply_fixes(text, lint(text)) == "signal x require it: ((always x > 0) and x < 2) or x > 1"


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_what_is_shipped_is_clean(path: Path) -> None:
    assert not lint(path.read_text(encoding="utf-8"), path.name)


def test_latex() -> None:
    text = (
        "const tol_o {m/s} = 0.03\nlet a := abs(v) <= tol_o\n"
        "require it: (always[0, 0.5 s] a or not (a and a)) until(0, inf) -x^2 * (y - (z + 1)) / 2 < 1 <= w"
    )
    assert to_latex(text) == (
        "\\begin{align*}\n"
        "  \\mathit{tol\\_o} &:= 0.03\\,\\mathrm{m/s} \\\\\n"
        "  a &:= \\lvert v \\rvert \\leq \\mathit{tol\\_o} \\\\\n"
        "  \\mathit{it} &: \\left( \\square_{[0, 0.5\\,\\mathrm{s}]} a "
        "\\vee \\neg \\left( a \\wedge a \\right) \\right) "
        "\\mathbin{\\mathcal{U}}_{(0, \\infty)} "
        "\\frac{-x^{2} \\cdot \\left( y - \\left( z + 1 \\right) \\right)}{2} < 1 \\leq w\n"
        "\\end{align*}\n"
    )
