"""What must not move a guard: pauses, malformed requests, too many of them, files that somebody takes away."""

import contextlib
import socket

import pytest

from s2r_a1.datagrams import LockStepSocket
from s2r_a1.guard.control import RefusedError
from s2r_a1.guard.limits import LIMITS, MS
from s2r_a1.guard.place import RobotAddress, place
from s2r_a1.guard.start import attach, start
from s2r_a1.guard.states import Arrival, Inputs, State
from s2r_a1.guard.step import step
from s2r_a1.twin import TwinSettings
from s2r_spec.errors import BackendError
from tests.a1.guarding import Rounds, reading, walking
from tests.a1.rig import STAND_ON, Rig, limp
from tests.a1.robots import Steered, served

HOLDING = (State.STANDING_UP, State.STAND, State.WALK, State.LYING_DOWN)


@pytest.mark.parametrize("state", HOLDING)
@pytest.mark.parametrize(("pause", "ends"), [(18, False), (20, True), (5000, True)])
def test_a_guard_that_was_held_up_damps_a_robot_that_it_holds(state, pause, ends):
    robot = Rounds().bring(state)
    now = robot.machine.memory.now + pause * MS
    machine, _ = step(robot.machine, Inputs(now, Arrival(reading(robot.q)), walking()), LIMITS)
    assert (machine.state is State.DAMPING) is ends
    assert machine.word == ("link" if ends else None)


def test_a_robot_that_was_switched_off_and_on_before_it_was_armed_is_armed_then():
    """Its clock begins anew: to the guard its states are old, and would stay so for as long as it had run before."""
    rig = Rig()
    try:
        next(rig.bring(None))
        assert rig.state is State.LINKED
        rig.inject("back_tick=100000")
        for _ in range(15):  # each lets a round pass
            rig.ask(rig.operator, "connect")
        assert rig.guard.link.counters.backwards > 0
        assert rig.ask(rig.operator, "arm")["ok"]
        assert rig.state is State.ARMED
        assert all(limp(data) for _, data in rig.received)
    finally:
        rig.close()


def test_nothing_begins_to_move_a_robot_that_nobody_attends_to():
    """As a program of an earlier run that was stopped, and wakes when its search is gone: consent was not its own."""
    rig = Rig()
    try:
        brought = rig.bring(None)
        assert [next(brought), next(brought)] == [State.LINKED, State.ARMED]
        rig.operator.close()
        rig.turn()
        assert "operator" in rig.ask(rig.client, "stand")["error"]
        rig.turn(5)
        assert rig.state is State.ARMED
        assert all(limp(data) for _, data in rig.received)
    finally:
        rig.close()


# By bytes, over the control socket of a guard that holds a robot up.


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """A guard in a process of its own, its operator, and a client that walks in lock step until the test ends."""
    folder = tmp_path_factory.mktemp("a1")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("S2R_A1_RUN", str(folder / "run"))
        robot = Steered(TwinSettings(place="nominal"))
        with served(robot) as port:
            walker = Walker(RobotAddress("127.0.0.1", port, clock="lockstep"), folder)
            try:
                yield walker
            finally:
                walker.close()


class Walker:
    """An operator and a client of a guard; each :meth:`turn` is a round."""

    def __init__(self, robot, folder):
        self.folder, self.found = folder, place(robot.host, robot.port)
        self.operator, self.hello = start(robot)
        self.operator.request("connect")
        self.operator.request("arm")
        self._socket = LockStepSocket()
        self.control, hello = attach(robot, "client", port=self._socket.port)
        self._socket.connect(("127.0.0.1", hello["port"]))
        self.control.request("stand")
        while self.control.request("status")["state"] != "STAND":
            self.turn(100)
        self.control.request("walk")
        self.turn(2)

    def turn(self, rounds=1):
        for _ in range(rounds):
            self._socket.receive()
            self._socket.send(STAND_ON)

    def walks(self):
        """Return whether rounds go on, the robot walks, and nothing was counted against its client."""
        before = self.operator.request("status")
        self.turn(20)
        after = self.operator.request("status")
        return after["state"] == "WALK" and after["rounds"] >= before["rounds"] + 19

    @contextlib.contextmanager
    def connected(self):
        """A bare connection to the control socket."""
        with socket.socket(socket.AF_UNIX) as one:
            one.settimeout(120.0)
            one.connect(str(self.found.control))
            yield one

    def close(self):
        self.operator.close()
        self.control.close()
        self._socket.close()


