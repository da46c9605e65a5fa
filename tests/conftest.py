"""Shared by all tests."""

from __future__ import annotations

import gc
import json
import math
import os
import signal
import sys
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

# The tests are the parallelism: threads beside them wait for each other, and cost a quarter of all time.
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")
# Hundreds of processes import the package: where none may keep its bytecode, each compiles it anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

from s2r_spec.backend import registry  # noqa: E402
from s2r_spec.runs import lines, repeatability, task  # noqa: E402
from s2r_spec.runs.journal import FILE  # noqa: E402
from tests import forked  # noqa: E402
from tests.processes import lives  # noqa: E402

settings.register_profile("again", derandomize=True)
if "S2R_EXAMPLES" not in os.environ:
    settings.load_profile("again")  # the same examples every time: what passed here passes on a new machine

PLUGIN = Path(__file__).parent / "plugin"
sys.path.append(str(PLUGIN))
RUN_AFRESH = repeatability.run_afresh
TIMES = Path(__file__).parents[1] / "benchmarks" / "results" / "suite_time.json"
"""Seconds of every file of tests, as ``tests/suite_time.py`` counted them."""


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, Any, Any]:
    """Collect no garbage while tests are collected, for hardly anything is: looking for it took a third of the time.

    Nor is any looked for later in what was collected: it stays to the end.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the slowest files first, so that all of xdist's workers end together; a new file is among the first."""
    seconds = json.loads(TIMES.read_text())["files"] if TIMES.exists() else {}
    items.sort(key=lambda item: -seconds.get(item.nodeid.split("::")[0], math.inf))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give a file to one worker, whose fixtures it then makes once, and files in the order of collection."""
    from xdist.scheduler import LoadFileScheduling

    if config.getvalue("dist") != "load":
        return None  # as somebody asked
    config.option.loadscopereorder = False
    return LoadFileScheduling(config, log)


@pytest.fixture(scope="session", autouse=True)
def no_waiting_for_the_disk() -> Generator[None, None, None]:
    """Let no test wait until the disk has what was written: none pulls the plug, and each wait takes milliseconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def new_processes_are_forks() -> Generator[None, None, None]:
    """Repeat the rollout of a run in a fork: a new interpreter imports for longer than most runs take."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(repeatability, "run_afresh", forked.Afresh())
        yield


@pytest.fixture
def new_interpreters(monkeypatch):
    """Repeat the rollout of a run as a user's run does, in a new interpreter."""
    monkeypatch.setattr(repeatability, "run_afresh", RUN_AFRESH)


@pytest.fixture(scope="session")
def cache(tmp_path_factory):
    """The folder of response libraries: they are made once for all tests, and for all of xdist's workers."""
    own = tmp_path_factory.getbasetemp()
    return (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "cache"


@pytest.fixture
def toy(monkeypatch):
    """Another package's backends, installed for this test and for the workers it starts."""
    monkeypatch.syspath_prepend(str(PLUGIN))
    monkeypatch.setenv("PYTHONPATH", str(PLUGIN), prepend=os.pathsep)
    for cached in (registry._factory, task.open_backend):
        cached.cache_clear()
    yield
    for cached in (registry._factory, task.open_backend):
        cached.cache_clear()


def rewrite(run: Path, change: Callable[[dict], dict]) -> None:
    """Write a run's journal again with every line changed and the checksums right: as another run would have been."""
    written, checksum = [], 0
    for text in (run / FILE).read_text().splitlines():
        kept = {key: value for key, value in json.loads(text).items() if key != "crc32"}
        line, checksum = lines.encode(change(kept), checksum)
        written.append(line + b"\n")
    (run / FILE).write_bytes(b"".join(written))


@pytest.fixture
def noted(tmp_path, monkeypatch):
    """Return what the rollouts note of their processes; whatever a failed test leaves is killed."""
    file = tmp_path / "noted"
    file.touch()
    monkeypatch.setenv("S2R_FORKS", str(file))

    def read():
        return [tuple(map(int, line.split())) for line in file.read_text().splitlines()]

    yield read
    for pid, _ in read():
        if lives(pid):
            os.kill(pid, signal.SIGKILL)
