"""What a twin makes of bytes, within this process: what it answers and ignores, and every fault that it can have."""

import json

import numpy as np
import pytest

from s2r_a1 import remote
from s2r_a1.twin import PLACES, TwinSettings, read_inject
from s2r_a1.twin.injects import KINDS
from s2r_a1.twin.start import read_start
from s2r_a1.wire import (
    A1,
    CLOSED_LOOP,
    GO1,
    POSITION_OFF,
    SPEED_OFF,
    Orders,
    WireError,
    checksum,
    pack,
    unpack,
    unpack_orders,
)
from s2r_sim.plant.physics import Physics
from s2r_sim.plant.plant import Plant
from s2r_sim.robot.constants import A1 as ROBOT
from s2r_sim.robot.rotation import quaternion
from s2r_sim.robot.signals import MotorCommand
from s2r_spec.errors import UsageError
from tests.a1.steering import LIMP, ZERO, steer, twin

OFF = pack(LIMP, A1)
HOLD = Orders(
    np.tile([0.5, 1.3, -2.6], 4) * np.tile([-1, 1, 1, 1, 1, 1], 2), ZERO, *np.full((2, 12), 5.0), ZERO
)


def states(robot, rounds, data=OFF):
    """Return the packets of every round in which the robot is sent these bytes."""
    return [robot.round([data]) for _ in range(rounds)]


def readings(robot, rounds):
    return [unpack(packet, A1) for packets in states(robot, rounds) for packet in packets]


def test_a_twin_says_nothing_before_the_first_valid_command():
    robot = twin()
    level = bytes([0xEE]) + OFF[1:]
    for data in (bytes(610), OFF[:-1], OFF + b"\0", level, b"", b"\xff", OFF[:100] + b"\1" + OFF[101:]):
        assert robot.round([data]) == []
    assert not robot.begun
    assert robot.rounds == 0
    assert robot.counts.used == 0
    assert sum(robot.counts.refused.values()) == 6  # the empty one is no packet
    (packet,) = robot.round([OFF])
    assert len(packet) == 771
    assert robot.begun


def test_a_state_is_that_of_a_robot_that_lies():
    first, *_, last = readings(twin(), 50)
    assert last.tick - first.tick == 98
    np.testing.assert_array_equal(last.mode, CLOSED_LOOP)
    np.testing.assert_array_equal(last.error, 0)
    np.testing.assert_allclose(last.quaternion, [1, 0, 0, 0], atol=0.02)
    np.testing.assert_allclose(last.accelerometer, [0, 0, 9.81], atol=0.6)
    np.testing.assert_allclose(last.gyro, 0, atol=0.1)
    np.testing.assert_allclose(last.tau, 0, atol=0.01)
    np.testing.assert_allclose(last.temperature, 25, atol=1)
    assert remote.is_on(last.remote)
    assert not remote.pressed_buttons(last.remote)
    # With knees behind the hips and calves at their stops.
    np.testing.assert_allclose(last.q[1::3], 1.3, atol=0.2)
    np.testing.assert_allclose(last.q[2::3], -2.7, atol=0.02)


def test_same_seed_and_bytes_in_same_bytes_out():
    faults = (
        "loss=0.1",
        "duplicate=0.1",
        "reorder=0.1",
        "corrupt=0.1",
        "short=0.1",
        "deaf=0.1",
        "delay=2@20-30",
    )
    commands = [OFF, b"", pack(HOLD, A1), b"junk", pack(HOLD, A1)] * 16

    def run(seed):
        robot = twin(*faults, place="lab", seed=seed)
        return [robot.round([data]) for data in commands]

    assert run(3) == run(3)
    assert run(3) != run(4)


def test_nobody_can_count_on_where_its_clocks_begin():
    first, second = (twin(seed=seed) for seed in (1, 2))
    assert readings(first, 1)[0].tick != readings(second, 1)[0].tick
    assert json.loads(first.mocap()[0])["t"] != json.loads(second.mocap()[0])["t"]


def test_go1_has_its_own_packets():
    robot = twin(layout=GO1)
    assert robot.round([OFF]) == []
    (packet,) = robot.round([pack(LIMP, GO1)])
    assert len(packet) == 807
    assert unpack(packet, GO1).tick > 0


@pytest.mark.parametrize("layout", [A1, GO1], ids=["A1", "Go1"])
def test_the_angles_of_a_state_say_what_its_quaternion_says(layout):
    (packet,) = twin("tilt=0.6", layout=layout).round([pack(LIMP, layout)])
    imu = np.frombuffer(packet, layout.state)[0]
    np.testing.assert_allclose(quaternion(*imu["rpy"].tolist()), np.roll(imu["quaternion"], -1), atol=1e-6)
    assert imu["rpy"][0] == pytest.approx(0.6, abs=0.05)


