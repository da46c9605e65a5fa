"""The pages on the A1 itself say what the code does, and what they show to type can be typed."""

import re
import shlex
from pathlib import Path

import pytest

from benchmarks.a1 import hardware_tables
from s2r_a1.guard import __main__ as guard
from s2r_a1.options import NAMES, read_options
from s2r_a1.twin.options import read_options as read_twin

ROOT = Path(__file__).parents[2]
HOW_TO, REFERENCE, EXPLANATION = PAGES = tuple(
    ROOT / "docs" / name
    for name in ("how-to/hardware.md", "reference/a1-robot.md", "explanation/a1-hardware.md")
)
TEXT = "\n".join(page.read_text() for page in PAGES)


def commands(program):
    """The arguments of every command of a program that the pages show."""
    lines = re.findall(rf"^ *{re.escape(program)}(?: (.*))?$", HOW_TO.read_text(), re.M)
    return [shlex.split(line, comments=True) for line in lines]


def test_the_tables_are_the_codes():
    made = hardware_tables
    named = re.findall(r"<!-- table: (\w+) -->", TEXT)
    assert sorted(named) == sorted(made.TABLES)
    for page in (HOW_TO, REFERENCE):
        assert page.read_text() == made.with_tables(page.read_text()), (
            "run: python -m benchmarks.a1.hardware_tables --write"
        )


def test_a_table_of_another_figure_would_be_noticed():
    page = HOW_TO.read_text()
    changed = page.replace("0.5 rad", "0.6 rad")
    assert changed != page
    assert hardware_tables.with_tables(changed) == page


def test_the_options_of_a_robot_are_all_there():
    table = REFERENCE.read_text().split("## Options")[1].split("## ")[0]
    assert sorted(re.findall(r"^\| `(\w+)` \|", table, re.M)) == sorted(NAMES)


def test_every_robot_that_is_named_can_be_reached_so():
    named = re.findall(r"\ba1:([\w.=,:-]+)", TEXT)
    assert len(named) > 5
    for options in named:
        read_options(options)


def test_every_command_of_a_twin_can_be_typed():
    shown = commands("python -m s2r_a1.twin")
    assert len(shown) > 5
    for arguments in shown:
        read_twin(arguments)


@pytest.mark.parametrize("arguments", commands("python -m s2r_a1.guard"), ids=" ".join)
def test_every_command_of_a_guard_can_be_typed(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("S2R_A1_RUN", str(tmp_path))
    assert guard.main(arguments) == 4  # none lives, and the command is one
    assert len(capsys.readouterr().err.splitlines()) == 1
