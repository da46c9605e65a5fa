"""The fault table: whatever goes wrong while a robot moves, what its motors get last is damping, and nothing after.

Everything is read from the packets that came to the twin, in lock step: round for round, and the same every time.
"""

import os
import resource
from dataclasses import dataclass

import numpy as np
import pytest

from s2r_a1 import rawlog, recording
from s2r_a1.guard.limits import ROUND
from s2r_a1.guard.states import State
from s2r_a1.remote import LOST
from s2r_a1.twin.injects import KINDS, NUMBERS
from s2r_a1.wire import A1, GO1, Orders, unpack_orders
from tests.a1.faults import CLIPPED, DAMPED, MOVING, SILENCE, UNHARMED
from tests.a1.rig import CLIENT_PORT, STAND_ON, ZERO, Party, Rig, apart, damping, limp, raw
from tests.processes import until

HOT = raw(Orders(ZERO, ZERO, np.full(12, 60.0), np.full(12, 2.0), np.full(12, 5.0)))


class Stage:
    """One robot for all rows: it is brought from state to state, and each row happens to a copy of it."""

    def __init__(self):
        self._rig = None

    def at(self, state):
        """Return the robot in a state; rows in the order of states bring it there once."""
        if self._rig is None or state not in self._coming:
            self.close()
            self._rig = Rig()
            self._way, self.now = self._rig.bring(None), None
            self._coming = [State.LINKED, State.ARMED, *MOVING, State.RESTING]
        while self.now is not state:
            self.now = next(self._way)
            if self.now in self._coming:  # STAND is passed twice
                del self._coming[: self._coming.index(self.now)]
        return self._rig

    def close(self):
        if self._rig:
            self._rig.close()


@pytest.fixture(scope="module")
def stage():
    made = Stage()
    yield made
    made.close()


def test_a_robot_of_which_no_limits_are_known_is_read_and_never_armed():
    rig = Rig(layout=GO1)
    status = rig.ask(rig.operator, "connect")
    assert (status["ok"], status["state"], status["layout"]) == (True, "LINKED", "go1")
    assert len(status["temperatures"]) == 12
    sent = len(rig.received)
    refused = rig.ask(rig.operator, "arm")
    assert not refused["ok"]
    assert "Go1" in refused["error"]
    assert rig.ask(rig.operator, "status")["unready"] == refused["error"]
    assert len(rig.received) <= sent + 2  # nothing is waited for
    for who, do in (
        (rig.client, "stand"),
        (rig.client, "walk"),
        (rig.operator, "lie"),
        (rig.operator, "damp"),
    ):
        rig.ask(who, do)
    assert rig.state is State.LINKED
    for _, data in rig.received:
        orders = unpack_orders(data, GO1)
        assert not np.any([orders.kp, orders.kd, orders.tau])
    rig.close()


@dataclass
class Ended:
    """What a row led to: the packets from its first round on, and the guard."""

    begun: int
    packets: list
    state: str
    word: str
    replies: list

    @property
    def damped(self):
        """The first packet that damps, counted from the fault's first round; None if there is none."""
        return next((n for n, data in enumerate(self.packets) if damping(data)), None)


def ended(rig, begun, replies=()):
    machine = rig.guard.machine
    packets = [data for at, data in rig.received if at >= begun]
    return Ended(begun, packets, str(machine.state), machine.word, list(replies))


def rows(*states):
    """Parametrise over the rows of some states."""
    found = [(state, fault) for state in states for fault in DAMPED if state in fault.states]
    return pytest.mark.parametrize(("state", "fault"), found, ids=[f"{s}-{f.name}" for s, f in found])


def ends_in_damping(rig, fault):
    """Give a robot a fault, and try everything but a reset afterwards."""

    def happens():
        begun = rig.twin.rounds
        fault.begins(rig)
        rig.turn(fault.rounds + 2)
        # The cause is gone, and everybody tries everything but a reset.
        rig.twin.injects, rig.orders = (), HOT
        before = len(rig.client.replies)
        for party, do in (
            (rig.client, "walk"), (rig.client, "stand"), (rig.client, "halt"), (rig.operator, "lie"),
            (rig.operator, "arm"), (rig.operator, "connect"),
        ):  # fmt: skip
            if party.open:
                party.ask(do)
        rig.turn(6)
        return ended(rig, begun, rig.client.replies[before:])

    found = apart(happens)
    assert found.damped == fault.rounds
    assert all(damping(data) for data in found.packets[found.damped :])
    assert not any(data == HOT for data in found.packets)
    assert (found.state, found.word) == ("DAMPING", fault.word)
    assert not any(reply["ok"] for reply in found.replies)


@pytest.mark.parametrize(
    ("inject", "rounds", "word"),
    [("error=4:4", 1, "motor"), ("nan=q", 2, "link"), ("button=R2", 1, "operator"), ("silence", 500, "link")],
)
def test_a_fault_of_a_robot_that_lies_and_is_armed_latches(stage, inject, rounds, word):
    rig = stage.at(State.ARMED)

    def happens():
        begun = rig.twin.rounds
        rig.inject(inject)
        rig.turn(rounds + 1)
        rig.twin.injects = ()
        return ended(rig, begun, [rig.ask(rig.client, "stand")])

    found = apart(happens)
    assert (found.state, found.word) == ("DAMPING", word)
    assert found.damped == rounds
    assert all(limp(data) for data in found.packets[: found.damped])
    assert not found.replies[0]["ok"]