def test_of_several_commands_the_newest_valid_one_counts():
    stiff = pack(HOLD._replace(tau=np.full(12, 5.0)), A1)
    alone, several = twin(), twin()
    expected = [alone.round([data]) for data in (stiff, OFF, stiff)]
    assert expected == [
        several.round(data) for data in ([OFF, stiff], [stiff, OFF, b"junk"], [OFF, OFF, stiff])
    ]
    assert several.counts.used == 3
    assert several.counts.superseded == 4


@pytest.mark.parametrize("delay", [0, 1, 4])
def test_a_command_takes_its_delay_to_the_motors(delay):
    robot = twin(delay=delay, noise=False)
    lift = pack(Orders(ZERO, ZERO, ZERO, ZERO, np.tile([0.0, -4.0, 0.0], 4)), A1)
    torques = [np.abs(reading.tau).max() for data in [OFF] * 3 + [lift] * 6 for reading in
               [unpack(robot.round([data])[0], A1)]]  # fmt: skip
    assert np.flatnonzero(np.array(torques) > 1.0)[0] == 3 + delay


def test_motors_follow_the_law_of_their_command():
    robot = twin(delay=0, noise=False)
    wanted = HOLD._replace(tau=np.tile([0.5, 0.0, -0.5], 4))
    before = steer(robot, LIMP, 2)
    after = steer(robot, wanted)
    law = wanted.tau + wanted.kp * (wanted.q - before.q) - wanted.kd * before.dq
    # Within a round of 2 ms joints move, and the drives with them.
    np.testing.assert_allclose(after.tau, law, atol=0.5)


@pytest.mark.parametrize(
    "orders",
    [
        HOLD._replace(q=np.full(12, POSITION_OFF), kd=ZERO),
        HOLD._replace(dq=np.full(12, SPEED_OFF), kp=ZERO),
    ],
    ids=["PosStopF", "VelStopF"],
)
def test_a_stop_value_switches_its_loop_off(orders):
    robot = twin(noise=False)
    assert np.abs(steer(robot, orders, 5).tau).max() == 0.0


def test_a_motor_in_another_mode_is_limp_and_says_so():
    packet = (
        np.frombuffer(bytearray(pack(HOLD._replace(tau=np.full(12, 3.0)), A1)), A1.command).reshape(()).copy()
    )
    packet["motors"]["mode"][4] = 0
    data = _closed(packet.tobytes())
    robot = twin(noise=False)
    state = unpack(states(robot, 4, data)[-1][0], A1)
    assert state.mode[4] == 0
    assert state.tau[4] == 0.0
    assert np.abs(np.delete(state.tau, 4)).min() > 0.1
    assert (np.delete(state.mode, 4) == CLOSED_LOOP).all()


def _closed(data):
    return data[:-4] + checksum(data).to_bytes(4, "little")


# Silence of whoever commands: 15 rounds are bridged, then the robot's own rule acts.


@pytest.mark.parametrize("rule", ["damp", "free", "brake", "hold"])
def test_when_commands_stop_the_motors_follow_the_rule(rule):
    robot = twin(silence=rule, noise=False, delay=0)
    lift = Orders(ZERO, ZERO, ZERO, ZERO, np.tile([0.0, -4.0, 0.0], 4))
    moving = steer(robot, lift, 20)
    speed = np.abs(moving.dq).max()
    assert speed > 0.5
    held = [unpack(packet, A1) for (packet,) in states(robot, 15, b"")]
    assert np.abs(held[-1].tau[1::3]).min() > 3.5
    alone = [unpack(packet, A1) for (packet,) in states(robot, 200, b"")]
    if rule == "hold":  # the worst: the torque of the last command goes on
        np.testing.assert_allclose(alone[-1].tau[1::3], -4.0, atol=0.5)
    if rule == "free":
        assert np.abs(alone[0].tau).max() == 0.0
    if rule == "damp":
        np.testing.assert_allclose(alone[0].tau, -3.0 * held[-1].dq, atol=2.0)
        assert np.abs(alone[-1].tau).max() < 1.5
    if rule == "brake":
        # It holds the angles at which it found the joints, against the weight.
        np.testing.assert_allclose(alone[-1].q, held[-1].q, atol=0.25)
        assert np.abs(alone[-1].tau).max() > 0.5
    np.testing.assert_allclose(steer(robot, lift, 2).tau[1::3], -4.0, atol=0.01)


