"""One test, walked by the simulator's plant in the process of the test, under a guard that agrees to everything."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest

from s2r_a1 import recording
from s2r_a1.client import StateChange
from s2r_a1.pilot import Pilot
from s2r_a1.rawlog import RawLogWriter
from s2r_a1.schedule import Schedule
from s2r_a1.walk import SETTLING, rest, walk
from s2r_a1.wire import A1, Orders, pack, pack_reading, unpack, unpack_orders
from s2r_sim.controller.gains import RATE
from s2r_sim.controller.trot import Controller, Memory
from s2r_sim.plant.sensors import Sensors
from s2r_sim.robot.signals import MotorCommand, VelocityCommand
from s2r_sim.settings import Settings
from s2r_spec.errors import BackendError, NotBegunError, TraceError
from tests.a1.plant import HOLDING, PlantLine, reading

COMMAND = VelocityCommand(0.25, 0.0, 0.2)
TICKS = 50
SETTINGS = Settings()
PLANNED = Schedule.of(COMMAND, 3, TICKS, SETTINGS.gains)
SCHEDULE = replace(PLANNED, trot=PLANNED.trot - 400)
"""As planned, but with two gait periods less of trotting in place."""


@pytest.fixture(scope="module")
def pilot():
    made = Pilot(SETTINGS)
    made.practise()
    return made


@pytest.fixture(scope="module")
def walked(pilot):
    line = PlantLine()
    return line, walk(line, pilot, SCHEDULE)


def written(tmp_path, line, schedule=SCHEDULE, packets=None, events=()):
    """Return the path of a raw recording of what went over a line, and of (time, event) of a guard."""
    about = {"layout": "a1", "tick_unit": "ms", "seed": 3}
    writer = RawLogWriter(tmp_path / "walk.a1log", recording.header_of({"vd": 0.25}, schedule, about))
    for at, (direction, data) in enumerate(line.packets[:packets]):
        writer.append(at * 1_000_000, direction, data)
    for at, event in events:
        writer.note(at * 1_000_000, event)
    writer.close()
    return tmp_path / "walk.a1log"


def test_a_computer_that_delays_the_walking_program_is_found_before_the_walk(pilot, monkeypatch):
    line = PlantLine()
    line.lockstep = False
    step, steps = pilot.step, []

    def late(reading):
        steps.append(reading)
        if len(steps) == 50:
            time.sleep(0.03)
        return step(reading)

    monkeypatch.setattr(pilot, "step", late)
    with pytest.raises(
        NotBegunError, match=r"too slow for a robot: it delayed the walking program by \d+ ms"
    ):
        walk(line, pilot, SCHEDULE)
    assert line.change.state == "STAND"
    assert len(steps) > 200


def test_a_walk_goes_as_planned_and_ends_standing(walked):
    line, done = walked
    assert done.ending is None
    assert line.change.state == "STAND"
    ticks = [note.tick for note in done.notes]
    assert ticks == list(range(-SCHEDULE.trot, ticks[-1] + 1))
    assert all(note.late == 0 for note in done.notes)
    assert all(done.notes[-1].done.stance)
    assert [note.command for note in done.notes if note.tick in (-1, 0)] == [VelocityCommand(), COMMAND]
    assert line.plant.truth().position[2] == pytest.approx(0.27, abs=0.015)


def test_the_walk_is_the_simulator_s_own_until_a_foot_touches_down(walked):
    """The same start, controller and estimator in the simulator's own loop, readings exact, commands as on the wire."""
    line, done = walked
    plant = PlantLine().plant
    none = np.zeros(12)
    kp, kd = HOLDING
    held = pack(Orders(line.stand, none, np.full(12, kp), np.full(12, kd), none), A1)
    sensors = Sensors(SETTINGS.robot, SETTINGS.physics, "estimate")
    controller = Controller(SETTINGS.robot, SETTINGS.gains)
    controller.restore(Memory())
    for _ in range(SETTLING):
        plant.step(MotorCommand(*unpack_orders(held, A1)), -math.inf)
    touch_down = 100  # of the first pair of feet, after a swing of 90 ticks
    for tick in range(touch_down):
        truth = plant.truth()
        np.testing.assert_allclose(done.notes[tick].state.q, truth.q, atol=1e-3)
        measured = sensors.read(truth, plant.play, controller.stance)
        decided = controller.tick(measured, VelocityCommand()).motors
        plant.step(MotorCommand(*unpack_orders(pack(Orders(*decided), A1), A1)), -math.inf)


