"""The guard as a process: its control socket, its two legs of the wire, its signals, in lock step with a robot."""

import json
import os
import pty
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from s2r_a1.datagrams import LockStepSocket
from s2r_a1.guard import __main__ as guard
from s2r_a1.guard import moves
from s2r_a1.guard.control import Connection, ControlError, RefusedError
from s2r_a1.guard.place import RobotAddress, hold, place
from s2r_a1.guard.start import attach, start
from s2r_a1.link import UdpLink
from s2r_a1.rawlog import read
from s2r_a1.wire import A1, GO1, Orders, pack, pack_reading, unpack_orders
from s2r_spec.errors import BackendError, UsageError
from tests.a1.guarding import LYING, ZERO, reading, walking
from tests.processes import lives, until

LIMP = Orders(ZERO, ZERO, ZERO, ZERO, ZERO)


class Toy(threading.Thread):
    """A robot without weight: each command that comes is kept, and answered by a state that has obeyed it."""

    def __init__(self, layout=A1, clock="lockstep"):
        super().__init__(daemon=True)
        self.layout, self.clock = layout, clock
        self.commands = []
        self.q = LYING
        self.answers = lambda state: pack_reading(state, self.layout)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.02)
        self._open = True
        self.start()

    @property
    def port(self):
        return self._socket.getsockname()[1]

    @property
    def orders(self):
        return [unpack_orders(command, self.layout) for command in self.commands]

    def run(self):
        began = time.monotonic()
        while self._open:
            try:
                data, peer = self._socket.recvfrom(2048)
            except OSError:
                continue
            if len(data) != self.layout.command.itemsize:
                continue
            self.commands.append(data)
            motors = np.frombuffer(data, self.layout.command)["motors"][0, :12]
            self.q = motors["q"].astype(float) if motors["kp"].any() else self.q
            elapsed = (
                2 * len(self.commands) if self.clock == "lockstep" else 1000 * (time.monotonic() - began)
            )
            self._socket.sendto(self.answers(reading(self.q, tick=int(elapsed))), peer)

    def close(self):
        """End; twice is not too often."""
        self._open = False
        self.join()
        self._socket.close()


class Walker:
    """A client in lock step."""

    def __init__(self, robot):
        self._socket = LockStepSocket()
        self.control, hello = attach(robot, "client", port=self._socket.port)
        self._socket.connect(("127.0.0.1", hello["port"]))
        self.link = UdpLink(self._socket, A1)
        self.events = []

    def turn(self, orders=LIMP, count=1, ask=None, until=None):
        """Answer states, at most ``count``; ask for something between the first one and its answer."""
        for _ in range(count):
            self.link.read()
            self.events += self.control.take()
            if ask:
                self.control.request(ask)
                ask = None
            self.link.write(orders) if orders else self.link.skip()
            if until in [event["state"] for event in self.events if event["event"] == "state"]:
                return
        assert until is None

    def stand(self):
        self.turn(ask="stand", until="STAND", count=1500)

    def close(self):
        self.control.close()
        self.link.close()


@pytest.fixture(autouse=True)
def own(tmp_path, monkeypatch):
    """Files of guards, and guards, of this test alone."""
    monkeypatch.setenv("S2R_A1_RUN", str(tmp_path / "run"))


@pytest.fixture
def closing():
    """A list of what is closed in the end, however the test ends."""
    made = []
    yield made
    for one in reversed(made):
        one.close()


@pytest.fixture
def toy(closing):
    closing.append(Toy())
    return closing[-1]


class Killed:
    def __init__(self, pid):
        self.pid = pid

    def close(self):
        if lives(self.pid):
            os.kill(self.pid, signal.SIGKILL)
            until(lambda: not lives(self.pid))


@pytest.fixture
def started(closing):
    """Start a guard as an operator; return the connection, and the guard's answer to hello."""

    def begin(robot, idle=60.0):
        connection, hello = start(robot, idle)
        closing.extend((Killed(hello["pid"]), connection))
        return connection, hello

    return begin


@pytest.fixture
def robot(toy):
    return RobotAddress("127.0.0.1", toy.port, clock="lockstep")


@pytest.fixture
def operator(robot, started):
    return started(robot)[0]


