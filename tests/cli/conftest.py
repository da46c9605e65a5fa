from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path

import jsonschema
import pytest

from s2r_spec.report.records.schema import schema
from tests import forked

SPEC = """\
signal vx {m/s}
param  vd {m/s} in [-0.2, 0.3]
require walking: always[0.5 s, 1.5 s] (abs(vx - vd) <= LIMIT {m/s})
certify walking: delta = 1e-3, epsilon = 0.1, B = 0.5, R = 0.02, kernel = rbf(0.2 {m/s}), fall = -0.5
"""
FINE = SPEC.replace("epsilon = 0.1", "epsilon = 0.05")
"""Four times as many rollouts: for what depends on how narrow an interval is."""


@cache
def _validator(name: str) -> jsonschema.protocols.Validator:
    """Return what holds objects against a schema, which is checked once."""
    of = schema(name)
    kind = jsonschema.validators.validator_for(of)
    kind.check_schema(of)
    return kind(of)


class CommandLine:
    """Runs the installed ``s2r`` in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def spec(self, limit: float = 0.1, text: str = SPEC) -> str:
        path = self.folder / "spec.stl"
        path.write_text(text.replace("LIMIT", str(limit)))
        return path.name

    def command(self, *words: object) -> list[str]:
        """Return what a user's shell would start: for a command whose pipes matter."""
        return [sys.executable, "-m", "s2r_spec", *map(str, words)]

    def __call__(self, *words: object, code: int | None = None) -> subprocess.CompletedProcess[str]:
        done = forked.run([*map(str, words)], self.folder)
        assert code is None or done.returncode == code, done.stderr + done.stdout
        return done

    def json(self, *words: object, code: int) -> dict:
        """Return the one object on stdout, which is what its schema says."""
        found = json.loads(self(*words, "--json", code=code).stdout)
        _validator(found["schema"]).validate(found)
        return found


@pytest.fixture
def s2r(tmp_path, toy, monkeypatch) -> CommandLine:
    monkeypatch.setenv("COLUMNS", "100")
    return CommandLine(tmp_path)


@contextmanager
def held_rollouts(s2r: CommandLine) -> Iterator[None]:
    """Let the rollouts of ``toy:waits`` wait until the end of the block, in commands that start inside it."""
    stop = s2r.folder / "waits"
    stop.touch()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("S2R_TOY_WAITS", str(stop))
        try:
            yield
        finally:
            stop.unlink()


@contextmanager
def waiting(s2r: CommandLine, *words: object) -> Iterator[forked.Command]:
    """Start a command whose rollouts of ``toy:waits`` wait until the end of the block; then let it finish."""
    with ExitStack() as held:
        held.enter_context(held_rollouts(s2r))
        with forked.started([*map(str, words)], s2r.folder) as command:
            yield command
            held.close()
            command.finish()


def rollouts_in(journal: Path) -> int:
    """Return how many rollouts a journal has, which may not be there yet."""
    return journal.read_bytes().count(b"\n") - 1 if journal.exists() else 0
