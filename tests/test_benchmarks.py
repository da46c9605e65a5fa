"""Committed benchmarks are run on demand; what they import is there all the same."""

import ast
import importlib
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
REPORT = """<testsuites><testsuite name="pytest" tests="3" time="2.5">
<testcase classname="tests.cli.test_check" name="test_a[x.y-1]" time="1.25"/>
<testcase classname="tests.certify.test_search.TestRefusals" name="test_b" time="2.0"/>
<testcase classname="tests.cli.test_check" name="test_c" time="0.5"/>
</testsuite></testsuites>"""
OURS = ("s2r_spec", "s2r_a1", "s2r_sim", "s2r_emps", "s2r_turtlebot", "benchmarks")


def test_the_time_of_the_suite_is_told_by_folder(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    suite_time = importlib.import_module("suite_time")
    (tmp_path / "suite.xml").write_text(REPORT)
    found = suite_time.times(tmp_path / "suite.xml")
    assert [(file, seconds) for file, _, seconds in found] == [
        ("tests/cli/test_check.py", 1.25),
        ("tests/certify/test_search.py", 2.0),
        ("tests/cli/test_check.py", 0.5),
    ]
    lines = suite_time.table(found, 2.5).splitlines()
    assert lines[0].startswith("3 tests, 4 s in them")
    assert [line.split()[-1] for line in lines[3:5]] == ["tests/certify", "tests/cli"]
    assert [line.split()[:2] for line in lines[3:5]] == [["2.0", "53"], ["1.8", "47"]]


@pytest.mark.parametrize(
    "path", sorted(BENCHMARKS.rglob("*.py")), ids=lambda path: str(path.relative_to(BENCHMARKS))
)
def test_what_a_benchmark_imports_is_there(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.ImportFrom) or not node.module or node.module.split(".")[0] not in OURS:
            continue
        module = importlib.import_module(node.module)
        for name in (alias.name for alias in node.names):
            inside = Path(module.__file__).parent / name
            assert hasattr(module, name) or inside.with_suffix(".py").exists() or inside.is_dir(), (
                node.module,
                name,
            )