@pytest.fixture
def armed(operator):
    operator.request("connect")
    operator.request("arm")
    return operator


@pytest.fixture
def walker(armed, robot, closing):
    closing.append(Walker(robot))
    return closing[-1]


def ended(robot):
    """Return whether no guard holds the robot."""
    lock = hold(place(robot.host, robot.port))
    if lock is not None:
        os.close(lock)
    return lock is not None


def command(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "s2r_a1.guard", *arguments], capture_output=True, text=True, check=False
    )


def test_nothing_leaves_before_the_first_consent_and_only_zeros_before_the_stand(toy, robot, operator):
    for refused in ("arm", "stand", "walk", "reset"):
        with pytest.raises(RefusedError):
            operator.request(refused)
    assert operator.request("status")["state"] == "OFF"
    assert toy.commands == []
    assert operator.request("connect")["tick_unit"] == "ms"
    assert operator.request("arm")["state"] == "ARMED"
    assert toy.commands
    assert set(toy.commands) == {pack(LIMP, A1)}


@pytest.mark.slow
def test_a_day_of_a_robot_which_sigterm_ends_lying(toy, robot, armed, walker):
    """Stand, walk, halt; SIGINT does nothing; SIGTERM lets the robot lie down, and ends the guard."""
    pid = armed.request("status")["pid"]
    walker.stand()
    np.testing.assert_allclose(toy.q, moves.STANDING, atol=1e-6)
    walker.turn(walking(1.0), ask="walk")
    walker.turn(walking(2.0), 50)
    assert {orders.tau[0] for orders in toy.orders[-49:]} == {2.0}
    walker.turn(walking(2.0), ask="halt")
    os.kill(pid, signal.SIGINT)
    walker.turn(count=10)
    status = armed.request("status")
    assert (status["state"], status["word"]) == ("STAND", None)
    assert len(status["temperatures"]) == 12
    os.kill(pid, signal.SIGTERM)
    walker.turn(until="RESTING", count=5000)
    with pytest.raises(ControlError):
        walker.turn(count=1000)
    until(lambda: ended(robot))
    assert not place(robot.host, robot.port).control.exists()
    np.testing.assert_allclose(toy.q, moves.LYING, atol=0.01)
    assert not toy.orders[-1].kp.any()
    assert (toy.orders[-1].kd == moves.DAMPING).all()


def test_a_run_is_repeated_bit_for_bit(closing, started):
    runs = []
    for _ in range(2):
        toy = Toy()
        closing.append(toy)
        robot = RobotAddress("127.0.0.1", toy.port, clock="lockstep")
        connection, _ = started(robot)
        connection.request("connect")
        connection.request("arm")
        walker = Walker(robot)
        closing.append(walker)
        walker.turn(ask="stand", count=100)
        walker.turn(None, 3)
        walker.turn(ask="lie", count=50)
        walker.turn(walking(), 10)
        # How many limp packets come before the stand hangs on when the operator's requests come.
        first = next(i for i, command in enumerate(toy.commands) if command != pack(LIMP, A1))
        runs.append(toy.commands[first : first + 150])
        assert len(runs[-1]) == 150
    assert runs[0] == runs[1]


def test_a_client_that_leaves_leaves_a_damped_robot(toy, armed, walker):
    walker.turn(count=10, ask="stand")
    walker.close()
    until(lambda: armed.request("status")["state"] == "DAMPING")
    assert armed.request("status")["word"] == "client"
    until(lambda: (toy.orders[-1].kd == moves.DAMPING).all())
    assert not toy.orders[-1].kp.any()
    assert armed.request("reset")["state"] == "LINKED"
    assert armed.request("arm")["state"] == "ARMED"


def test_a_client_that_takes_leave_leaves_the_robot_standing_and_it_lies_when_nobody_is_left(
    toy, robot, armed, walker, closing
):
    walker.stand()
    walker.turn(walking(1.0), ask="walk")
    with pytest.raises(RefusedError, match="halt"):
        walker.control.request("leave")
    walker.turn(walking(1.0), 3, ask="halt")
    walker.control.request("leave")
    walker.close()
    assert armed.request("status")["client"] is None
    assert armed.request("status")["state"] == "STAND"
    armed.close()
    until(lambda: not toy.orders[-1].kp.any())  # it lies, and is damped
    np.testing.assert_allclose(toy.q, moves.LYING, atol=0.01)
    operator, status = start(robot)
    closing.append(operator)
    assert status["state"] == "RESTING"


