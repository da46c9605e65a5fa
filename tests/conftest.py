"""Shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from s2r_spec import backend
from s2r_spec.rollouts import runner

PLUGIN = Path(__file__).parent / "plugin"


@pytest.fixture
def toy(monkeypatch):
    """Another package's backends, installed for this test and for the workers it starts."""
    monkeypatch.syspath_prepend(str(PLUGIN))
    monkeypatch.setenv("PYTHONPATH", str(PLUGIN), prepend=os.pathsep)
    for cached in (backend._factory, runner.open_backend):
        cached.cache_clear()
    yield
    for cached in (backend._factory, runner.open_backend):
        cached.cache_clear()