LINES = {
    "nothing": b"\n\n\n",
    "no JSON": b"{\xff\xfe\n",
    "no object": b"[1,2]\n",
    "no request": b'{"do": 7}\n',
    "another request": b'{"do": "\\ud800 fly"}\n',
    "deep": b"[" * 60000 + b"\n",
    "long number": b'{"do": "hello", "role": "operator", "pid": ' + b"9" * 5000 + b"}\n",
    "roles": b'{"do": "hello", "role": ["operator"]}\n',
    "ports": b'{"do": "hello", "role": "client", "port": 1e999}\n',
    "reset without a role": b'{"do": "reset"}\n{"do": "arm"}\n{"do": "connect"}\n',
    "motions without a role": b'{"do": "stand"}\n{"do": "walk"}\n{"do": "record", "path": "/x"}\n{"do": "leave"}\n',
    "second client": b'{"do": "hello", "role": "client", "port": 9}\n{"do": "walk"}\n',
    "client as operator": b'{"do": "hello", "role": "operator"}\n{"do": "hello", "role": "client", "port": 9}\n',
    "half a line": b'{"do": "st',
}


@pytest.mark.parametrize("data", LINES.values(), ids=LINES.keys())
def test_malformed_or_unauthorised_lines_of_another_party_change_nothing(walked, data):
    with walked.connected() as one:
        one.sendall(data)
        assert walked.walks()
    assert walked.walks()


def test_a_flood_of_requests_is_cut_off(walked):
    with walked.connected() as one:
        with contextlib.suppress(OSError):
            one.sendall(b'{"do": "status"}\n' * 3000)
        assert walked.walks()
        with contextlib.suppress(ConnectionError):
            while one.recv(65536):
                pass


def test_more_connections_than_there_is_room_for_hold_nobody_up(walked):
    with contextlib.ExitStack() as stack:
        for _ in range(60):
            with contextlib.suppress(OSError):  # this process may have fewer descriptors
                stack.enter_context(walked.connected())
            walked.turn()
        assert walked.walks()
    assert walked.walks()
    with walked.connected() as one:
        one.sendall(b'{"do": "status"}\n')
        walked.turn()
        assert b'"WALK"' in one.recv(65536)


@pytest.mark.parametrize(
    "fields",
    [
        {"path": "/nowhere/at/all"},
        {"path": "/a\0b"},
        {"path": "/\ud800"},
        {"path": "/" + "x" * 5000},
        {"path": "relative"},
        {"path": 7},
        {"path": "/tmp"},
        {"header": {"place": "\ud800"}},
        {"header": [1]},
    ],
    ids=lambda fields: repr(fields)[:40],
)
def test_a_recording_that_cannot_be_is_refused_and_the_walk_goes_on(walked, fields):
    with pytest.raises(RefusedError):
        walked.control.request("record", **({"path": str(walked.folder / "new.a1log")} | fields))
    assert walked.walks()
    assert not (walked.folder / "new.a1log").exists()


def test_a_control_socket_that_was_deleted_comes_back(walked):
    walked.found.control.unlink()
    walked.turn(501)
    with walked.connected() as one:
        one.sendall(b'{"do": "status"}\n')
        walked.turn()
        assert b'"WALK"' in one.recv(65536)


def test_without_its_lock_s_file_a_robot_has_one_guard_still(walked, monkeypatch, tmp_path):
    """A cleaner of /tmp, or another shell with another folder: two guards would fight over the motors."""
    robot = RobotAddress("127.0.0.1", walked.hello["port"], clock="lockstep")
    monkeypatch.setenv("S2R_A1_RUN", str(tmp_path / "other"))
    with pytest.raises(BackendError, match="guard"):
        start(robot)
    assert walked.walks()
