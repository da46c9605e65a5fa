"""Signals, each sent once, in the middle of a walk: what the robot saw last, who holds it, and how the run goes on.

In lock step the twin stops the time: it holds a round until the signal has done what it does.
"""

import os
import signal
import threading
import time
from contextlib import contextmanager

import pytest

from s2r_a1.guard.place import RobotAddress, hold, place
from s2r_a1.guard.start import attach
from s2r_a1.twin import TwinSettings
from s2r_spec.runs.journal import FILE, Journal
from tests.a1.realtime import TooBusyError, Walking, first_damped, moves_after
from tests.a1.rig import damping, limp
from tests.a1.robots import Steered, served
from tests.cli.conftest import CommandLine
from tests.forked import started
from tests.processes import lives, until
from tests.terminals import person

MIDDLE = 1000
"""Rounds of a walk: trotting in place takes 600 to 800, and the test of 1.5 s is 750 more."""
PATIENCE = 300.0
"""Seconds that a wait may take: no more than a safety net, for the machine may be busy."""


class Held(Steered):
    """A twin that stops the time in the middle of the next walk, until it is let go."""

    def __init__(self):
        super().__init__(TwinSettings(place="nominal", noise=False))
        self._reached, self._on = threading.Event(), threading.Event()
        self.hold()

    def hold(self):
        """Stop the time in the middle of the walk that begins next."""
        self._reached.clear()
        self._on.clear()
        self._again = True

    def round(self, arrived):
        if self._again:  # here, where no walk is being held
            self._again = False
            self.rest()
            self.walking = self._hold
        return super().round(arrived)

    def _hold(self, n):
        if n == MIDDLE:
            self._reached.set()
            self._on.wait(PATIENCE)

    @contextmanager
    def held(self):
        """Wait for the middle of a walk; let it go on after the block."""
        assert self._reached.wait(PATIENCE)
        try:
            yield
        finally:
            self.let_go()

    def let_go(self):
        self._on.set()


class Lab:
    """A twin, and the commands of a user in a folder of her own."""

    def __init__(self, s2r, twin, port):
        self.s2r, self.twin, self.robot = s2r, twin, RobotAddress("127.0.0.1", port, clock="lockstep")
        self.folder = s2r.folder / "r" / "walking"
        backend = f"a1:host=127.0.0.1,port={port},velocity=onboard,operator=auto,clock=lockstep"
        self._words = ["check", s2r.spec(), "-b", backend, "--budget", "8"]

    def start(self, *words, terminal=None):
        return started([*self._words, *words], self.s2r.folder, terminal=terminal)

    def guard(self, do="status"):
        """Return the status of the living guard; None where none lives."""
        attached = attach(self.robot)
        if attached is None:
            return None
        connection, status = attached
        connection.close()
        return status

    def until_damped(self, word):
        """Wait until the robot is damped for a reason, and lies; return what came to it meanwhile."""

        def damped():
            status = self.guard()
            return status and status["state"] == "DAMPING" and status["since"] >= 3.0

        until(damped, PATIENCE)
        assert self.guard()["word"] == word
        return self.came()

    def came(self):
        """Return the packets that came to the robot after the round that was held."""
        return self.twin.came[self.at :]

    @contextmanager
    def middle(self):
        """Wait for the middle of a walk, and stop the time for the block; gives the guard's status."""
        with self.twin.held():
            self.at = len(self.twin.came)
            status = self.guard()
            assert status["state"] == "WALK"
            yield status

    def journal(self):
        return (self.folder / FILE).read_bytes()

    def voids(self):
        return [(void.word, void.rollout.key) for void in Journal.read(self.folder).voids]


@pytest.fixture
def lab(tmp_path, monkeypatch):
    monkeypatch.setenv("S2R_A1_RUN", str(tmp_path / "guards"))
    twin = Held()
    with served(twin) as port:
        made = Lab(CommandLine(tmp_path), twin, port)
        try:
            yield made
        finally:
            twin.let_go()
            twin.walking = lambda n: None


def test_a_search_that_is_killed_leaves_a_damped_robot_and_goes_on_with_the_same_test(lab):
    with lab.start("--run", "r") as search, lab.middle() as status:
        worker = status["client"]
        assert worker != search.process.pid
        os.kill(search.process.pid, signal.SIGKILL)
        until(lambda: not lives(worker))  # nobody is left to ask it for anything
    came = lab.until_damped("operator")
    assert all(damping(data) for data in came)
    assert len(came) > 1000
    first = lab.journal()
    (open_test,) = Journal.read(lab.folder).open

    with lab.start("--resume", "r"):
        until(lambda: lab.journal().count(b'"begun"') == 2, PATIENCE)
    assert lab.journal().startswith(first)
    assert lab.voids() == [("killed", open_test.key)]
    assert [attempt.key for attempt in Journal.read(lab.folder).open] == [open_test.key]


