"""Finds which tests run which lines, by Coverage, and how long each test takes.

A test that runs a line may catch a fault in it; no other can. What a fixture of a module runs counts for all tests of
its file. What an import runs, such as a constant, counts for all tests: they may read it without running a line. So
does a function whose results are kept.
"""

from __future__ import annotations

import ast
import json
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest


@dataclass(frozen=True)
class Reach:
    """What the tests run.

    Attributes:
        seconds: of every test that passes.
        failed: the tests that do not, with no fault in the modules.
        lines: (module, line) → contexts, each a test's name, ``|`` and its phase.
    """

    seconds: dict[str, float]
    failed: list[str]
    lines: dict[str, dict[int, list[str]]]

    def tests(self, module: str, code: str, line: int) -> list[str]:
        """Return the tests that run the statement of a line, the fastest first; none where no test does."""
        contexts = self.lines.get(module, {})
        if remembered(code, line):
            return self.anywhere()
        first, last = statement(code, line)
        here = {context for row in range(first, last + 1) for context in contexts.get(row, ())}
        return self._named(here) if here != {""} else self.anywhere()

    def anywhere(self) -> list[str]:
        """Return all tests, the fastest first."""
        return sorted(self.seconds, key=lambda name: (self.seconds[name], name))

    def _named(self, here: set[str]) -> list[str]:
        names = {context.split("|")[0] for context in here if context}
        files = {context.split("::")[0] for context in here if context.endswith("|setup")}
        names |= {name for name in self.seconds if name.split("::")[0] in files}
        return sorted(names & self.seconds.keys(), key=lambda name: (self.seconds[name], name))


def remembered(code: str, line: int) -> bool:
    """Return whether a line is in a function whose results are kept: only the first test to ask for one runs it."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.FunctionDef) and node.lineno <= line <= (node.end_lineno or line):
            names = {ast.unparse(one).partition("(")[0].rpartition(".")[2] for one in node.decorator_list}
            if names & {"cache", "lru_cache", "cached_property", "once"}:
                return True
    return False


def statement(code: str, line: int) -> tuple[int, int]:
    """Return the first and the last line of the innermost statement around a line, of a compound one the head."""
    best = (line, line)
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.stmt):
            body = getattr(node, "body", None)
            end = (
                max(node.lineno, body[0].lineno - 1)
                if isinstance(body, list)
                else node.end_lineno or node.lineno
            )
            if node.lineno <= line <= end:
                best = (node.lineno, end)
    return best


class Recorder:
    """A plugin of pytest that says which test runs, and keeps the CPU seconds of the ones that pass."""

    def __init__(self, coverage: Any) -> None:
        self._coverage = coverage
        self._seconds: dict[str, float] = defaultdict(float)
        self._failed: set[str] = set()

    def _timed(self, item: pytest.Item, phase: str) -> Any:
        self._coverage.switch_context(f"{item.nodeid}|{phase}")
        began = time.process_time()
        result = yield
        self._seconds[item.nodeid] += time.process_time() - began
        return result

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Any:
        return (yield from self._timed(item, "setup"))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Any:
        return (yield from self._timed(item, "call"))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if not report.passed:
            self._failed.add(report.nodeid)

    @property
    def failed(self) -> list[str]:
        return sorted(self._failed)

    def passed(self) -> dict[str, float]:
        return {name: seconds for name, seconds in self._seconds.items() if name not in self._failed}


def record(folder: Path, modules: Sequence[str], options: Sequence[str], to: Path) -> None:
    """Run tests in this process, and write what they run of the modules of a folder."""
    from coverage import Coverage

    coverage = Coverage(
        data_file=None, include=[str(folder / module) for module in modules], config_file=False
    )
    recorder = Recorder(coverage)
    coverage.start()
    pytest.main(list(options), plugins=[recorder])
    coverage.stop()
    data = coverage.get_data()
    lines = {
        module: {
            str(line): sorted(found) for line, found in data.contexts_by_lineno(str(folder / module)).items()
        }
        for module in modules
    }
    to.write_text(json.dumps({"seconds": recorder.passed(), "failed": recorder.failed, "lines": lines}))


def read(file: Path) -> Reach:
    """Return what :func:`record` wrote."""
    found = json.loads(file.read_text())
    lines = {
        module: {int(line): names for line, names in rows.items()} for module, rows in found["lines"].items()
    }
    return Reach(found["seconds"], found["failed"], lines)
