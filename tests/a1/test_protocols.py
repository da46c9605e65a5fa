"""Protocols on the robot: its references, the guard's states for them, the dialogue, and the whole path on a twin."""

import numpy as np
import pytest

from benchmarks.a1.protocols import as_sent
from s2r_a1 import attendance, hands, rawlog
from s2r_a1.backend import A1Backend
from s2r_a1.excitation import GOING, SHARES, Player, plan
from s2r_a1.guard import moves
from s2r_a1.guard.checks import clip
from s2r_a1.guard.limits import LIMITS
from s2r_a1.guard.states import State
from s2r_a1.protocols import PROTOCOLS, height_in_rig
from s2r_a1.twin import Twin, TwinSettings, read_inject
from s2r_a1.twin.options import read_options as read_twin
from s2r_a1.wire import Orders
from s2r_sim.controller.gains import RATE
from s2r_sim.plant.noise import Noise
from s2r_sim.protocols.references import reference
from s2r_sim.protocols.simulator import protocol_simulator
from s2r_sim.settings import Settings
from s2r_spec.backend import Coming
from s2r_spec.errors import NotBegunError, StoppedError, UsageError
from s2r_spec.protocols import HasPlayable, HasProtocols, write_playable
from tests.a1.guarding import Rounds, at, leaning, reading, walking
from tests.a1.robots import Silent, served
from tests.a1.steering import LIMP, steer
from tests.a1.test_attendance import Guard, Person
from tests.errors import naming, states

ROBOT = "host=192.168.123.10,velocity=onboard"
NAMES = [protocol.name for protocol in PROTOCOLS]


@pytest.mark.parametrize("protocol", PROTOCOLS, ids=NAMES)
def test_the_guard_passes_every_reference_on_unchanged(protocol, tmp_path):
    backend = A1Backend(ROBOT)
    assert isinstance(backend, HasProtocols)
    assert isinstance(backend, HasPlayable)
    gain = next(p for p in protocol.parameters if p.name == "gain")
    for value in (gain.low, gain.default, gain.high):
        played = backend.playable(protocol.name, {"gain": value})
        same = reference(protocol.name, gain=value)
        assert np.array_equal(played["q"], same.q)
        one, zero = np.ones(12), np.zeros(12)
        for i in range(0, len(played), 25):
            orders = Orders(
                played["q"][i], played["dq"][i], played["kp"][i] * one, played["kd"][i] * one, zero
            )
            assert clip(LIMITS, orders)[1] == 0
    with pytest.raises(UsageError, match=naming("gain")):
        backend.playable(protocol.name, {"gain": gain.high + 0.01})
    words = write_playable(backend, protocol.name, {}, tmp_path / "play.csv")
    assert states(words, "2 ms", "play.csv", *([protocol.risk] if protocol.risk else []))


def played(protocol, stop=None, lost=(), **settings):
    """Return notes and readings of a robot that goes where it is sent, with lost readings and a stop at a tick."""
    player = Player(
        plan(protocol, settings.get("amplitude", 1.0), 0.8, settings.get("seconds", np.inf)), "ms"
    )
    q, notes = moves.STANDING, []
    for round_ in range(30_000):
        if round_ in lost:
            continue
        note = player.step(reading(q, tick=1000 + 2 * round_))
        notes.append(note)
        q = note.done.motors.q if note.done.motors.kp.any() else q
        if stop is not None and note.tick == stop:
            player.stop()
        if player.is_done(note):
            return notes
    raise AssertionError("the player does not end")


def test_a_run_goes_from_the_stand_to_the_protocol_and_back_without_a_jump():
    notes = played("squat")
    q = np.array([note.done.motors.q for note in notes])
    assert np.abs(q[0] - moves.STANDING).max() < 0.01
    assert np.abs(q[-1] - moves.STANDING).max() < 1e-9
    assert np.abs(np.diff(q, axis=0)).max() < 0.02
    itself = [note for note in notes if 0 <= note.tick <= 2.0 * RATE]
    assert [note.tick for note in itself] == list(range(1001))
    assert np.array_equal([note.done.motors.q for note in itself], reference("squat", 1.0, 0.8).q)


