"""The dialogue around the rollouts of a robot: what is asked, in which order, and what is sent only then."""

import os

import numpy as np
import pytest

from s2r_a1 import attendance
from s2r_a1.backend import A1Backend
from s2r_a1.guard.control import ControlError, RefusedError
from s2r_spec.backend import Coming
from s2r_spec.errors import BackendError, NotBegunError, StoppedError
from s2r_spec.trace import Trace

AFTER = {"connect": "LINKED", "arm": "ARMED", "reset": "LINKED", "lie": "RESTING", "damp": "DAMPING"}


class Guard:
    """A guard's connection that does at once what it is asked for."""

    def __init__(self, events, state="OFF"):
        self.events, self.state = events, state
        self.warmest, self.refuses, self.gone = 30.0, {}, False
        self.rounds = 0

    def request(self, do, **fields):
        if do != "status":
            self.events.append(do)
        if self.gone:
            raise ControlError("the guard has ended")
        if do in self.refuses:
            raise BackendError(self.refuses[do])
        self.state = AFTER.get(do, self.state)
        self.rounds += 2000
        temperatures = [25.0] * 11 + [self.warmest]
        return {"state": self.state, "temperatures": temperatures, "reason": "it fell", "rounds": self.rounds}

    def close(self):
        self.events.append("close")
        self.gone = False


class Person:
    """An operator who types what is asked, or the next of the answers that were prepared; "q" stops."""

    def __init__(self, events):
        self.events, self.answers = events, []
        self.said = []

    def say(self, text):
        self.said.append(text)

    def type_word(self, question, word):
        self.events.append(f"type {word}")
        if self.answers and self.answers.pop(0) == "q":
            raise StoppedError("the operator stopped the run")

    def choose(self, question, answers):
        self.said.append(question)
        typed = self.answers.pop(0) if self.answers else next(iter(answers))
        self.events.append(f"choose {typed!r}")
        if typed == "q":
            raise StoppedError("the operator stopped the run")
        assert typed in answers
        return typed


@pytest.fixture
def scene(monkeypatch):
    """Give a function that returns events, guard, person and attendance of a robot."""

    def made(state="OFF", options="host=192.168.123.10,robot=a1-07,velocity=onboard"):
        events = []
        guard, person = Guard(events, state), Person(events)
        monkeypatch.setattr(attendance, "start", lambda robot: (guard, {"state": guard.state}))
        return events, guard, person, A1Backend(options).attendance(person)

    return made


def trace(**meta):
    return Trace(np.array([0.0, 1.5]), {"motor_temperature": np.full((2, 12), 31.0)}, {}, meta)


def test_nothing_is_sent_before_either_consent(scene):
    events, _, person, attended = scene()
    attended.begin(Coming(30))
    assert events == ["type connect", "connect", "type arm", "arm"]
    assert not getattr(attended, "unattended", False)
    assert any("30" in text and " m " in text and "min" in text for text in person.said)


def test_who_does_not_consent_has_sent_nothing(scene):
    events, _, person, attended = scene()
    person.answers = ["q"]
    with pytest.raises(StoppedError):
        attended.begin(Coming(None))
    assert events == ["type connect"]
    attended.end()
    assert events == ["type connect", "close"]


def test_a_robot_that_an_earlier_run_armed_needs_consent_again(scene):
    events, _, _, attended = scene("RESTING")
    attended.begin(Coming(1))
    assert events == ["type arm"]


def test_a_robot_that_another_run_holds_is_left_to_it(scene, monkeypatch):
    events, guard, _, attended = scene("STAND")
    status = {"state": "STAND", "operators": [os.getpid(), os.getpid() + 1]}
    monkeypatch.setattr(attendance, "start", lambda robot: (guard, status))
    with pytest.raises(BackendError, match=str(os.getpid() + 1)):
        attended.begin(Coming(1))
    attended.end()
    assert events == ["close"]


def test_a_damped_robot_is_reset_by_the_operator_alone_and_armed_anew(scene):
    events, guard, person, attended = scene("ARMED")
    attended.begin(Coming(2))
    guard.state = "DAMPING"
    events.clear()
    attended.before({"vd": 0.1})
    assert events == ["choose 'r'", "reset", "type arm", "arm", "choose '2'"]
    assert any("it fell" in text for text in person.said)


def test_a_robot_that_is_damped_just_before_it_lies_down_ends_the_run(scene, monkeypatch):
    events, guard, _, attended = scene("ARMED")
    attended.begin(Coming(1))
    guard.state = "STAND"
    request = guard.request

    def damped(do, **fields):
        if do == "lie":
            guard.state = "DAMPING"
            raise RefusedError("the robot is damped")
        return request(do, **fields)

    monkeypatch.setattr(guard, "request", damped)
    attended.end()
    assert events[-1] == "close"


def test_a_backward_walk_needs_its_free_floor_behind(scene):
    _, _, person, attended = scene("ARMED")
    attended.begin(Coming(2))
    attended.before({"vd": 0.1})
    assert "ahead" in person.said[-1]
    attended.before({"vd": -0.1})
    assert "behind" in person.said[-1]


def test_a_robot_that_only_stands_needs_no_floor(scene):
    _, _, person, attended = scene()
    attended.begin(Coming(0))
    assert not any("rollouts" in text for text in person.said)


