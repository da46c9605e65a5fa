"""A file is replaced whole, or it is as it was."""

import os
import resource
import signal
import stat
import sys

import numpy as np
import pytest

from benchmarks.blind.protocol.hashes import write_json
from s2r_spec import logs
from s2r_spec.base import files
from s2r_spec.errors import UsageError
from s2r_spec.runs import patched
from s2r_spec.trace import Trace
from tests.errors import naming


@pytest.fixture
def target(tmp_path):
    path = tmp_path / "kept.stl"
    path.write_text("old\n")
    return path


@pytest.fixture
def small_disk(monkeypatch):
    """No file may grow beyond 100 bytes, as on a disk that is nearly full."""
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # Python would cut it, and say nothing
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handled = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handled)


def trace():
    return Trace(np.arange(100.0), {"v": np.random.default_rng(0).normal(size=100)})


WRITERS = {
    "text": lambda path: files.save(path, "x" * 1000),
    "bytes": lambda path: files.save(path, b"x" * 1000),
    "patched": lambda path: patched.write(path, "sim", {"e" * 500: {"p": 1.0}}),
    "manifest": lambda path: write_json(path, {"answer": "x" * 1000}),
}


@pytest.mark.parametrize("ending", logs.FORMATS)
def test_a_full_disk_leaves_the_old_trace(tmp_path, small_disk, ending):
    path = tmp_path / f"kept{ending}"
    path.write_bytes(b"old")
    with pytest.raises(UsageError, match=naming(str(path))):
        logs.write(trace(), path)
    assert path.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == [f"kept{ending}"]


@pytest.mark.parametrize("writer", WRITERS)
def test_a_full_disk_leaves_the_old_file_and_nothing_beside_it(target, small_disk, writer):
    with pytest.raises(UsageError, match=r"kept\.stl"):
        WRITERS[writer](target)
    assert target.read_text() == "old\n"
    assert [path.name for path in target.parent.iterdir()] == ["kept.stl"]


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_disk_that_fails_at_the_end_leaves_the_old_file(target, monkeypatch, call):
    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, call, fail)
    with pytest.raises(UsageError, match="No space left"):
        files.save(target, "new\n")
    assert target.read_text() == "old\n"
    assert [path.name for path in target.parent.iterdir()] == ["kept.stl"]


def test_a_writer_that_raises_leaves_the_old_file(target):
    def write():
        with files.saving(target) as beside:
            beside.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write()
    assert target.read_text() == "old\n"
    assert [path.name for path in target.parent.iterdir()] == ["kept.stl"]


def test_what_is_written_beside_has_the_ending_that_a_format_is_chosen_by(target):
    with files.saving(target) as beside:
        assert (beside.suffix, beside.parent) == (target.suffix, target.parent)
        beside.write_text("new\n")
    assert target.read_text() == "new\n"


def test_permissions_stay_and_a_new_file_has_those_of_any_new_file(target):
    os.chmod(target, 0o640)
    files.save(target, "new\n")
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    before = os.umask(0o027)
    try:
        files.save(target.with_name("fresh.txt"), "new\n")
    finally:
        os.umask(before)
    assert stat.S_IMODE(target.with_name("fresh.txt").stat().st_mode) == 0o640


def test_a_link_stays_one_and_its_file_is_replaced(tmp_path, target):
    link = tmp_path / "link.stl"
    link.symlink_to(target.name)
    files.save(link, "new\n")
    assert link.is_symlink()
    assert target.read_text() == "new\n"


def test_what_is_no_file_is_written_to(tmp_path):
    files.save(tmp_path / "out", "")  # only to have a folder with one entry
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    files.save(tmp_path / "pipe", "through\n")
    assert os.read(reader, 100) == b"through\n"
    os.close(reader)
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


def test_a_folder_that_is_not_there_is_one_sentence(tmp_path):
    with pytest.raises(UsageError, match=naming(str(tmp_path / "nowhere"))):
        files.save(tmp_path / "nowhere" / "a.txt", "new\n")


def test_a_name_that_is_no_utf8_can_be_written(tmp_path):
    files.save(tmp_path / "a.txt", "caf\udce9\n")
    assert (tmp_path / "a.txt").read_bytes() == b"caf\\udce9\n"
