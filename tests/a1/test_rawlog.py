"""The raw recording: what is written is read, up to the last whole block, whatever happens."""

import errno
import os
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from s2r_a1 import rawlog
from s2r_a1.rawlog import BLOCK, MAGIC, RawLogError, RawLogWriter, read
from s2r_spec.errors import TraceError
from tests.examples import examples
from tests.processes import until

ROUND = 2_000_000  # ns
HEADER = {"host": "127.0.0.1", "layout": "A1", "note": "Grüße\nan alle"}


def packets(rounds, sizes=(771, 610)):
    return [
        (k * ROUND, direction, bytes([k % 256]) * sizes[direction])
        for k in range(rounds)
        for direction in (1, 0)
    ]


def record(path, given):
    writer = RawLogWriter(path, HEADER)
    for one in given:
        writer.append(*one)
    return writer


def contents(log):
    return list(zip(log.times.tolist(), log.directions.tolist(), log.packets, strict=True))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "rollout.a1log"


def test_what_is_recorded_is_read(path):
    given = packets(237)
    written = record(path, given).close()
    log = read(path)
    assert contents(log) == given
    assert log.header == HEADER
    assert log.finished
    assert (written.path, written.packets, written.bytes) == (path, len(given), path.stat().st_size)


def test_a_recording_may_be_empty_and_its_packets_too(path, tmp_path):
    record(path, []).close()
    assert read(path).packets == ()
    assert read(path).finished
    given = [(0, 0, b""), (2**64 - 1, 1, bytes(65_535))]
    record(tmp_path / "two", given).close()
    assert contents(read(tmp_path / "two")) == given


@given(
    given=st.lists(
        st.tuples(st.integers(0, 2**64 - 1), st.integers(0, 1), st.binary(max_size=30)), max_size=30
    )
)
@settings(max_examples=examples(50), deadline=None)
def test_any_packets_are_read_as_they_were(tmp_path_factory, given):
    path = tmp_path_factory.mktemp("log") / "one"
    record(path, given).close()
    assert contents(read(path)) == given


def test_events_are_read_beside_the_packets_and_each_is_given_to_the_disk_at_once(path):
    events = [{"event": "state", "state": "WALK"}, {"event": "state", "state": "DAMPING", "reason": "größer"}]
    writer = record(path, packets(3))
    for number, event in enumerate(events):
        writer.note(7 + number, event)
    writer.note(9, {"reason": "x" * 70_000})  # no record holds it
    assert writer.wait_ready(60)
    until(lambda: len(read(path).events) == 2)
    log = read(path)
    assert log.events == tuple({**event, "time": 7 + n} for n, event in enumerate(events))
    assert contents(log) == packets(3)
    assert not log.finished  # as after a kill
    written = writer.close()
    assert (written.packets, read(path).finished) == (6, True)


def test_a_recording_that_goes_on_is_read_up_to_its_last_block(path):
    """What a kill leaves is what the file holds now: blocks of 100 ms, and no end."""
    given = packets(130)
    writer = record(path, given)
    whole = 2 * BLOCK // ROUND * 2  # two blocks of 50 rounds, both ways
    assert writer.wait_ready(60)
    until(lambda: len(read(path).packets) >= whole)
    log = read(path)
    assert contents(log) == given[:whole]
    assert not log.finished
    writer.flush()
    writer.close()
    assert contents(read(path)) == given


SMALL = (30, 20)  # bytes of packets where every byte is tried


def cut(path, tmp_path):
    """Return a recording of two blocks, and where its last one begins."""
    record(path, packets(53, SMALL)).close()
    data = path.read_bytes()
    start = len(data) - 8 - (8 + 6 * 11 + 3 * sum(SMALL))
    return data, start, tmp_path / "cut"


def test_a_cut_at_any_byte_of_the_last_block_costs_that_block_only(path, tmp_path):
    data, start, short = cut(path, tmp_path)
    with short.open("wb") as file:
        file.write(data)
    for place in range(len(data) - 8, start - 1, -1):
        os.truncate(short, place)
        log = read(short)
        assert len(log.packets) == (106 if place == len(data) - 8 else 100)
        assert not log.finished
    assert contents(log) == packets(50, SMALL)


def test_a_damaged_byte_costs_its_block_and_what_follows(path, tmp_path):
    data, start, damaged = cut(path, tmp_path)
    for place in range(start, len(data) - 8):
        damaged.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        log = read(damaged)
        assert contents(log) == packets(50, SMALL), place
        assert not log.finished
    first = data.index(b"\n", len(MAGIC)) + 1
    damaged.write_bytes(data[: first + 20] + b"\xff" + data[first + 21 :])
    assert read(damaged).packets == ()


def test_zeros_that_a_dead_machine_left_are_no_end(path, tmp_path):
    data, start, damaged = cut(path, tmp_path)
    damaged.write_bytes(data[:start] + bytes(4096))
    log = read(damaged)
    assert len(log.packets) == 100
    assert not log.finished