@rows(State.STANDING_UP, State.STAND)
def test_getting_up_or_standing_it_ends_in_damping_and_no_gain_follows(stage, state, fault):
    ends_in_damping(stage.at(state), fault)


@rows(State.WALK)
def test_walking_it_ends_in_damping_and_no_gain_follows(stage, state, fault):
    ends_in_damping(stage.at(state), fault)


@pytest.mark.parametrize("injects", [("silence",), None], ids=["robot", "client"])
def test_10_ms_of_silence_are_bridged_without_torque(stage, injects):
    rig = stage.at(State.WALK)

    def happens():
        begun = rig.twin.rounds
        if injects:
            rig.inject(*injects)
        else:
            rig.orders = b""
        rig.turn(SILENCE + 1)
        return ended(rig, begun)

    sent = [unpack_orders(data, A1) for data in apart(happens).packets]
    torque = [bool(orders.tau.any()) for orders in sent]
    assert torque == [True] * 5 + [False] * 6
    assert all(orders.kp.any() for orders in sent[:SILENCE])


@pytest.mark.parametrize(
    ("begins", "counter"), [row[1:] for row in UNHARMED], ids=[row[0] for row in UNHARMED]
)
def test_a_walk_goes_on_and_what_went_wrong_is_counted(stage, begins, counter):
    rig = stage.at(State.WALK)
    rounds = 150 if counter else 60

    def happens():
        begun, before_ticks = rig.twin.rounds, len(rig.client_ticks)
        before = getattr(rig.guard.link.counters, counter) if counter else 0
        begins(rig)
        rig.turn(rounds)
        counted = getattr(rig.guard.link.counters, counter) - before if counter else 1
        return ended(rig, begun), rig.client_ticks[before_ticks:], counted

    found, ticks, counted = apart(happens)
    assert (found.state, found.word) == ("WALK", None)
    assert counted > 0
    assert len(ticks) > 0.9 * rounds
    # No state is used twice, and none after a newer one.
    assert (np.diff(ticks) > 0).all()
    assert all(unpack_orders(data, A1).kp.any() for data in found.packets)


@pytest.mark.parametrize(
    ("data", "name", "value"), [row[1:] for row in CLIPPED], ids=[row[0] for row in CLIPPED]
)
def test_orders_beyond_limits_are_clipped_and_counted(stage, data, name, value):
    rig = stage.at(State.WALK)

    def happens():
        begun = rig.twin.rounds
        rig.orders = data
        rig.turn(3)
        return ended(rig, begun), rig.ask(rig.operator, "status")

    found, status = apart(happens)
    orders = unpack_orders(found.packets[-1], A1)
    assert getattr(orders, name)[4] == pytest.approx(value, abs=0.01)
    assert status["clipped"] >= 2
    assert found.state == "WALK"


def test_another_program_finds_a_robot_that_stays_damped(stage):
    rig = stage.at(State.WALK)

    def happens():
        begun = rig.twin.rounds
        rig.client.close()
        rig.turn(2)
        other = Party(rig.guard.listener)
        replies = [rig.ask(other, "hello", role="client", port=CLIENT_PORT)]
        replies += [rig.ask(other, do) for do in ("stand", "walk")]
        rig.turn(10)
        return ended(rig, begun, replies)

    found = apart(happens)
    assert [reply["ok"] for reply in found.replies] == [True, False, False]
    assert found.state == "DAMPING"
    assert len(found.packets) > 1500
    assert all(damping(data) for data in found.packets[1:])


def test_an_error_in_the_guard_itself_damps_the_robot_before_the_guard_ends(stage):
    rig = stage.at(State.WALK)

    def happens():
        def fails(*request):
            raise ZeroDivisionError

        begun = rig.twin.rounds
        rig.guard.answer = fails
        rig.client.ask("status")
        with pytest.raises(ZeroDivisionError):
            rig.guard.run()
        return ended(rig, begun)

    found = apart(happens)
    assert found.damped == 1
    assert len(found.packets) > 1000
    assert all(damping(data) for data in found.packets[1:])


def test_a_second_client_is_refused_and_the_walk_goes_on(stage):
    rig = stage.at(State.WALK)

    def happens():
        begun = rig.twin.rounds
        other = Party(rig.guard.listener)
        replies = [rig.ask(other, "hello", role="client", port=CLIENT_PORT + 1), rig.ask(other, "walk")]
        other.close()
        rig.turn(20)
        return ended(rig, begun, replies)

    found = apart(happens)
    assert [reply["ok"] for reply in found.replies] == [False, False]
    assert found.state == "WALK"
    assert set(found.packets[1:]) == {STAND_ON}