def test_a_rehearsal_is_smaller_and_shorter():
    small = played("hold", amplitude=0.25, seconds=2.0)
    itself = np.array([note.done.motors.q for note in small if 0 <= note.tick <= 2.0 * RATE])
    assert len(small) - len(itself) < (2.0 * GOING + 1.0) * RATE
    assert np.array_equal(itself, reference("hold", 0.25, 0.8).q[:1001])


def test_lost_readings_do_not_delay_a_protocol_and_a_stop_ends_it():
    whole, some = played("sway"), played("sway", lost={1000, 1001, 1300})
    by_tick = {note.tick: note for note in whole if note.tick >= 0}
    for note in some:
        if note.tick >= 0:
            assert np.array_equal(note.done.motors.q, by_tick[note.tick].done.motors.q)
    assert sum(note.late for note in some if note.tick >= 0) == 3
    stopped = played("sway", stop=300)
    assert len(whole) - len(stopped) == 1001 - 301


@pytest.mark.parametrize("state", [State.EXCITE, State.EXCITE_HELD])
def test_the_guard_damps_in_both_states_of_a_protocol(state):
    for fault, word in (
        ({"quaternion": leaning(LIMITS.tilt + 0.01)}, "fall"),
        ({"temperature": at(np.full(12, 30.0), 4, LIMITS.hot)}, "heat"),
        ({"silent": True}, "link"),
    ):
        rounds = Rounds().bring(state)
        rounds.turn(20, walking(), **fault)
        assert (rounds.state, rounds.machine.word) == (State.DAMPING, word)
    rounds = Rounds().bring(state)
    rounds.turn(20)
    assert (rounds.state, rounds.machine.word) == (State.DAMPING, "client")


def test_height_and_joint_limits_hold_on_the_ground_and_not_in_a_rig():
    folded = np.tile([0.0, 1.2, -2.6], 4)
    stop = at(moves.STANDING, 2, LIMITS.highest[2])
    for pose, word in ((folded, "fall"), (stop, "joint")):
        for state in (State.EXCITE, State.EXCITE_HELD):
            rounds = Rounds().bring(state)
            rounds.turn(5, Orders(pose, np.zeros(12), np.full(12, 20.0), np.full(12, 1.0), np.zeros(12)))
            damped = state is State.EXCITE
            assert rounds.state is (State.DAMPING if damped else state)
            assert rounds.machine.word == (word if damped else None)


def test_a_protocol_begins_in_the_stand_alone():
    for state in (State.ARMED, State.RESTING, State.WALK):
        assert "STAND" in Rounds().bring(state).ask("excite_held")


@pytest.fixture
def scene(monkeypatch):
    events = []
    guard, person = Guard(events, "ARMED"), Person(events)
    monkeypatch.setattr(attendance, "start", lambda robot: (guard, {"state": guard.state}))
    return events, person, A1Backend(ROBOT).attendance(person)


def one(name):
    return next(protocol for protocol in PROTOCOLS if protocol.name == name)


def test_the_risk_of_a_protocol_is_accepted_before_its_first_run(scene):
    events, person, attended = scene
    attended.begin(Coming(3))
    events.clear()
    attended.before_protocol(one("air_coast"), {"amplitude": 1.0})
    assert events == ["type play", "choose '2'"]
    assert states(person.said[-1], "air_coast", "amplitude = 1", "0.6 m")
    events.clear()
    attended.before_protocol(one("air_coast"), {})
    assert events == ["choose ''"]
    person.answers = ["q"]
    with pytest.raises(StoppedError):
        attended.before_protocol(one("squeeze"), {})


def test_what_lies_in_a_datagram_of_hands():
    assert hands.read(hands.encode(0.3)) == (0.3,)
    assert hands.read(hands.encode(None)) == (None,)
    for data in (b"", b"s2r hands 1 [", b's2r hands 1 {"rig": 99}', b's2r hands 1 {"rig": "x"}', bytes(610)):
        assert hands.read(data) is None