@pytest.mark.slow
def test_whoever_is_killed_the_robot_is_damped_and_the_run_goes_on_with_the_same_test(lab):
    with lab.start("--run", "r") as search, lab.middle() as status:
        worker, guard = status["client"], status["pid"]
        assert worker != search.process.pid
        os.kill(search.process.pid, signal.SIGKILL)
        until(lambda: not lives(worker))  # nobody is left to ask it for anything
    came = lab.until_damped("operator")
    assert all(damping(data) for data in came)
    assert len(came) > 1000
    first = lab.journal()

    lab.twin.hold()
    with lab.start("--resume", "r") as search:
        with lab.middle() as status:
            assert status["pid"] == guard  # the guard outlives who started it
            assert lab.journal().startswith(first)
            os.kill(status["client"], signal.SIGKILL)
            until(lambda: not lives(status["client"]))
        # The search goes on by itself: operator=auto agrees to a reset.
        killed = lab.at
        lab.twin.hold()
        with lab.middle() as status:
            came = lab.twin.came[killed : lab.at]
            alone = next(n for n, data in enumerate(came) if not damping(data))
            assert alone > 500
            assert limp(came[alone])
            os.kill(guard, signal.SIGKILL)
            until(lambda: not lives(guard))
        until(lambda: len(lab.voids()) == 3, PATIENCE)
        os.kill(search.process.pid, signal.SIGKILL)
        until(lambda: not lives(search.process.pid))
    # Nothing came until another guard did, which began with both consents.
    assert all(limp(data) for data in lab.came()[1:250])
    assert lab.journal().startswith(first)
    words, keys = zip(*lab.voids(), strict=True)
    assert words == ("killed", "killed", "link")
    assert len(set(keys)) == 1


def test_one_ctrl_c_brings_the_robot_to_rest(lab):
    with person() as someone, lab.start("--run", "r", terminal=someone.name) as search:
        with lab.middle():
            someone.types("\x03")
            until(lambda: lab.guard()["event"]["event"] == "wanted")
        done = search.finish(PATIENCE)
    assert done.returncode == 130, done.stderr
    assert "--resume r" in done.stderr
    assert lab.guard()["state"] == "RESTING"
    came = lab.came()
    assert not any(damping(data) for data in came[:1000])
    assert damping(came[-1])
    assert [word for word, _ in lab.voids()] == ["operator"]


@pytest.mark.slow
def test_two_ctrl_c_damp_and_a_terminal_that_goes_damps(lab):
    with person() as someone, lab.start("--run", "r", terminal=someone.name) as search:
        with lab.middle():
            someone.types("\x03")
            until(lambda: lab.guard()["event"]["event"] == "wanted")
            someone.types("\x03")
            until(lambda: lab.guard()["state"] == "DAMPING")
        done = search.finish(PATIENCE)
    assert done.returncode == 130, done.stderr
    assert all(damping(data) for data in lab.until_damped("operator")[1:])
    first = lab.journal()

    lab.twin.hold()
    with person() as someone, lab.start("--resume", "r", terminal=someone.name) as search:
        with lab.middle() as status:
            someone.leaves()
            search.process.join(PATIENCE)
            assert search.process.exitcode
            until(lambda: not lives(status["client"]))
        assert all(damping(data) for data in lab.until_damped("operator")[1:])
    assert lab.journal().startswith(first)
    ((word, key),) = lab.voids()
    assert word == "operator"
    assert [attempt.key for attempt in Journal.read(lab.folder).open] == [key]


# In real time, where the clock on the wall decides.


@pytest.fixture(scope="module")
def real_time(tmp_path_factory):
    """A robot for all of these tests; each lets a client of its own walk."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("S2R_A1_RUN", str(tmp_path_factory.mktemp("guards")))
        with Walking() as robot:
            yield robot


@pytest.fixture
def walking(real_time):
    try:
        real_time.walk()
    except TooBusyError as error:
        pytest.skip(str(error))
    return real_time


def turned(walking, rounds):
    """Wait until the robot has turned so many rounds; return what came to it meanwhile."""
    walking.taken()
    ended, came = 0, []

    def enough():
        nonlocal ended
        stamps, received = walking.taken()
        came.extend(received)
        ended += len(stamps)
        return ended >= rounds

    until(enough)
    return came


@pytest.mark.parametrize("seconds", [0.05, pytest.param(5.0, marks=pytest.mark.slow)])
def test_a_client_that_was_stopped_finds_a_robot_that_is_damped_when_it_wakes(walking, seconds):
    os.kill(walking.client.pid, signal.SIGSTOP)
    begun = time.monotonic_ns()
    time.sleep(seconds)
    os.kill(walking.client.pid, signal.SIGCONT)
    refused = walking.client_reply.recv()
    assert len(refused) == 3  # to walk, to stand, to halt
    assert walking.status()["state"] == "DAMPING"
    _, received = walking.taken()
    damped = first_damped(received, begun)
    assert damped is not None
    assert moves_after(received, damped) == 0


@pytest.mark.slow
def test_what_a_guard_that_is_killed_leaves_to_the_robot_and_no_lock(walking):
    pid = walking.status()["pid"]
    walking.kill_guard()
    until(lambda: not lives(pid))
    turned(walking, 2)  # what was on its way has come
    assert turned(walking, 25) == []  # the robot's own time goes on, under its own rule
    lock = hold(place("127.0.0.1", walking.robot.port))
    assert lock is not None
    os.close(lock)
