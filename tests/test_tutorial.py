"""The tutorial does what it says: its files are written, its commands run, its outputs compared."""

import re
import tomllib
from pathlib import Path

import pytest

from s2r_spec.backend import registry
from s2r_spec.errors import UsageError
from s2r_spec.runs import task
from tests import forked

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "tutorials" / "own-backend.md").read_text()
FILES = dict(re.findall(r"<!-- file: (\S+) -->\n```\w*\n(.*?)```", PAGE, re.S))
OUTPUTS = dict(re.findall(r"<!-- output of: s2r (.*?) -->\n```text\n(.*?)```", PAGE, re.S))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What a reader has after the first two sections; what pip would note of the entry point is written by hand."""
    place = tmp_path_factory.mktemp("lift")
    for name, text in FILES.items():
        (place / name).write_text(text)
    project = tomllib.loads(FILES["pyproject.toml"])["project"]
    about = place / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    (about / "entry_points.txt").write_text(
        "".join(
            f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, value in points.items())
            for group, points in project["entry-points"].items()
        )
    )
    return place


@pytest.fixture
def installed(folder, monkeypatch):
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=":")
    monkeypatch.chdir(folder)
    for cached in (registry._factory, task.open_backend):
        cached.cache_clear()
    yield folder
    for cached in (registry._factory, task.open_backend):
        cached.cache_clear()


def numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"[-+]?\d+\.\d+", text)]


def test_the_pilot_prints_what_is_shown(installed, capsys):
    code = re.search(r"```python\n(import numpy.*?)```", PAGE, re.S)[1]
    exec(code, {})
    shown = re.search(r"<!-- printed -->\n```text\n(.*?)```", PAGE, re.S)[1]
    assert numbers(capsys.readouterr().out) == pytest.approx(numbers(shown), abs=2e-4)


@pytest.mark.parametrize("command", OUTPUTS)
def test_the_commands_print_what_is_shown(installed, command):
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
def test_an_option_that_the_lift_does_not_have_is_refused(installed, options):
    done = forked.run(["check", "lift.stl", "--backend", f"lift:{options}", "--quiet"])
    assert done.returncode == 2
    assert repr(options) in done.stderr


def test_a_parameter_that_the_lift_does_not_have_is_refused(installed):
    lift = registry.load_backend("lift")
    for test in ({"laod": 100.0}, {"load": 100.0, "people": 2.0}, {"load": "heavy"}, {"load": 1e4}):
        with pytest.raises(UsageError, match=next(reversed(test))):
            lift.rollout(test, 0)