def test_what_the_guard_refuses_is_no_rollout(scene):
    _, guard, _, attended = scene("ARMED")
    attended.begin(Coming(1))
    guard.state, guard.refuses = "DAMPING", {"arm": "FR hip is too warm"}
    with pytest.raises(NotBegunError, match="FR hip"):
        attended.before({"vd": 0.1})


def test_a_rest_comes_every_ten_tests_and_can_be_skipped(scene):
    events, _, person, attended = scene("ARMED")
    attended.begin(Coming(11))
    for _ in range(10):
        attended.before({"vd": 0.1})
        attended.after(trace())
    events.clear()
    person.answers = ["s"]
    attended.before({"vd": 0.1})
    assert events == ["choose 's'", "choose '2'"]
    attended.after(trace())
    events.clear()
    attended.before({"vd": 0.1})
    assert events == ["choose ''"]


def test_the_battery_s_lights_are_asked_for_and_kept_until_the_next_test(scene):
    _, _, person, attended = scene("ARMED")
    attended.begin(Coming(12))
    kept, offered, choose = [], [], person.choose
    person.choose = lambda question, answers: offered.append(set(answers)) or choose(question, answers)
    for typed in ("3", "", "4"):
        person.answers = [typed]
        attended.before({"vd": 0.1})
        kept.append(attended.answers)
        attended.after(trace())
    assert kept == [{"battery_lights": "3"}, {}, {"battery_lights": "4"}]
    # The first test, before which nobody has looked, begins with no less than two.
    assert offered == [{"2", "3", "4"}, {"", "2", "3", "4"}, {"", "2", "3", "4"}]


def test_a_warm_motor_rests_until_it_is_cool(scene):
    events, guard, person, attended = scene("ARMED")
    attended.begin(Coming(2))
    guard.warmest = 55.0
    events.clear()
    choose = person.choose

    def cools(question, answers):
        guard.warmest -= 6.0
        return choose(question, answers)

    person.choose = cools
    attended.before({"vd": 0.1})
    assert events == ["choose ''"] * 2 + ["choose '2'"]  # 49 °C, 43 °C, and the test
    assert any("55" in text for text in person.said)


@pytest.mark.parametrize(
    ("meta", "word"),
    [({"failure": "fall", "reason": "tilted"}, "fall"), ({"void": "link", "reason": "silent"}, "void")],
)
def test_how_a_rollout_ended_is_said(scene, meta, word):
    _, _, person, attended = scene("ARMED")
    attended.begin(Coming(1))
    attended.after(trace(**meta))
    assert word in person.said[-1]
    assert meta["reason"] in person.said[-1]
    attended.after(None)


def test_missed_ticks_and_late_poses_of_a_complete_rollout_are_said(scene):
    _, _, person, attended = scene("ARMED")
    attended.begin(Coming(1))
    attended.after(trace(late=3, mocap={"delay": 0.48}))
    assert "3 of 5 control ticks missed" in person.said[-1]
    assert "0.48 s late" in person.said[-1]
    attended.after(trace(late=0, mocap={"delay": 0.01}))
    assert "missed" not in person.said[-1]
    assert "late" not in person.said[-1]


def test_ctrl_c_lets_it_lie_and_a_second_one_damps(scene):
    events, _, _, attended = scene("ARMED")
    attended.interrupt(urgent=False)
    attended.begin(Coming(1))
    events.clear()
    attended.interrupt(urgent=False)
    attended.interrupt(urgent=True)
    assert events == ["lie", "damp"]


def test_after_the_guard_s_end_a_new_one_needs_both_consents(scene):
    events, guard, _, attended = scene("ARMED")
    attended.begin(Coming(1))
    guard.gone, guard.state = True, "OFF"
    events.clear()
    attended.before({"vd": 0.1})
    assert events == ["close", "type connect", "connect", "type arm", "arm", "choose '2'"]
    guard.gone = True
    attended.end()
    assert events[-1] == "close"


@pytest.mark.parametrize(("state", "done"), [("STAND", ["lie", "close"]), ("RESTING", ["close"])])
def test_at_the_end_the_robot_lies(scene, state, done):
    events, guard, _, attended = scene("ARMED")
    attended.begin(Coming(1))
    guard.state = state
    events.clear()
    attended.end()
    attended.end()
    assert events == done


def test_a_robot_that_does_not_come_to_lie_is_not_waited_for_without_end(scene):
    events, guard, _, attended = scene("ARMED")
    attended.begin(Coming(1))
    guard.state = "LYING_DOWN"
    with pytest.raises(BackendError, match="LYING_DOWN"):
        attended.end()
    assert events[-1] == "close"
    assert guard.rounds > 10_000  # 20 s, by the guard's clock


def test_nobody_is_asked_about_a_twin_that_runs_by_itself(scene):
    events, guard, person, attended = scene(options="host=127.0.0.1,velocity=onboard,operator=auto")
    assert attended.unattended
    attended.begin(Coming(3))
    guard.state, guard.warmest = "DAMPING", 49.0
    attended.before({"vd": 0.1})
    attended.after(trace())
    assert events == ["connect", "arm", "reset", "arm"]
    assert any("twin" in text for text in person.said)
    assert sum("operator=auto" in text for text in person.said) == 1