def test_a_twin_in_a_rig_hangs_level_and_still():
    twin = Twin(TwinSettings(place="nominal", noise=False, rig=0.6))
    limp = steer(twin, LIMP, 400)
    truth = twin.truth()
    assert truth.position == pytest.approx([0.0, 0.0, 0.6], abs=1e-9)
    assert truth.rpy == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert limp.accelerometer == pytest.approx([0.0, 0.0, 9.81], abs=1e-6)
    assert not limp.foot_force.any()
    twin.put(None)
    steer(twin, LIMP, 50)
    assert twin.truth().position[2] < 0.1


def test_a_twin_can_be_started_in_a_rig():
    assert read_twin(["--rig", "0.6"]).twin.rig == 0.6
    for wrong in ("9", "low", "nan"):
        with pytest.raises(UsageError, match=naming("--rig", repr(wrong), "3 m")):
            read_twin(["--rig", wrong])


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """A twin without noise, who attends to it, and its backend: one robot for the whole module."""
    folder = tmp_path_factory.mktemp("a1")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("S2R_A1_RUN", str(folder / "run"))
        twin = Twin(TwinSettings(place="nominal", delay=1, noise=False))
        with served(twin) as port:
            options = f"host=127.0.0.1,port={port},velocity=onboard,operator=auto,clock=lockstep"
            backend = A1Backend(options).keeping(str(folder / "raw"))
            attended = backend.attendance(Silent())
            attended.begin(Coming(None))
            yield twin, backend, attended, folder / "raw"
            attended.end()


def test_a_protocol_through_the_wire_is_the_simulators_under_what_was_sent(robot):
    """Delay of a tick and truncated gains explain the whole difference, up to counts and single precision."""
    twin, backend, attended, raw = robot
    attended.before_protocol(one("air_coast"), {})
    trace = backend.run("air_coast", {}, 1)
    assert twin.truth().position[2] == pytest.approx(0.6)
    assert (len(trace), trace.failure, trace.meta["protocol"]) == (451, None, "air_coast")
    assert trace.meta["params"] == {"amplitude": 1.0, "gain": 1.0}
    channels, _ = protocol_simulator(Settings()).run(as_sent(reference("air_coast"), 1), Noise.off(), 1)
    for name, most in (("q", 1e-3), ("dq", 0.02), ("tau", 0.03)):
        assert np.sqrt(np.mean((trace[name] - channels[name]) ** 2)) < most, name
    assert excited(raw, trace) == 1 + len(SHARES)  # it is rehearsed first


def excited(raw, trace):
    """Return how often the guard let a protocol move the robot, by a recording."""
    events = rawlog.read(raw / trace.meta["raw"]).events
    return sum(event.get("state") == "EXCITE_HELD" for event in events)


def test_a_fall_in_a_protocol_is_recorded_and_one_before_it_is_no_run(robot):
    twin, backend, attended, raw = robot

    def tilts():
        twin.injects = (read_inject(f"tilt=0.6@{twin.rounds + 20}-{twin.rounds + 200}"),)

    attended.before_protocol(one("air_coast"), {})
    trace = backend.saying(tilts).run("air_coast", {"amplitude": 0.25}, 1)
    assert (trace.failure, trace.meta["protocol"]) == ("fall", "air_coast")
    assert len(trace) < 200
    assert excited(raw, trace) == 1  # the gain was rehearsed before
    assert height_in_rig("air_coast") == pytest.approx(twin.truth().position[2])
    attended.before_protocol(one("air_coast"), {})
    twin.injects = (read_inject(f"tilt=0.6@{twin.rounds + 1350}-{twin.rounds + 1450}"),)
    with pytest.raises(NotBegunError, match=naming("air_coast", "tilted")):
        backend.run("air_coast", {"gain": 0.9}, 1)  # which is rehearsed first
    twin.injects = ()
