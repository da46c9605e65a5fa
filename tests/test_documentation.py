"""Messages name pages that exist, by an address that a reader of a wheel can use."""

import ast
import re
import shutil
import tomllib
from email.message import Message
from pathlib import Path
from types import SimpleNamespace

import pytest

from s2r_spec.base import documentation, shipped
from tests import forked

ROOT = Path(__file__).parents[1]
PAGES = sorted(path for path in (ROOT / "docs").rglob("*") if path.suffix in (".md", documentation.NOTEBOOK))
SOURCES = {
    path: path.read_text(encoding="utf-8")
    for name in ("s2r_spec", "backends")
    for path in sorted((ROOT / name).rglob("*.py"))
}


@pytest.fixture(autouse=True)
def _fresh():
    documentation._address.cache_clear()
    yield
    documentation._address.cache_clear()


def spoken(tree: ast.Module) -> list[str]:
    """Return the strings of a module but for its docstrings: what a user may see."""
    silent = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    constants = [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in silent]
    return [node.value for node in constants if isinstance(node.value, str)]


def test_no_message_names_a_file_that_a_wheel_lacks():
    for path, source in SOURCES.items():
        if "docs/" in source:
            assert not [text for text in spoken(ast.parse(source)) if "docs/" in text], path


def test_every_page_that_a_message_names_exists():
    calls = [
        node
        for source in SOURCES.values()
        if "import page" in source
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "page"
    ]
    assert len(calls) > 5
    for call in calls:
        assert (ROOT / "docs" / f"{call.args[0].value}.md").exists()


def test_a_page_has_the_address_that_the_installed_package_states(monkeypatch):
    about = Message()
    about["Project-URL"] = "Source, https://example.org/code"
    monkeypatch.setattr(documentation, "find_own", lambda: SimpleNamespace(metadata=about))
    assert documentation.page("how-to/effects") == "`s2r docs how-to/effects`"
    documentation._address.cache_clear()
    about["Project-URL"] = "Documentation, https://example.org/s2r/"
    assert documentation.page("how-to/effects") == "https://example.org/s2r/how-to/effects.html"


def test_the_command_lists_every_page_and_prints_one():
    listed = forked.run(["docs"]).stdout.splitlines()
    names = {path.relative_to(ROOT / "docs").with_suffix("").as_posix() for path in PAGES}
    assert {line.split()[0] for line in listed} == names
    assert all(len(line.split()) > 1 for line in listed)  # each with its title
    printed = forked.run(["docs", "how-to/effects"])
    assert printed.stdout == (ROOT / "docs" / "how-to" / "effects.md").read_text(encoding="utf-8")
    assert forked.run(["docs", "effects"]).stdout == printed.stdout  # the only page of this name
    notebook = forked.run(["docs", "tutorials/ten-things"]).stdout
    assert notebook.startswith("# Ten everyday things\n")
    assert "<svg" not in notebook
    wrong = forked.run(["docs", "how-to/effect"])
    assert wrong.returncode == 2
    assert "how-to/effects" in wrong.stderr


def test_a_wheel_has_the_pages_where_the_command_looks_for_them(tmp_path, monkeypatch):
    """The place of the pages in a wheel, as pyproject.toml says it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    place = project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]["docs"]
    installed = tmp_path / place
    shutil.copytree(ROOT / "docs", installed)
    monkeypatch.setattr(shipped, "_PACKAGE", tmp_path / "s2r_spec")
    assert documentation.folder() == installed
    assert len(documentation.pages(installed)) == len(PAGES)


FENCE = re.compile(r"^( *)```.*?^\1```", re.S | re.M)
AMOUNT = re.compile(
    r"(?<![\w.])\d[\d,.]*\s(?:ns|µs|ms|s|min|minutes|seconds|hours|kB|KiB|MB|MiB|GB|rollouts?|bytes)\b"
)
MEASURED = re.compile(r"\b(takes?|took|costs?|median|processor time|of a core|MB|MiB|GB)\b")
COMMAND = re.compile(r"\b(?:python (?:-m )?[\w./]+|s2r [a-z]+|benchmarks/[\w./]+|pip install)")


def unfounded(page: str) -> list[str]:
    """Return the sentences that say what something takes, in sections that name no command.

    A number beside a word such as "takes" is a measurement; one without it may be a definition, and is not looked at.
    """
    found = []
    for section in re.split(r"(?m)^(?=## )", page):
        if COMMAND.search(section):
            continue
        for sentence in re.split(r"(?<=[.:|])\s+|\n\n", FENCE.sub("", section)):
            if AMOUNT.search(sentence) and MEASURED.search(sentence):
                found.append(sentence)
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_something_takes_stands_beside_a_command(page):
    assert not unfounded(documentation.read(page))


def test_a_cost_without_a_command_is_noticed():
    page = "# A page\n\nA robot waits for 2 s.\n\n## Speed\n\nA rollout takes 0.1 s. It is quick.\n"
    assert unfounded(page) == ["A rollout takes 0.1 s."]
    assert not unfounded(page + "`python -m benchmarks.a1.speed` prints it.\n")


def test_every_picture_is_shown_and_is_drawn_by_the_command():
    pages = [*(path for path in PAGES if path.suffix == ".md"), ROOT / "README.md"]
    shown = {name for page in pages for name in re.findall(r"pictures/([\w-]+)\.svg", page.read_text())}
    files = {path.stem: path.stat().st_size for path in (ROOT / "docs" / "pictures").glob("*.svg")}
    commands = (ROOT / "docs" / "pictures.py").read_text()
    assert shown == set(files) == set(re.findall(r'^    "([\w-]+)": \w+,$', commands, re.M))
    assert sum(files.values()) <= 400_000


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_code_fits_the_width_of_the_site(page):
    for code in re.findall(r"^```(?:python|stl)\n(.*?)^```", documentation.read(page), re.S | re.M):
        assert max(map(len, code.splitlines())) <= 88, code


def test_every_benchmark_that_a_page_names_exists():
    named = {name for page in PAGES for name in re.findall(r"\bbenchmarks/[\w./*]+\w", page.read_text())}
    assert len(named) > 10
    commands = {name for page in PAGES for name in re.findall(r"-m (benchmarks(?:\.\w+)+)", page.read_text())}
    assert len(commands) > 10
    for name in named | {name.replace(".", "/") + ".py" for name in commands}:
        assert any(ROOT.glob(name)), name


def test_the_answers_to_where_things_are_exist():
    page = (ROOT / "docs" / "explanation" / "where-things-are.md").read_text()
    folders, answers = page.split("## Twelve questions")
    rows = re.findall(r"^\| Where .*?\? \| (.*) \|$", answers, re.M)
    assert len(rows) == 12
    for place in re.findall(r"`([\w./]+/[\w./]+)`", folders + answers):
        assert (ROOT / place).exists(), place
    for row in rows:
        file, _, names = row.partition("`: ")
        for name in re.findall(r"`(\w+)`", names):
            tree = ast.parse((ROOT / file.strip("`")).read_text())
            defined = {getattr(node, "name", None) for node in tree.body}
            defined |= {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
            assert name in defined, row


def test_no_page_has_the_marks_of_a_merge():
    pages = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("benchmarks/**/*.md")]
    assert len(pages) > 30
    marked = [page for page in pages if re.search(r"^(<{7}|={7}|>{7})( |$)", page.read_text(), re.MULTILINE)]
    assert not marked
