"""Motion capture: its clock is found by the gyroscope, and its velocity is the base's."""

import json
import socket

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from s2r_a1.mocap import TURNED, Gyro, Listener, MocapError, Placing, Poses, velocity

AHEAD = 812.3456
"""[s] of motion capture's clock."""


def swaying(times):
    """Return attitude and position (n, 3) [m] of a base that trots at 0.2 m/s and turns to and fro about all axes."""
    phase = 2 * np.pi * 2.5 * times
    yaw = 0.3 + 0.01 * np.sin(phase) + 0.004 * np.sin(2 * phase + 1.0)
    roll, pitch = 0.015 * np.sin(phase + 0.5), 0.01 * np.sin(2 * phase + 2.0)
    way = 0.2 * times
    position = np.stack([way * np.cos(0.3), way * np.sin(0.3), 0.28 + 0 * times], axis=1)
    return Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)), position


AT_BASE = Placing()


def poses(placing=AT_BASE, noise=0.0, seed=0, late=0.004, missing=()):
    times = np.arange(0.0, 3.0, 0.005)
    times = np.delete(times, [i for i in range(len(times)) if any(a <= times[i] < b for a, b in missing)])
    attitude, base = swaying(times)
    rng = np.random.default_rng(seed)
    position = base + attitude.apply(placing.position) + noise * rng.normal(size=base.shape)
    turned = attitude * Rotation.from_euler("z", placing.heading, degrees=True)
    turned = turned * Rotation.from_rotvec(noise * rng.normal(size=base.shape))
    return Poses(times - AHEAD, times + late, position, np.roll(turned.as_quat(), 1, axis=1))


def gyro(seed=1):
    times = np.arange(0.0, 3.0, 0.002)
    before, _ = swaying(times - 1e-4)
    after, _ = swaying(times + 1e-4)
    rates = (before.inv() * after).as_rotvec() / 2e-4
    yaw = np.unwrap(swaying(times)[0].as_euler("ZYX")[:, 0])
    noise = 0.01 * np.random.default_rng(seed).normal(size=(4, len(times)))
    return Gyro(times, rates + noise[:3].T, np.gradient(yaw, times) + noise[3])


WANTED = np.arange(1.0, 2.0, 0.002)


@pytest.mark.parametrize("late", [0.0, 0.05])
def test_the_offset_between_the_clocks_is_found_whatever_the_network_delays(late):
    seen = velocity(poses(late=late), Placing(), gyro(), WANTED)
    assert seen.offset == pytest.approx(AHEAD, abs=0.001)
    assert seen.correlation > 0.95
    np.testing.assert_allclose(seen.forward, 0.2, atol=0.01)
    np.testing.assert_allclose(seen.forward.mean(), 0.2, atol=1e-3)


def test_a_body_beside_the_base_that_looks_elsewhere_tells_the_base_s_velocity():
    placing = Placing((0.15, -0.08, 0.05), 70.0)
    seen = velocity(poses(placing, noise=2e-4), placing, gyro(), WANTED)
    assert seen.offset == pytest.approx(AHEAD, abs=0.002)
    np.testing.assert_allclose(seen.forward.mean(), 0.2, atol=2e-3)
    assert abs(seen.turned) < 2.0


@pytest.mark.parametrize("off", [-170.0, -90.0, -12.0, 12.0, 90.0, 180.0])
def test_a_heading_that_is_wrong_is_refused_with_the_right_one(off):
    placing = Placing((0.15, -0.08, 0.05), 70.0)
    with pytest.raises(MocapError, match=r"write heading=(7[01]|69)\b"):
        velocity(poses(placing, noise=2e-4), Placing(placing.position, 70.0 + off), gyro(), WANTED)


def test_a_heading_that_is_wrong_by_little_is_kept_and_its_error_said():
    seen = velocity(poses(Placing(heading=5.0), noise=2e-4), Placing(), gyro(), WANTED)
    assert 3.0 < seen.turned < 7.0 < TURNED


