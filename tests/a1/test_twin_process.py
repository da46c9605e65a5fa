"""A twin in a process of its own: what it says, what it refuses, and how it ends."""

import contextlib
import json
import signal
import socket
import subprocess
import sys
import threading

import numpy as np
import pytest

from s2r_a1.rawlog import read
from s2r_a1.twin.__main__ import main
from s2r_a1.twin.options import read_options
from s2r_a1.twin.server import Server
from s2r_a1.wire import A1, pack, unpack
from s2r_spec.errors import UsageError
from tests.a1.steering import LIMP, twin

OFF = pack(LIMP, A1)


@contextlib.contextmanager
def socket_to(port=None):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.settimeout(120.0)
        one.bind(("127.0.0.1", 0))
        if port:
            one.connect(("127.0.0.1", port))
        yield one


@contextlib.contextmanager
def served(robot, how="serve_in_lock_step", **options):
    """Serve a twin from a thread of this process."""
    with Server(robot, ("127.0.0.1", 0), **options) as server:
        thread = threading.Thread(target=getattr(server, how))
        thread.start()
        try:
            yield server.port
        finally:
            server.stop()
            thread.join()


def test_a_process_serves_in_lock_step_records_and_ends_by_a_signal(tmp_path):
    record = tmp_path / "twin.a1log"
    command = [sys.executable, "-m", "s2r_a1.twin", "--place", "grass", "--clock", "lockstep", "--port", "0"]
    process = subprocess.Popen(
        [*command, "--record", record, "--inject", "loss@1"], stdout=subprocess.PIPE, text=True
    )
    try:
        line = process.stdout.readline()
        assert "twin" in line
        assert "grass" in line
        assert "lockstep" in line
        port = int(line.partition("127.0.0.1:")[2].partition(",")[0])
        with socket_to(port) as steering:
            steering.send(bytes(610))  # as the vendor's examples begin
            answers = []
            for data in (OFF, OFF, OFF, b""):
                steering.send(data)
                answers.append(steering.recv(2048))
        process.send_signal(signal.SIGTERM)
        assert process.wait(120) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
    assert [len(answer) for answer in answers] == [771, 0, 771, 771]
    assert unpack(answers[3], A1).tick - unpack(answers[0], A1).tick == 6
    kept = read(record)
    assert kept.finished
    assert kept.header["robot"] == "twin"
    assert "grass" in kept.header["arguments"]
    assert kept.packets == (bytes(610), OFF, answers[0], OFF, b"", OFF, answers[2], b"", answers[3])
    assert kept.directions.tolist() == [1, 1, 0, 1, 0, 1, 0, 1, 0]


def test_a_served_twin_is_the_same_as_one_in_process():
    commands = [OFF, b"", b"junk", OFF, OFF]
    other = twin("loss@3", "duplicate@1", seed=5)
    expected = [(other.round([data]) or [b""])[-1] for data in commands]
    with served(twin("loss@3", "duplicate@1", seed=5)) as port, socket_to(port) as steering:
        found = []
        for data in commands:
            steering.send(data)
            found.append(steering.recv(2048))
    assert found == expected


def test_another_sender_is_answered_only_after_a_valid_command():
    with served(twin()) as port, socket_to(port) as first, socket_to(port) as second:
        first.send(OFF)
        before = unpack(first.recv(2048), A1).tick
        for data in (b"", b"junk", bytes(610)):
            second.send(data)
        first.send(b"")
        assert unpack(first.recv(2048), A1).tick == before + 2
        second.send(OFF)
        assert unpack(second.recv(2048), A1).tick == before + 4
        first.send(b"")
        second.send(b"")
        assert unpack(second.recv(2048), A1).tick == before + 6


def test_in_real_time_states_stream_from_the_first_command_on():
    with served(twin(), "serve_in_real_time") as port, socket_to(port) as steering:
        steering.send(OFF)
        ticks = [unpack(steering.recv(2048), A1).tick for _ in range(20)]
    np.testing.assert_array_equal(np.diff(ticks), 2)


def test_motion_capture_comes_by_udp():
    with socket_to() as camera:
        with (
            served(twin(), mocap=camera.getsockname()[1]) as port,
            socket_to(port) as steering,
        ):
            for _ in range(15):
                steering.send(OFF)
                steering.recv(2048)
        poses = [json.loads(camera.recv(2048)) for _ in range(3)]
    assert [pose.keys() for pose in poses] == [{"t", "x", "y", "z", "qw", "qx", "qy", "qz"}] * 3


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["--place", "moon"], "moon"),
        (["--host", "192.168.123.10"], "192.168.123.10"),
        (["--host", "0.0.0.0"], "0.0.0.0"),
        (["--host", "robot.example"], "robot.example"),
        (["--port", "65536"], "--port"),
        (["--port", "x"], "--port"),
        (["--clock", "sundial"], "--clock"),
        (["--layout", "go2"], "--layout"),
        (["--delay", "11"], "--delay"),
        (["--seed", "-1"], "--seed"),
        (["--silence", "freeze"], "--silence"),
        (["--noise", "loud"], "--noise"),
        (["--mocap", "0"], "--mocap"),
        (["--inject", "los"], "los"),
        (["--start", "none.npz"], "none.npz"),
        (["--plaec", "lab"], "--plaec"),
        (["lab"], "lab"),
    ],
)
def test_bad_options_end_with_one_sentence(arguments, part, capsys):
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert part in err


def test_a_busy_port_and_a_record_that_exists_end_with_one_sentence(tmp_path, capsys):
    with socket_to() as other:
        port = other.getsockname()[1]
        assert main(["--place", "nominal", "--port", str(port)]) == 4
    busy = capsys.readouterr()
    record = tmp_path / "old.a1log"
    record.write_text("kept")
    assert main(["--place", "nominal", "--port", "0", "--record", str(record)]) == 4
    old = capsys.readouterr()
    for (out, err), part in ((busy, str(port)), (old, "old.a1log")):
        assert out == ""
        assert err.count("\n") == 1
        assert part in err
    assert record.read_text() == "kept"


def test_options_that_are_left_out_are_those_of_a_robot_in_the_lab():
    options = read_options([])
    assert options.address == ("127.0.0.1", 8007)
    assert options.clock == "real"
    assert options.twin.place == "lab"
    assert options.twin.delay == 1
    assert options.twin.silence == "damp"
    assert not options.twin.injects
    assert read_options(["--host", "localhost"]).address == ("127.0.0.1", 8007)
    assert len(read_options(["--inject", "loss=0.1", "--inject", "heat@3-"]).twin.injects) == 2
    with pytest.raises(UsageError):
        read_options(["--inject"])
