"""What an operator sees of a robot before its motors have a torque."""

import os
from math import cos, sin

import numpy as np
import pytest

from s2r_a1.guard.limits import LIMITS
from s2r_a1.guard.place import RobotAddress
from s2r_a1.guard.start import start
from s2r_a1.guard.states import State
from s2r_a1.status import MOTIONS, SeenAngles, view, watch
from s2r_a1.twin import Twin, TwinSettings
from s2r_sim.robot.constants import A1, LEGS
from s2r_sim.robot.leg_kinematics import foot_motion
from s2r_spec.errors import UsageError
from tests.a1.rig import Rig, limp
from tests.a1.robots import end_guard, served


@pytest.fixture
def rig():
    rig = Rig(noise=False)
    assert next(rig.bring(State.LINKED)) is State.LINKED
    yield rig
    rig.close()


def look(rig):
    """Return the guard's status, as the view gets it."""
    return rig.ask(rig.operator, "status")


def joints(lines):
    """Return the row of each joint."""
    return {line[:9].strip(): line for line in lines if line[:2] in ("FR", "FL", "RR", "RL")}


def test_a_terminal_of_80_columns_shows_every_joint_in_its_range(rig):
    lines = view(look(rig), SeenAngles())
    assert max(map(len, lines)) <= 80
    rows = joints(lines)
    assert len(rows) == 12
    for joint, (low, high) in enumerate(zip(*LIMITS.span, strict=True)):
        row = list(rows.values())[joint]
        assert f"{rig.twin.truth().q[joint]:+.2f}" in row
        assert f"{low:+.2f}" in row
        assert f"{high:+.2f}" in row
    text = "\n".join(lines)
    assert all(word in text for word in ("the twin", "LINKED", "roll", "pitch", "gyro", "feet", "battery"))


def test_a_robot_that_may_move_is_not_to_be_touched(rig):
    status = look(rig)
    status["reading"]["foot_force"], status["remote_seen"] = [-1234.0] * 4, False
    for state in State:
        status["state"], status["reason"] = state.value, "the motor of the FL hip is at 65 °C; " * 4
        lines = view(status, SeenAngles())
        assert max(map(len, lines)) <= 80
        by_hand = state in (State.OFF, State.LINKED, State.DAMPING)
        assert lines[-1].startswith("Turn one joint" if by_hand else "Keep away")


@pytest.mark.parametrize("joint", range(12))
@pytest.mark.parametrize("way", [0.3, -0.3])
def test_a_joint_that_is_turned_by_hand_is_named_with_its_motion(joint, way):
    seen, q = SeenAngles(), np.zeros(12)
    seen.take(0.0, q)
    seen.take(0.5, q + way * (np.arange(12) == joint))
    side, part = ("FR", "FL", "RR", "RL")[joint // 3], ("hip", "thigh", "calf")[joint % 3]
    assert seen.motion().startswith(f"{side} {part} moves by {way:+.2f} rad")
    assert seen.motion().endswith(MOTIONS[part][0 if way > 0 else 1])
    seen.take(5.0, q)
    assert seen.motion() == ""


@pytest.mark.parametrize("leg", LEGS)
def test_the_motions_in_words_are_those_of_the_simulated_robot(leg):
    """In axes x forward, y left, z up."""
    at = [0.0, 0.8, -1.6]

    def moved(joint):
        q = [angle + 0.1 * (place == joint) for place, angle in enumerate(at)]
        before, after = (foot_motion(A1, leg, angles, at, sin, cos).position for angles in (at, q))
        return np.array(after) - before

    assert (MOTIONS["hip"][0], moved(0)[1] > 0.0) == ("the foot goes to the robot's left", True)
    assert (MOTIONS["thigh"][0], moved(1)[0] < 0.0) == ("the knee goes back", True)
    assert (MOTIONS["calf"][0], moved(2)[2] < 0.0) == ("the leg stretches", True)


def test_an_angle_beyond_its_range_is_marked_and_the_smallest_one_kept(rig):
    seen = SeenAngles()
    beyond = look(rig)
    beyond["reading"]["q"][2] = -2.9
    assert "-2.90!" in joints(view(beyond, seen))["FR calf"]
    within = look(rig)
    within["reading"]["q"][2] = -1.0
    row = joints(view(within, seen))["FR calf"]
    assert "!" not in row
    assert "-2.90" in row


def test_the_view_of_a_robot_sends_only_limp_packets(rig):
    for _ in range(5):
        view(look(rig), SeenAngles())
    assert rig.received
    assert all(limp(data) for _, data in rig.received)


def test_a_robot_that_sends_nothing_is_said_to():
    rig = Rig()
    assert view(look(rig), SeenAngles())[-1] == "no state has arrived"
    rig.close()


def test_the_view_of_a_running_guard_is_no_operator(tmp_path, monkeypatch):
    """The robot of a search that dies is damped although somebody still looks at it."""
    monkeypatch.setenv("S2R_A1_RUN", str(tmp_path))
    with served(Twin(TwinSettings(place="nominal"))) as port:
        operator, _ = start(RobotAddress("127.0.0.1", port, clock="lockstep"))
        operator.request("connect")
        guard = watch(None)
        assert guard.request("status")["operators"] == [os.getpid()]
        assert view(guard.request("status"), SeenAngles())[0].endswith("LINKED")
        guard.close()
        operator.close()
        end_guard(port)


def test_the_view_of_another_robot_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("S2R_A1_RUN", str(tmp_path))
    operator, _ = start(RobotAddress("127.0.0.1", 8007, robot="a1-07"))
    with pytest.raises(UsageError, match="a1-07"):
        watch("127.0.0.1", robot="a1-08")
    operator.close()
    end_guard(8007)