def test_a_client_that_was_damped_must_connect_anew(robot, armed, walker, closing):
    walker.turn(count=10, ask="stand")
    assert armed.request("damp", reason="the operator said so")["state"] == "DAMPING"
    walker.turn(walking(9.0), 10)
    assert walker.events[-1]["word"] == "operator"
    reset = threading.Thread(target=lambda: [armed.request(do) for do in ("reset", "arm")])
    reset.start()
    while reset.is_alive():
        walker.turn(walking(9.0))
    with pytest.raises(RefusedError):
        walker.control.request("stand")
    assert armed.request("status")["state"] == "ARMED"
    again = Walker(robot)  # the first one is still there, as one that was stopped is
    closing.append(again)
    again.turn(ask="stand", count=2)
    assert armed.request("status")["state"] == "STANDING_UP"


def test_a_client_that_took_leave_moves_the_robot_no_more(robot, armed, walker, closing):
    walker.turn(count=3, ask="leave")
    for refused in ("stand", "walk"):
        with pytest.raises(RefusedError):
            walker.control.request(refused)
    again = Walker(robot)
    closing.append(again)
    again.turn(ask="stand", count=2)
    walker.close()
    again.turn(count=5)
    assert armed.request("status")["state"] == "STANDING_UP"


def test_a_client_that_was_stopped_does_not_hold_up_damping(toy, armed, walker):
    walker.turn(ask="stand", count=3)
    assert armed.request("damp")["state"] == "DAMPING"
    until(lambda: armed.request("status")["client"] is None)
    until(lambda: len([1 for orders in toy.orders[-9:] if (orders.kd == moves.DAMPING).all()]) == 9)


def test_one_client_at_a_time_and_each_request_for_whom_it_is(robot, armed, walker):
    with pytest.raises(RefusedError):
        attach(robot, "client", port=9)
    for refused in ("stand", "walk", "record"):
        with pytest.raises(RefusedError):
            armed.request(refused)
    for refused in ("connect", "arm", "reset"):
        with pytest.raises(RefusedError):
            walker.control.request(refused)


@pytest.fixture
def raw(robot, operator):
    """A bare connection to the control socket."""
    with socket.socket(socket.AF_UNIX) as one:
        one.settimeout(120.0)
        one.connect(str(place(robot.host, robot.port).control))
        yield one


def test_a_request_that_is_none_is_answered_by_a_sentence(raw):
    with raw.makefile() as replies:
        for line in (b"{", b"[]", b'{"do": 1}', b'{"do": "dance"}', b"\xff", b'{"do": "hello", "role": 1}'):
            raw.sendall(line + b"\n")
            reply = json.loads(replies.readline())
            assert reply["ok"] is False, line
            assert reply["error"], line


def test_a_guard_is_started_once_and_found_again(robot, operator):
    again, hello = start(robot)
    again.close()
    assert hello["pid"] == operator.request("status")["pid"]
    with pytest.raises(UsageError):
        attach(RobotAddress(robot.host, robot.port, clock="real"), "operator")


def test_a_robot_that_is_not_there_is_refused_and_nothing_is_sent_on(closing, started):
    free = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    connection, _ = started(RobotAddress("127.0.0.1", port, clock="lockstep"))
    with pytest.raises(RefusedError):
        connection.request("connect")
    assert connection.request("status")["state"] == "OFF"