def test_a_body_that_does_not_tilt_as_the_robot_does_is_refused():
    level = gyro()._replace(rates=np.random.default_rng(3).normal(size=gyro().rates.shape))
    with pytest.raises(MocapError, match="roll and pitch"):
        velocity(poses(), Placing(), level, WANTED)


def test_poses_of_something_else_are_refused():
    other = gyro()._replace(yaw=np.random.default_rng(0).normal(size=len(gyro().times)))
    with pytest.raises(MocapError, match="does not follow"):
        velocity(poses(), Placing(), other, WANTED)
    still = poses()._replace(quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (600, 1)))
    with pytest.raises(MocapError, match="does not follow"):
        velocity(still, Placing(), gyro(), WANTED)


def test_poses_that_do_not_cover_the_test_are_refused():
    with pytest.raises(MocapError, match="lost the robot"):
        velocity(poses(missing=[(1.3, 1.5)]), Placing(), gyro(), WANTED)
    with pytest.raises(MocapError, match="cover"):
        velocity(poses(missing=[(1.6, 9.0)]), Placing(), gyro(), WANTED)
    with pytest.raises(MocapError, match="poses"):
        velocity(poses(missing=[(0.05, 9.0)]), Placing(), gyro(), WANTED)


@pytest.mark.parametrize("gap", [(0.9, 1.4), (1.6, 2.03), (0.95, 2.04)])
def test_a_gap_over_an_end_of_the_test_is_refused(gap):
    with pytest.raises(MocapError, match="lost the robot"):
        velocity(poses(missing=[gap]), Placing(), gyro(), WANTED)


def test_poses_that_tell_no_velocity_are_none():
    whole = poses()
    times = whole.times + AHEAD
    between = (times >= 1.2) & (times < 1.5)
    seldom = ~between | (np.arange(len(times)) % 8 == 0)  # 25 a second: none has another within the window
    with pytest.raises(MocapError, match="lost the robot"):
        velocity(Poses(*(column[seldom] for column in whole)), Placing(), gyro(), WANTED)
    held = np.where(
        between, np.argmax(between), np.arange(len(times))
    )  # the last pose, sent again at new times
    again = whole._replace(position=whole.position[held], quaternion=whole.quaternion[held])
    with pytest.raises(MocapError, match="lost the robot"):
        velocity(again, Placing(), gyro(), WANTED)


def test_no_robot_is_as_fast_as_millimetres_make_it():
    with pytest.raises(MocapError, match="metres"):
        velocity(poses()._replace(position=1000.0 * poses().position), Placing(), gyro(), WANTED)


@pytest.mark.parametrize("late", [0.26, 0.3, 0.36])
def test_a_pose_is_not_taken_for_one_of_the_next_step(late):
    """By then the right offset is out of reach; one a period of the trot later would have the pose come too early."""
    with pytest.raises(MocapError, match="does not follow"):
        velocity(poses(late=late), Placing(), gyro(), WANTED)


def test_a_listener_takes_poses_and_counts_what_is_none():
    listener = Listener(0)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    pose = {"t": 1.0, "x": 0.1, "y": 0.2, "z": 0.3, "qw": 1.0, "qx": 0.0, "qy": 0.0, "qz": 0.0}
    lines = [
        pose,
        pose,
        pose | {"t": 2.0},
        pose | {"t": float("nan")},
        pose | {"qw": 2.0},
        {"t": 3.0},
        [],
    ]
    try:
        for line in lines:
            sender.sendto(json.dumps(line).encode() + b"\n", ("127.0.0.1", listener.port))
        sender.sendto(b"\xff{not JSON", ("127.0.0.1", listener.port))
        listener.take(5.0)
        taken = listener.poses()
        with pytest.raises(MocapError, match=str(listener.port)):
            Listener(listener.port)
    finally:
        sender.close()
        listener.close()
    assert taken.times.tolist() == [1.0, 2.0]
    assert taken.arrived.tolist() == [5.0, 5.0]
    assert listener.refused == 5
