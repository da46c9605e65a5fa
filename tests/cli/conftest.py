from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import jsonschema
import pytest

from s2r_spec.json_objects.schema import schema
from tests import forked

SPEC = """\
signal vx {m/s}
param  vd {m/s} in [-0.2, 0.3]
require walking: always[0.5 s, 1.5 s] (abs(vx - vd) <= LIMIT {m/s})
certify walking: delta = 1e-3, epsilon = 0.1, B = 0.5, R = 0.02, kernel = rbf(0.2 {m/s}), fall = -0.5
"""
FINE = SPEC.replace("epsilon = 0.1", "epsilon = 0.05")
"""Four times as many rollouts: for what depends on how narrow an interval is."""


_schema = cache(schema)


class CommandLine:
    """Runs the installed ``s2r`` in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def spec(self, limit: float = 0.1, text: str = SPEC) -> str:
        path = self.folder / "spec.stl"
        path.write_text(text.replace("LIMIT", str(limit)))
        return path.name

    def command(self, *words: object) -> list[str]:
        """Return what a user's shell would start: for what is killed, or whose pipes matter."""
        return [sys.executable, "-m", "s2r_spec", *map(str, words)]

    def __call__(self, *words: object, code: int | None = None) -> subprocess.CompletedProcess[str]:
        done = forked.run([*map(str, words)], self.folder)
        assert code is None or done.returncode == code, done.stderr + done.stdout
        return done

    def json(self, *words: object, code: int) -> dict:
        """Return the one object on stdout, which is what its schema says."""
        found = json.loads(self(*words, "--json", code=code).stdout)
        jsonschema.validate(found, _schema(found["schema"]))
        return found


@pytest.fixture
def s2r(tmp_path, toy, monkeypatch) -> CommandLine:
    monkeypatch.setenv("COLUMNS", "100")
    return CommandLine(tmp_path)


@contextmanager
def waiting(s2r: CommandLine, *words: object, **more: object) -> Iterator[subprocess.Popen]:
    """Start a command as a user does, whose rollouts of ``toy:waits`` wait until the end of the block."""
    stop = s2r.folder / "waits"
    stop.touch()
    environment = os.environ | {"S2R_TOY_WAITS": str(stop)}
    process = subprocess.Popen(s2r.command(*words), cwd=s2r.folder, env=environment, **more)
    try:
        yield process
    finally:
        stop.unlink()
        process.wait(300)


def rollouts_in(journal: Path) -> int:
    """Return how many rollouts a journal has, which may not be there yet."""
    return journal.read_bytes().count(b"\n") - 1 if journal.exists() else 0
