"""Each test has a folder of its own, and forgets the Python files that other tests loaded."""

from __future__ import annotations

import sys

import pytest

from s2r_spec.backend import files
from tests.cli.conftest import CommandLine


@pytest.fixture
def nothing_loaded(monkeypatch):
    """Forget the Python files of other tests, and those of this one at its end."""
    for name in ("_PLACES", "_DIGESTS", "_CONTENTS"):
        monkeypatch.setattr(files, name, {})
    monkeypatch.setattr(sys, "path", [*sys.path])
    before = {*sys.modules}
    yield
    for name in {*sys.modules} - before:
        if "/pytest-of-" in (getattr(sys.modules[name], "__file__", None) or ""):
            del sys.modules[name]


@pytest.fixture
def s2r(tmp_path, nothing_loaded, monkeypatch):
    """Run the command line in a folder, in which this process is, too."""
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.chdir(tmp_path)
    return CommandLine(tmp_path)
