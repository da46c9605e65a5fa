"""Shared by all tests."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

# The tests are the parallelism: threads beside them wait for each other, and cost a quarter of all time.
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

from s2r_spec import backend  # noqa: E402
from s2r_spec.rollouts import lines, runner  # noqa: E402
from s2r_spec.rollouts.journal import FILE  # noqa: E402

PLUGIN = Path(__file__).parent / "plugin"
sys.path.append(str(PLUGIN))


@pytest.fixture(scope="session")
def cache(tmp_path_factory):
    """Where banks and judges are kept: made once for all tests, and for all of xdist's workers."""
    own = tmp_path_factory.getbasetemp()
    return (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "cache"


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


def rewrite(run: Path, change: Callable[[dict], dict]) -> None:
    """Write a run's journal again with every line changed and the checksums right: as another run would have been."""
    written, checksum = [], 0
    for text in (run / FILE).read_text().splitlines():
        kept = {key: value for key, value in json.loads(text).items() if key != "crc32"}
        line, checksum = lines.written(change(kept), checksum)
        written.append(line + b"\n")
    (run / FILE).write_bytes(b"".join(written))
