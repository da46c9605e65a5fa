"""The shipped specifications and traces as files of the user."""

import json

import pytest

from tests import forked
from tests.errors import states


def test_nothing_is_written_where_one_file_exists(tmp_path):
    (tmp_path / "specs" / "traces").mkdir(parents=True)
    mine = tmp_path / "specs" / "traces" / "a1_velocity_fails.csv"
    mine.write_text("mine")
    done = forked.run(["examples", "--json"], tmp_path)
    assert done.returncode == json.loads(done.stdout)["exit_code"] == 2
    assert states(done.stderr, "specs/traces/a1_velocity_fails.csv", "FOLDER")
    assert [path for path in (tmp_path / "specs").rglob("*") if path.is_file()] == [mine]
    assert mine.read_text() == "mine"


@pytest.mark.parametrize("folder", ["file", "file/below"])
def test_a_file_is_no_folder_for_examples(folder, tmp_path):
    (tmp_path / "file").touch()
    done = forked.run(["examples", folder], tmp_path)
    assert done.returncode == 2
    assert states(done.stderr, folder)


def test_the_printed_command_evaluates_a_written_trace(tmp_path):
    done = forked.run(["examples", "a folder"], tmp_path)
    assert done.returncode == 0
    assert all((tmp_path / name).is_file() for name in done.stdout.splitlines())
    assert "s2r monitor 'a folder/a1_velocity.stl' 'a folder/traces/a1_velocity_fails.csv'" in done.stderr