def test_what_was_ordered_before_a_silence_is_over_after_it():
    robot = twin(silence="free", noise=False, delay=3)
    steer(robot, Orders(ZERO, ZERO, ZERO, ZERO, np.tile([0.0, -4.0, 0.0], 4)), 5)
    states(robot, 30, b"")
    # Until the next command is at the motors, they stay on their own.
    assert [np.abs(reading.tau).max() for reading in readings(robot, 5)] == [0.0] * 5


def test_a_twin_streams_on_while_commands_stop():
    robot = twin()
    states(robot, 2)
    ticks = [unpack(packet, A1).tick for (packet,) in states(robot, 40, b"")]
    np.testing.assert_array_equal(np.diff(ticks), 2)


# Faults on the way of states.


def numbers(packets):
    """Return the rounds that packets are of, counted from the first one."""
    return [None if data is None else (unpack(data, A1).tick - START) // 2 for data in packets]


START = unpack(twin().round([OFF])[0], A1).tick


def arrived(inject, rounds=8):
    robot = twin(inject)
    return [numbers(packets) for packets in states(robot, rounds)]


@pytest.mark.parametrize(
    ("inject", "expected"),
    [
        ("loss@2-3", [[0], [1], [], [], [4], [5], [6], [7]]),
        ("silence@2-3", [[0], [1], [], [], [4], [5], [6], [7]]),
        ("silence@6-", [[0], [1], [2], [3], [4], [5], [], []]),
        ("delay=2@3-5", [[0], [1], [2], [], [], [3], [4, 5, 6], [7]]),
        ("duplicate@2", [[0], [1], [2], [3, 2], [4], [5], [6], [7]]),
        ("reorder@2", [[0], [1], [], [3, 2], [4], [5], [6], [7]]),
    ],
)
def test_what_arrives_of_states(inject, expected):
    assert arrived(inject) == expected


@pytest.mark.parametrize(("inject", "fault"), [("corrupt@3", "crc"), ("short@3", "length")])
def test_a_damaged_state_is_one_that_is_refused(inject, fault):
    clean, damaged = states(twin(), 6), states(twin(inject), 6)
    for seed in range(5):
        (packet,) = states(twin(inject, seed=seed), 4)[3]
        with pytest.raises(WireError) as error:
            unpack(packet, A1)
        assert error.value.fault == fault
    del clean[3], damaged[3]
    assert clean == damaged


def test_a_probability_is_one_per_packet():
    came = sum(map(len, states(twin("loss=0.25", seed=2), 400)))
    assert 260 < came < 340


def test_commands_can_be_lost_on_their_way():
    robot = twin("deaf@2-", silence="free", noise=False)
    lift = Orders(ZERO, ZERO, ZERO, ZERO, np.tile([0.0, -4.0, 0.0], 4))
    assert np.abs(steer(robot, lift, 17).tau).max() > 3.5
    assert np.abs(steer(robot, lift, 2).tau).max() == 0.0
    assert robot.counts.used == 2
    assert robot.counts.lost == 17


# Faults in states.


def at(inject, round_, **settings):
    return readings(twin(inject, **settings), round_ + 1)[round_]


def test_faults_of_the_clock():
    ticks = [reading.tick for reading in readings(twin("stuck_tick@2-4"), 7)]
    assert [(tick - START) // 2 for tick in ticks] == [0, 1, 1, 1, 1, 5, 6]
    ticks = [reading.tick for reading in readings(twin("back_tick=20@2-"), 4)]
    assert [tick - START for tick in ticks] == [0, 2, -16, -14]
    assert at("back_tick=-500@1", 1).tick == START + 502
    ticks = [reading.tick for reading in readings(twin("tick_unit@2-"), 4)]
    assert ticks[:2] == [START, START + 2]
    assert ticks[2:] == [(START + 4) * 1000, (START + 6) * 1000]
    ticks = [reading.tick for reading in readings(twin(tick_unit="us"), 2)]
    assert ticks[1] - ticks[0] == 2000


@pytest.mark.parametrize("name", ["q", "dq", "quaternion", "gyro", "accelerometer"])
def test_a_number_that_is_none(name):
    good, bad = states(twin(f"nan={name}@1"), 2)
    unpack(good[0], A1)
    with pytest.raises(WireError) as error:
        unpack(bad[0], A1)
    assert error.value.fault == "number"


def test_reports_of_the_imu():
    assert np.linalg.norm(at("quaternion=0.5@2", 2).quaternion) == pytest.approx(0.5, abs=1e-6)
    assert at("gyro=70@2", 2).gyro[0] == pytest.approx(70)
    w, x, *_ = at("tilt=0.7@2", 2).quaternion
    assert 2 * np.arctan2(x, w) == pytest.approx(0.7, abs=0.02)


@pytest.mark.parametrize(
    ("inject", "field", "value"),
    [
        ("joint=4:3.5", "q", 3.5),
        ("speed=4:-25", "dq", -25),
        ("torque=4:40", "tau", 40),
        ("heat=4:71", "temperature", 71),
        ("mode=4:8", "mode", 8),
        ("error=4:4", "error", 4),
    ],
)
def test_reports_of_a_motor(inject, field, value):
    robot, clean = twin(f"{inject}@2", noise=False), twin(noise=False)
    for round_, (reading, usual) in enumerate(zip(readings(robot, 4), readings(clean, 4), strict=True)):
        found, expected = getattr(reading, field), getattr(usual, field)
        if round_ == 2:
            assert found[4] == pytest.approx(value)
            found, expected = np.delete(found, 4), np.delete(expected, 4)
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_a_report_can_be_of_all_motors_or_of_the_first():
    np.testing.assert_array_equal(at("heat=all:60@1", 1).temperature, 60)
    assert at("joint=thigh:2@1", 1).q[1::3].tolist() == [2] * 4
    assert (at("heat@1", 1).temperature > 60).tolist() == [True] + [False] * 11


def test_buttons_of_the_remote():
    assert remote.stop(at("button=R2@1", 1).remote)
    assert remote.pressed_buttons(at("button=L2+B@1", 1).remote) == {"L2", "B"}
    assert not remote.is_on(at("button=off@1", 1).remote)
    assert not remote.pressed_buttons(at("button@3", 1).remote)


def test_a_motor_that_drops_out_goes_limp():
    robot = twin("mode=4:0@5-", delay=0, noise=False)
    lift = Orders(ZERO, ZERO, ZERO, ZERO, np.tile([0.0, -4.0, 0.0], 4))
    assert np.abs(steer(robot, lift, 5).tau[4]) > 3.5
    reading = steer(robot, lift)
    assert reading.tau[4] == 0.0
    assert reading.mode[4] == 0
    assert np.abs(reading.tau[1::3][[0, 2, 3]]).min() > 3.5


def test_a_push_moves_the_robot():
    pushed, left = twin("push=200@5-54", noise=False), twin(noise=False)
    steer(pushed, LIMP, 60)
    steer(left, LIMP, 60)
    assert pushed.truth().position[1] - left.truth().position[1] > 0.01


def test_motors_warm_up_with_their_torque():
    robot = twin(noise=False)
    torque = np.tile([0.0, 0.0, -30.0], 4)  # against the stops of the calves
    cold = steer(robot, LIMP)
    warm = steer(robot, Orders(ZERO, ZERO, ZERO, ZERO, torque), 600)
    assert (warm.temperature - cold.temperature)[0::3].max() == 0
    assert (warm.temperature - cold.temperature)[2::3].min() >= 0
    assert robot.temperature[2] > robot.temperature[0] + 0.2


# How faults are written.


@pytest.mark.parametrize(
    ("text", "rounds"),
    [
        ("loss", range(9)),
        ("loss@3", [3]),
        ("loss@3-5", [3, 4, 5]),
        ("loss@6-", [6, 7, 8]),
        ("loss=0.5@0", [0]),
    ],
)
def test_rounds_of_a_fault(text, rounds):
    fault = read_inject(text)
    assert [round_ for round_ in range(9) if fault.acts(round_)] == list(rounds)


def test_every_fault_can_be_written_without_a_value():
    for kind in KINDS:
        assert read_inject(kind).kind == kind


@pytest.mark.parametrize(
    "text",
    [
        "los", "", "=1", "loss=", "loss=2", "loss=nan", "loss=-0.1", "loss@", "loss@x", "loss@5-3", "loss@-3",
        "loss@1-2-3", "loss@¹", "heat=12:60", "heat=-1:60", "heat=x:60", "heat=3:", "heat=3:1e9", "heat=3:inf",
        "silence=1", "tick_unit=s", "nan=tau", "button=Q", "button=", "delay=1e9", "push=none",
    ],
)  # fmt: skip
def test_a_fault_that_makes_no_sense_is_refused(text):
    with pytest.raises(UsageError) as error:
        read_inject(text)
    assert text in str(error.value) or text.partition("=")[0] in str(error.value)


# Where a twin begins, and what it shows beside packets.


def test_a_plant_can_be_saved_and_begun_from(tmp_path):
    robot = twin(place="lab", noise=False, delay=0)
    steer(robot, HOLD, 30)
    robot.save(tmp_path / "start.npz")
    again = twin(place="lab", noise=False, delay=0, start=read_start(tmp_path / "start.npz"))
    np.testing.assert_array_equal(again.truth().flat, robot.truth().flat)
    for _ in range(5):
        one, other = steer(robot, HOLD), steer(again, HOLD)
        np.testing.assert_array_equal(one.q, other.q)
        np.testing.assert_array_equal(one.tau, other.tau)


def test_twin_and_simulator_go_on_alike_from_the_same_state(tmp_path):
    robot = twin(noise=False, delay=0)
    steer(robot, HOLD, 10)
    robot.save(tmp_path / "start.npz")
    saved = read_start(tmp_path / "start.npz")
    plant = Plant(ROBOT, Physics(), knees=True)
    plant.restore(saved)
    again = twin(noise=False, delay=0, start=saved)
    for _ in range(20):
        steer(again, HOLD)
        plant.step(MotorCommand(*unpack_orders(pack(HOLD, A1), A1)), 0.0)
    np.testing.assert_array_equal(plant.truth().flat, again.truth().flat)


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x05\x06" + bytes(18)])
def test_what_is_no_saved_state_is_refused(tmp_path, content):
    path = tmp_path / "start.npz"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=r"start\.npz"):
        read_start(path)
    with pytest.raises(UsageError, match=r"none\.npz"):
        read_start(tmp_path / "none.npz")


def test_motion_capture_has_the_noise_of_markers_and_may_be_late():
    robot, exact = twin("late_poses=0.04", noise=True), twin(noise=False)
    assert exact.settings.noise is False
    arrived = []
    for round_ in range(600):
        robot.round([OFF])
        arrived += [(round_, json.loads(line)) for line in robot.mocap()]
    assert arrived[0][0] == 20  # 0.04 s
    still = [[pose[name] for name in ("x", "y", "z", "qx", "qy", "qz")] for _, pose in arrived[50:]]
    steps = np.diff(still, axis=0)[1:].std(axis=0) / np.sqrt(2.0)
    np.testing.assert_allclose(steps[:3], 1e-4, rtol=0.5)
    np.testing.assert_allclose(steps[3:], 0.5e-3, rtol=0.5)  # half of the angle


def test_motion_capture_sees_the_true_pose_every_10_ms():
    robot = twin("push=200@5-", place="ramp", noise=False)
    poses, truths = [], []
    for _ in range(50):
        robot.round([OFF])
        poses += [json.loads(line) for line in robot.mocap()]
        truths.append(robot.truth())
    times = np.array([pose["t"] for pose in poses])
    np.testing.assert_allclose(np.diff(times), 0.01, atol=1e-9)
    assert len(poses) in (10, 11)
    # At 0.1 s a pose and a state fall together.
    assert poses[-1]["t"] - poses[0]["t"] == pytest.approx(0.1)
    np.testing.assert_allclose([poses[-1][axis] for axis in "xyz"], truths[-1].position, atol=1e-12)
    pitch = 2 * np.arctan2(poses[-1]["qy"], poses[-1]["qw"])
    assert pitch == pytest.approx(truths[-1].rpy[1], abs=0.01)


def test_there_is_a_twin_of_every_place_of_the_simulated_ones():
    from s2r_sim.twins import PLACES as SIMULATED

    assert set(PLACES) == {"nominal", *SIMULATED}
    with pytest.raises(UsageError, match="moon"):
        twin(place="moon")
    assert TwinSettings().delay == 1


def test_the_ramp_shows_in_its_imu_and_the_lab_in_its_latency():
    pitch = at("heat", 30, place="ramp", noise=False).quaternion
    assert 2 * np.arctan2(pitch[2], pitch[0]) == pytest.approx(np.radians(4.0 - 3.0), abs=0.01)
    lift = Orders(ZERO, ZERO, ZERO, ZERO, np.tile([0.0, -4.0, 0.0], 4))
    robot = twin(place="lab", noise=False, delay=0)
    steer(robot, LIMP, 3)
    # 4 ms of the place come on top of the delay of the wire.
    assert np.abs(steer(robot, lift, 2).tau).max() < 1.0
    assert np.abs(steer(robot, lift, 1).tau).max() > 1.0