def stopped(rig, do, obeys, state):
    """Have the operator ask for a soft stop, and turn until a state; return packets, and stops that the client got."""
    begun = rig.twin.rounds
    rig.operator.ask(do)
    rig.turn(50)
    wanted = [(event["state"], event["word"]) for event in rig.client.events if event["event"] == "wanted"]
    if obeys:
        rig.client.ask("halt")
    rig.until(state, 2500)
    rig.turn(2)
    return ended(rig, begun), wanted


def test_a_first_ctrl_c_ends_at_rest_and_not_latched(stage):
    rig = stage.at(State.WALK)
    found, wanted = apart(lambda: stopped(rig, "lie", True, State.RESTING))
    assert (found.state, found.word) == ("RESTING", "operator")
    assert wanted == [("RESTING", "operator")]
    # It walks for as long as its program needs to come to a stop, and is held all the way down.
    assert found.packets[:51] == [found.packets[0]] + [STAND_ON] * 50
    assert found.damped > 1000
    assert all(unpack_orders(data, A1).kp.all() for data in found.packets[: found.damped])
    assert all(damping(data) for data in found.packets[found.damped :])


def test_a_remote_that_is_switched_off_ends_a_walk_as_the_operator_would(stage):
    rig = stage.at(State.WALK)

    def happens():
        begun = rig.inject("button=off")
        rig.turn(LOST // ROUND - 1)
        before = [event for event in rig.client.events if event["event"] == "wanted"]
        rig.turn(2)
        wanted = [
            (event["state"], event["word"]) for event in rig.client.events if event["event"] == "wanted"
        ]
        rig.client.ask("halt")
        rig.until(State.LYING_DOWN)
        return ended(rig, begun), before, wanted

    found, before, wanted = apart(happens)
    assert before == []
    assert wanted == [("RESTING", "operator")]
    assert (found.state, found.word) == ("LYING_DOWN", "operator")
    assert all(unpack_orders(data, A1).kp.all() for data in found.packets)


@pytest.mark.parametrize(
    ("do", "obeys", "state"),
    [("lie", False, State.STAND), ("halt", False, State.STAND), ("stop", True, State.LYING_DOWN)],
)
def test_a_soft_stop_needs_no_program_that_obeys(stage, do, obeys, state):
    rig = stage.at(State.WALK)
    found, wanted = apart(lambda: stopped(rig, do, obeys, state))
    assert (found.state, found.word) == (state, "operator")
    assert wanted == [("STAND" if do == "halt" else "RESTING", "operator")]
    assert all(unpack_orders(data, A1).kp.all() for data in found.packets)


def test_a_full_disk_lets_the_robot_lie_down(stage, tmp_path):
    rig = stage.at(State.WALK)

    def happens():
        begun = rig.twin.rounds
        resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, -1))  # as if no more fits: 200 rounds
        reply = rig.ask(rig.client, "record", path=str(tmp_path / "full.a1log"), header={})
        rig.until(State.RESTING, 3000)
        rig.turn(2)
        return ended(rig, begun, [reply])

    found = apart(happens)
    assert found.replies[0]["ok"]
    assert (found.state, found.word) == ("RESTING", "disk")
    assert found.damped > 1000
    assert os.path.getsize(tmp_path / "full.a1log") <= 300_000


def test_a_raw_recording_says_why_the_walk_ended_though_nobody_is_left(stage, tmp_path):
    rig, path = stage.at(State.WALK), tmp_path / "walk.a1log"

    def happens():
        rig.ask(rig.client, "halt")
        assert rig.ask(rig.client, "record", path=str(path), header={})["ok"]
        assert rig.ask(rig.client, "walk")["ok"]
        rig.turn(20)
        rig.inject("tilt=0.6")
        rig.turn(2)
        until(lambda: len(rawlog.read(path).events) == 2)  # the thread that writes must have its turn

    apart(happens)  # all of it ends here, as by SIGKILL
    log = rawlog.read(path)
    assert not log.finished
    assert [event["state"] for event in log.events] == ["WALK", "DAMPING"]
    assert recording.ending_of(log)[:2] == ("fall", log.events[-1]["reason"])
    assert "0.5 rad" in log.events[-1]["reason"]


@rows(State.LYING_DOWN)
def test_lying_down_it_ends_in_damping_and_no_gain_follows(stage, state, fault):
    ends_in_damping(stage.at(state), fault)


def every_fault():
    for kind in KINDS:
        if kind == "nan":
            yield from (f"nan={name}" for name in NUMBERS)
        else:
            yield kind


def test_no_fault_before_the_second_consent_sends_a_gain():
    for fault in every_fault():
        rig = Rig()
        rig.turn(3)
        assert rig.received == []  # before the first consent nothing leaves
        rig.operator.ask("connect")
        rig.operator.ask("arm")
        rig.turn(5)
        rig.inject(fault)
        rig.turn(20)
        sent = [data for _, data in rig.received]
        assert len(sent) >= 20, fault
        assert all(limp(data) for data in sent), fault
        assert rig.state is State.LINKED
        rig.close()