def test_two_walks_are_the_same_bit_for_bit(walked, pilot):
    line, done = walked
    again = PlantLine()
    walk(again, pilot, SCHEDULE)
    assert again.packets == line.packets
    assert len(done.notes) > SCHEDULE.trot


def test_a_trace_is_made_of_the_packets_with_or_without_the_worker_s_notes(walked, tmp_path, pilot):
    line, done = walked
    path = written(tmp_path, line)
    trace = recording.trace_of(path, done.notes)
    again = recording.trace_of(path, pilot=pilot)
    assert trace.times.tolist() == (np.arange(TICKS + 1) / RATE).tolist()
    for name, values in trace.channels.items():
        np.testing.assert_array_equal(values, again[name], err_msg=name)
    assert trace.failure is None
    assert trace.meta["params"] == {"vd": 0.25}
    assert trace.meta["late"] == trace.meta["qp_failures"] == 0
    at = next(note for note in done.notes if note.tick == 7)
    np.testing.assert_array_equal(trace["q"][7], at.state.q)
    assert trace["vx_cmd"].tolist() == [0.25] * (TICKS + 1)
    # The motors did what they were asked for, within the rounding of the wire and 2 ms.
    assert np.abs(trace["tau"] - trace["tau_cmd"]).mean() < 0.5


def test_what_a_killed_worker_leaves_is_a_trace_up_to_there(walked, tmp_path, pilot):
    line, done = walked
    whole = recording.trace_of(written(tmp_path, line), done.notes)
    (tmp_path / "walk.a1log").unlink()
    tick = next(i for i, note in enumerate(done.notes) if note.tick == 20)
    before_walk = len(line.packets) - sum(direction == 1 for direction, _ in line.packets) - len(done.notes)
    part = recording.trace_of(written(tmp_path, line, packets=SETTLING + 2 + 2 * tick), pilot=pilot)
    assert before_walk > 0
    assert 15 < len(part) < 30
    shared = len(part) - 2  # of the last samples the next state, or the orders, are missing
    for name in ("q", "tau", "tau_cmd", "vx_est", "acc_pred"):
        np.testing.assert_array_equal(part[name][:shared], whole[name][:shared])


AT_20 = SETTLING + 2 + 2 * (SCHEDULE.trot + 20)
"""The packet of the state at tick 20."""


@pytest.mark.parametrize(
    ("event", "at", "word", "meta"),
    [
        ("state", AT_20, "fall", {"failure": "fall"}),
        ("state", AT_20, "link", {"void": "link"}),
        ("wanted", AT_20, "operator", {"void": "operator"}),
        ("state", 10**6, "fall", {"after": "fall"}),
        ("state", 10**6, None, {}),
    ],
)
def test_a_recording_alone_says_why_its_walk_ended_and_ends_there(
    walked, tmp_path, pilot, event, at, word, meta
):
    line, _ = walked
    reason = "a sentence" if word else None
    events = [(0, {"event": "state", "state": "WALK", "word": None})]
    if event == "wanted":
        events.append((at, {"event": "wanted", "state": "RESTING", "word": word, "reason": reason}))
        at += 500
    events.append((at, {"event": "state", "state": "STAND", "word": word, "reason": reason}))
    found = recording.trace_of(written(tmp_path, line, events=events), pilot=pilot)
    assert {name: found.meta[name] for name in ("failure", "void", "after") if name in found.meta} == meta
    assert found.meta.get("reason") == reason
    early = "failure" in meta or "void" in meta
    assert (15 < len(found) < 25) if early else len(found) == TICKS + 1


def test_a_recording_that_ends_before_the_command_is_no_trace(walked, tmp_path, pilot):
    line, _ = walked
    with pytest.raises(TraceError, match="before the command"):
        recording.trace_of(written(tmp_path, line, packets=SETTLING + 200), pilot=pilot)