@pytest.mark.parametrize("answers", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_robot_of_another_layout_is_refused(closing, started, answers):
    closing.append(Toy(GO1 if not answers else A1))
    if answers:
        closing[0].answers = lambda state: pack_reading(state, GO1)
    connection, _ = started(RobotAddress("127.0.0.1", closing[0].port, clock="lockstep"))
    with pytest.raises(RefusedError):
        connection.request("connect")
    assert connection.request("status")["state"] == "OFF"


def test_a_robot_that_walks_by_itself_is_not_armed(toy, operator):
    ticks = iter(range(10**6))
    toy.answers = lambda state: pack_reading(
        state._replace(q=LYING + 0.1 * np.sin(0.03 * next(ticks)), tick=state.tick), A1
    )
    operator.request("connect")
    with pytest.raises(RefusedError):
        operator.request("arm")
    assert set(toy.commands) == {pack(LIMP, A1)}


def test_lock_step_is_for_this_machine_only(started):
    connection, _ = started(RobotAddress("192.0.2.1", clock="lockstep"))
    with pytest.raises(RefusedError):
        connection.request("connect")


def test_an_unknown_layout_and_a_second_guard_are_sentences(robot, operator):
    with pytest.raises(BackendError):
        start(RobotAddress("127.0.0.1", 9, layout="go7", clock="lockstep"))


def test_all_packets_are_recorded_as_they_came(toy, robot, walker, tmp_path):
    walker.turn(count=10)
    path = tmp_path / "one.a1log"
    walker.link.read()
    walker.control.request("record", path=str(path), header={"rollout": 1})
    before = len(toy.commands)  # the guard waits for the client here, so the robot waits too
    walker.link.write(LIMP)
    walker.turn(count=100)
    walker.link.read()
    reply = walker.control.request("stop_recording")
    walker.link.write(LIMP)
    log = read(path)
    assert (reply["packets"], reply["bytes"]) == (len(log.packets), path.stat().st_size)
    assert log.finished
    assert log.header["rollout"] == 1
    assert log.header["port"] == robot.port
    assert [p for p, to in zip(log.packets, log.directions, strict=True) if to] == toy.commands[
        before : before + 101
    ]
    assert (np.diff(log.times.astype(int)) >= 0).all()


def test_a_recording_that_cannot_be_made_is_refused(walker):
    walker.link.read()
    for path in ("relative.a1log", "/nowhere/at/all.a1log", 3):
        with pytest.raises(RefusedError):
            walker.control.request("record", path=path)
    with pytest.raises(RefusedError):
        walker.control.request("stop_recording")
    walker.link.write(LIMP)


def test_commands_speak_with_the_guard_that_lives(toy, robot, armed, walker, capsys):
    done = command("status", "--json")
    assert done.returncode == 0
    assert json.loads(done.stdout)["state"] == "ARMED"
    walker.turn(ask="stand", count=10)
    assert guard.main(["lie"]) == 0
    walker.turn(until="LYING_DOWN", count=3)
    assert guard.main(["damp", "--host", "localhost", "--port", str(robot.port)]) == 0
    capsys.readouterr()
    assert guard.main(["status"]) == 0
    assert "twin" in capsys.readouterr().out
    walker.close()
    assert guard.main(["stop"]) == 0
    until(lambda: ended(robot))
    assert guard.main(["status"]) == 4
    assert capsys.readouterr().err.count("\n") == 1


def test_a_guard_with_nobody_attached_ends(robot, started):
    connection, _ = started(robot, idle=0.05)
    connection.close()
    until(lambda: ended(robot))


def test_a_damped_guard_lives_on_until_its_twin_has_ended(toy, robot, started):
    operator, _ = started(robot, idle=0.05)
    for do in ("connect", "arm", "damp"):
        operator.request(do)
    operator.close()
    until(lambda: len(toy.commands) > 1500)
    assert not ended(robot)
    toy.close()
    until(lambda: ended(robot))


def test_sigkill_leaves_no_lock_and_the_next_guard_knows_no_consent(robot, armed, started):
    pid = armed.request("status")["pid"]
    os.kill(pid, signal.SIGKILL)
    until(lambda: ended(robot))
    _, hello = started(robot)
    assert hello["pid"] != pid
    assert hello["state"] == "OFF"


def test_in_real_time_a_robot_is_connected_and_other_senders_are_ignored(closing, started):
    toy = Toy(clock="real")
    closing.append(toy)
    connection, _ = started(RobotAddress("127.0.0.1", toy.port))
    try:
        connected = connection.request("connect")
    except RefusedError as error:
        pytest.skip(f"this machine is too busy for a link in real time: {error}")
    assert connected["tick_unit"] == "ms"
    until(lambda: connection.request("status")["rounds"] > 100)
    assert set(toy.commands) == {pack(LIMP, A1)}


def test_a_connection_to_no_guard_is_a_sentence(tmp_path):
    with pytest.raises(ControlError):
        Connection(tmp_path / "nobody.sock")


def test_a_party_that_sends_without_end_is_closed(raw, operator):
    with pytest.raises((BrokenPipeError, ConnectionResetError)):
        raw.sendall(b"x" * 4_000_000)
    assert operator.request("status")["state"] == "OFF"


# A computer that is late. Only Linux stamps datagrams when they arrive.


@pytest.fixture
def live(closing, started):
    """A toy that answers in real time, its guard's process, and the operator's connection."""
    closing.append(Toy(clock="real"))
    robot = RobotAddress("127.0.0.1", closing[-1].port)
    connection, hello = started(robot)
    return closing[-1], hello["pid"], connection


def stopped(pid, seconds):
    """Stop a process for a while, as a busy computer does."""
    os.kill(pid, signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(pid, signal.SIGCONT)


def test_a_computer_that_delays_the_guard_is_refused_with_the_delay(live):
    _, pid, operator = live
    late = threading.Timer(0.5, stopped, (pid, 0.05))
    late.start()
    with pytest.raises(
        RefusedError, match=r"this computer is too slow for a robot: .* delayed the guard by [45]\d ms"
    ):
        operator.request("connect")
    assert operator.request("status")["state"] == "OFF"


def test_a_guard_that_was_delayed_while_the_robot_is_limp_goes_on(live):
    """92 states wait in its socket, the newest of them 0.1 s old."""
    _, pid, operator = live
    for _ in range(5):  # this computer may be busy
        try:
            operator.request("connect")
        except RefusedError:
            continue
        break
    operator.request("arm")
    for _ in range(2):
        stopped(pid, 0.4)
        time.sleep(0.1)
        before = operator.request("status")
        time.sleep(0.2)
        after = operator.request("status")
        assert (after["state"], after["reason"]) == ("ARMED", None)
        assert after["counters"]["clock"] == 0
        assert after["counters"]["received"] > before["counters"]["received"] + 50
    time.sleep(1.2)  # the limit of a silence while it is limp
    assert operator.request("status")["state"] == "ARMED"


def test_a_guard_of_one_robot_is_not_that_of_another(closing, started):
    closing.append(Toy())
    port = closing[-1].port
    _, hello = started(RobotAddress("127.0.0.1", port, clock="lockstep", robot="a1-07"))
    assert hello["robot"] == "a1-07"
    with pytest.raises(UsageError, match=r"robot=a1-07, not robot=a1-08"):
        start(RobotAddress("127.0.0.1", port, clock="lockstep", robot="a1-08"))


# The view of a limp robot, as an operator starts it.


def viewed(port, **options):
    command = [sys.executable, "-m", "s2r_a1.status", "--host", "127.0.0.1", "--port", str(port), "--once"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def test_the_view_connects_only_after_the_operator_has_typed_the_word(closing):
    toy = Toy(clock="real")
    closing.append(toy)
    mine, theirs = pty.openpty()
    process = viewed(toy.port, stdin=theirs)
    try:
        question = process.stdout.readline()
        assert "sent nothing yet" in question
        time.sleep(0.3)
        os.write(mine, b"yes\n")
        assert "You typed 'yes'" in process.stdout.readline()
        assert not toy.commands
        os.write(mine, b"connect\n")
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
        os.close(mine)
        os.close(theirs)
        robot = RobotAddress("127.0.0.1", toy.port)
        if found := attach(robot, "operator"):
            closing.append(Killed(found[1]["pid"]))
            found[0].close()
    if "too slow" in err:
        pytest.skip(f"this machine is too busy for a link in real time: {err}")
    assert "FR thigh" in out, err
    assert set(toy.commands) == {pack(LIMP, A1)}


def test_the_view_needs_a_terminal_for_the_consent(toy, closing, started):
    started(RobotAddress("127.0.0.1", toy.port))
    err = viewed(toy.port, stdin=subprocess.DEVNULL).communicate(timeout=60)[1]
    assert "terminal" in err
    assert not toy.commands
