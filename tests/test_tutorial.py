"""The tutorial does what it says: its files are written, its commands run, its outputs compared."""

import re
from pathlib import Path

import pytest

from tests import forked

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "tutorials" / "own-backend.md").read_text()
FILES = dict(re.findall(r"<!-- file: (\S+) -->\n```\w*\n(.*?)```", PAGE, re.S))
OUTPUTS = dict(re.findall(r"<!-- output of: s2r (.*?) -->\n```text\n(.*?)```", PAGE, re.S))


@pytest.fixture
def reader(tmp_path, monkeypatch):
    """The folder of a reader after the first two sections."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)


def numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"[-+]?\d+\.\d+", text)]


def test_the_pilot_prints_what_is_shown(reader, capsys):
    code = re.search(r"```python\n(import numpy as np\nimport s2r_spec.*?)```", PAGE, re.S)[1]
    exec(code, {})
    shown = re.search(r"<!-- printed -->\n```text\n(.*?)```", PAGE, re.S)[1]
    assert numbers(capsys.readouterr().out) == pytest.approx(numbers(shown), abs=2e-4)


@pytest.mark.parametrize("command", OUTPUTS)
def test_the_commands_print_what_is_shown(reader, command):
    done = forked.run([*command.split(), "--workers", "1", "--quiet"])
    assert done.returncode == 0, done.stderr
    shown = [text for text in OUTPUTS[command].splitlines() if text.strip() and "…" not in text]
    assert shown[0] == done.stdout.splitlines()[0]
    for text in shown:
        label = text[:20]
        there = [other for other in done.stdout.splitlines() if other.startswith(label)]
        if "effort" in label:  # its seconds are the machine's
            text, there = text.rpartition(",")[0], [other.rpartition(",")[0] for other in there]
        # On another processor the last digit may differ.
        assert any(
            re.sub(r"\d+\.\d+", "#", other) == re.sub(r"\d+\.\d+", "#", text)
            and numbers(other) == pytest.approx(numbers(text), abs=2e-4)
            for other in there
        ), text


@pytest.mark.parametrize("options", ["broken", "wron", "worn "])
def test_an_option_that_the_lift_does_not_have_is_refused(reader, options):
    done = forked.run(["check", "lift.stl", "--backend", f"lift.py:Lift:{options}", "--quiet"])
    assert done.returncode == 2
    assert repr(options) in done.stderr