def test_lost_states_leave_the_gait_on_the_robot_s_clock(pilot, tmp_path):
    lost = {SETTLING + SCHEDULE.trot + tick for tick in (10, 83, 84)}
    line = PlantLine(lost=lost)
    done = walk(line, pilot, SCHEDULE)
    assert done.ending is None
    assert sum(note.late for note in done.notes) == len(lost)
    period = 200
    for note in done.notes:
        left = (note.tick + SCHEDULE.trot) % period < 110
        assert note.done.stance[0] == left
    trace = recording.trace_of(written(tmp_path, line), done.notes)
    assert trace["late"].sum() == 1.0
    assert len(trace) == TICKS
    assert trace.times[-1] == TICKS / RATE


def test_a_fall_after_the_command_ends_the_walk_there(pilot):
    line = PlantLine()
    fall = StateChange("DAMPING", "fall", "the base is tilted by 0.6 rad")
    line.endings[SETTLING + 1 + SCHEDULE.trot + 30] = fall
    done = walk(line, pilot, SCHEDULE)
    assert done.ending == fall
    assert 25 < done.notes[-1].tick < 35


def test_orders_that_no_motor_can_follow_are_the_robot_s_failure(pilot):
    line = PlantLine()
    send = line.send

    def refused(orders):
        if orders and line.rounds == SETTLING + SCHEDULE.trot + 20:
            orders = orders._replace(tau=np.full(12, 500.0))
        send(orders)

    line.send = refused
    done = walk(line, pilot, SCHEDULE)
    assert done.ending.word == "torque"
    assert "500" in done.ending.reason
    assert line.change.state == "DAMPING"


def test_a_guard_that_does_nothing_any_more_is_a_broken_link_and_not_the_robot_s(pilot):
    line = PlantLine()
    receive = line.receive

    def stuck():
        if line.rounds == SETTLING + SCHEDULE.trot + 20:
            raise BackendError("the guard has done nothing")
        return receive()

    line.receive = stuck
    done = walk(line, pilot, SCHEDULE)
    assert done.ending.word == "link"
    assert 15 < done.notes[-1].tick < 25


def test_before_the_command_there_is_no_rollout(pilot):
    line = PlantLine()
    line.endings[SETTLING + 150] = StateChange("DAMPING", "link", "no state for 20 ms")
    with pytest.raises(NotBegunError, match="no state for 20 ms"):
        walk(line, pilot, SCHEDULE)


def test_a_walk_that_is_to_stop_ramps_down_and_stands(pilot):
    line = PlantLine()
    receive, stop = line.receive, StateChange("RESTING", "operator", "the operator asked the robot to lie")

    def asked_to_stop():
        if line.rounds == SETTLING + SCHEDULE.trot + 20:
            line.wanted = stop
        return receive()

    line.receive = asked_to_stop
    done = walk(line, pilot, SCHEDULE)
    assert done.ending == stop
    assert line.change.state == "STAND"
    assert 15 < done.notes[-1].tick < 25
    assert SCHEDULE.trot + 20 + RATE // 2 < line.rounds - 2 * SETTLING < SCHEDULE.trot + 30 + RATE // 2 + 110


def test_a_reading_becomes_the_state_that_it_was_made_of():
    line = PlantLine()
    truth = line.plant.truth()
    seen = unpack(pack_reading(reading(line.plant, truth.velocity, 4), A1), A1)
    pilot = Pilot(SETTINGS)
    pilot.begin(SCHEDULE, "ms")
    state = pilot.step(seen).state
    np.testing.assert_allclose(state.q, truth.q, atol=1e-6)
    np.testing.assert_allclose(state.rpy[:2], truth.rpy[:2], atol=1e-6)
    assert state.rpy[2] == 0.0


class SettlingLine:
    """A robot that still settles when it is asked to lie down."""

    def __init__(self):
        self.states = ["STAND"] * 3 + ["LYING_DOWN"] * 3 + ["RESTING"] * 9
        self.change = StateChange("STAND")
        self.requests = []

    def request(self, do):
        self.requests.append(do)

    def send(self, orders):
        assert orders is None

    def receive(self):
        self.change = StateChange(self.states.pop(0))


def test_a_robot_that_settles_first_lies_when_it_is_said_to():
    line = SettlingLine()
    rest(line)
    assert line.requests == ["lie"]
    assert line.change.state == "RESTING"
    assert len(line.states) == 8