@pytest.mark.parametrize(
    "data",
    [
        b"", b"s2r a1log", b"time,vx\n0,1\n", MAGIC, MAGIC + b'{"host": 1}', MAGIC + b"[1]\n", MAGIC + b"{]\n",
        MAGIC + b"\xff\xfe\n", MAGIC + b"[" * 100_000 + b"\n", b"s2r a1log 2\n{}\n",
    ],
)  # fmt: skip
def test_what_is_no_recording_is_an_error_that_names_the_file(path, data):
    path.write_bytes(data)
    with pytest.raises(TraceError, match=str(path)):
        read(path)


def test_a_file_that_is_not_there_is_an_error_that_names_it(tmp_path):
    for missing in (tmp_path / "nothing", tmp_path):
        with pytest.raises(TraceError, match=str(missing)):
            read(missing)


def test_nothing_is_overwritten(path):
    path.write_text("precious")
    writer = RawLogWriter(path, HEADER)
    assert writer.wait_ready(5)
    assert str(path) in writer.failure
    with pytest.raises(RawLogError, match="File exists"):
        writer.close(60)
    assert path.read_text() == "precious"


def test_a_folder_that_is_not_there_is_reported_and_not_raised(tmp_path):
    writer = RawLogWriter(tmp_path / "no" / "log", HEADER)
    assert writer.wait_ready(5)
    writer.append(0, 0, b"x")
    assert "No such file" in writer.failure
    assert writer.done


FULL = """
import resource, sys
from s2r_a1.rawlog import BLOCK, RawLogError, RawLogWriter
resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
writer = RawLogWriter(sys.argv[1], {})
for k in range(300):
    writer.append(k * 2_000_000, 0, bytes(771))
    writer.append(k * 2_000_000, 1, bytes(610))
try:
    writer.close(10)
except RawLogError as error:
    print(error)
"""


def test_a_full_disk_is_reported_and_what_it_took_is_read(path):
    """A process may write 300 kB: the blocks that fit whole are there, the caller gets a sentence, the thread ended."""
    done = subprocess.run([sys.executable, "-c", FULL, path], capture_output=True, text=True, check=True)
    assert str(path) in done.stdout
    assert done.stderr == ""
    assert path.stat().st_size == 300_000
    log = read(path)
    assert len(log.packets) == 400
    assert not log.finished


@pytest.fixture
def disk(monkeypatch):
    """A disk that takes 1000 bytes at a time, and none while it is full."""
    state = {"full": False, "refused": threading.Event()}
    write = os.write

    def writes(file, data):
        if threading.current_thread().name != "raw log":
            return write(file, data)
        if state["full"]:
            state["refused"].set()
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(file, bytes(data[:1000]))

    monkeypatch.setattr(rawlog.os, "write", writes)
    return state


def test_a_disk_that_is_full_for_a_while_costs_nothing(path, disk):
    given = packets(400)
    writer = record(path, given[:300])
    disk["full"] = True
    for one in given[300:600]:
        writer.append(*one)
    assert disk["refused"].wait(60)
    assert not writer.done
    disk["full"] = False
    for one in given[600:]:
        writer.append(*one)
    with pytest.raises(RawLogError, match="No space left"):
        writer.close(60)
    assert contents(read(path)) == given
    assert read(path).finished


def test_a_disk_that_stays_full_ends_the_thread_at_the_end(path, disk):
    writer = record(path, packets(60))
    writer.wait_ready(60)
    disk["full"] = True
    writer.finish()
    with pytest.raises(RawLogError, match="No space left"):
        writer.close(60)
    assert writer.done


def test_what_waits_for_a_slow_disk_is_bounded(path, disk, monkeypatch):
    monkeypatch.setattr(rawlog, "BEHIND", 200_000)
    disk["full"] = True
    given = packets(500)
    writer = record(path, given[:600])
    assert disk["refused"].wait(60)
    assert writer.failure
    disk["full"] = False
    until(lambda: read_so_far(path) >= 200)
    for one in given[600:]:
        writer.append(*one)
    with pytest.raises(RawLogError):
        writer.close(60)
    log = read(path)
    assert not log.finished
    assert contents(log) == given[:200]


def read_so_far(path):
    return len(read(path).packets) if path.exists() and path.stat().st_size > 100 else 0


def test_appending_never_waits_for_the_disk(path, monkeypatch):
    stuck, free = threading.Event(), threading.Event()
    write = os.write

    def waits(file, data):
        if threading.current_thread().name == "raw log":
            stuck.set()
            free.wait(60)
        return write(file, data)

    monkeypatch.setattr(rawlog.os, "write", waits)
    writer = record(path, packets(200))
    writer.finish()
    assert stuck.wait(60)
    assert not writer.done
    with pytest.raises(RawLogError, match=r"rollout\.a1log"):
        writer.close(0.01)
    free.set()
    assert writer.close(60).packets == 400
    assert np.array_equal(read(path).directions, [1, 0] * 200)


KILLED = """
import os, signal, sys, time
from s2r_a1.rawlog import RawLogWriter, read
writer = RawLogWriter(sys.argv[1], {})
for k in range(151):
    writer.append(k * 2_000_000, 0, bytes(771))
while not writer.wait_ready() or len(read(sys.argv[1]).packets) < 150:
    time.sleep(0.01)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_process_leaves_a_recording_that_is_read(path):
    done = subprocess.run([sys.executable, "-c", KILLED, path], timeout=300)
    assert done.returncode == -signal.SIGKILL
    assert len(read(path).packets) == 150
    assert not read(path).finished
