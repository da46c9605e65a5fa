"""Messages name pages that exist, by an address that a reader of a wheel can use."""

import ast
from email.message import Message
from pathlib import Path

import pytest

from s2r_spec import documentation

ROOT = Path(__file__).parents[1]
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
    monkeypatch.setattr(documentation, "metadata", lambda name: about)
    assert documentation.page("how-to/effects") == "page how-to/effects of the documentation"
    documentation._address.cache_clear()
    about["Project-URL"] = "Documentation, https://example.org/s2r/"
    assert documentation.page("how-to/effects") == "https://example.org/s2r/how-to/effects.html"
