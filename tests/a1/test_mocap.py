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
    """Return attitude and position (n, 3) [m] of a base that trots at 0.2 m/s and turns to and fro about all axes.

    It turns as much as an A1 does, not the same in every step, and stands still in the first and last half second.
    """
    phase = 2 * np.pi * 2.5 * times
    size = np.clip((times - 0.5) / 0.1, 0.0, 1.0) * np.clip((2.7 - times) / 0.1, 0.0, 1.0)
    yaw = 0.3 + size * (0.001 * np.sin(phase) + 0.0005 * np.sin(2 * phase + 1.0))
    roll, pitch = 0.015 * size * np.sin(phase + 0.5), 0.006 * size * np.sin(2 * phase + 2.0)
    way = 0.2 * times
    position = np.stack([way * np.cos(0.3), way * np.sin(0.3), 0.28 + 0 * times], axis=1)
    roll = roll + 0.005 * size * np.sin(2 * np.pi * 1.1 * times)
    pitch = pitch + 0.003 * size * np.sin(2 * np.pi * 3.7 * times)
    return Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)), position


AT_BASE = Placing()


def poses(placing=AT_BASE, noise=0.0, seed=0, late=0.004, missing=()):
    """Return poses at 100 Hz, with this noise of the position [m] and 10 rad/m times as much of the attitude."""
    times = np.arange(0.0, 3.0, 0.01)
    times = np.delete(times, [i for i in range(len(times)) if any(a <= times[i] < b for a, b in missing)])
    attitude, base = swaying(times)
    rng = np.random.default_rng(seed)
    position = base + attitude.apply(placing.position) + noise * rng.normal(size=base.shape)
    turned = attitude * Rotation.from_euler("z", placing.heading, degrees=True)
    turned = turned * Rotation.from_rotvec(10.0 * noise * rng.normal(size=base.shape))
    return Poses(times - AHEAD, times + late, position, np.roll(turned.as_quat(), 1, axis=1))


def gyro(seed=1):
    times = np.arange(0.0, 3.0, 0.002)
    before, _ = swaying(times - 1e-4)
    after, _ = swaying(times + 1e-4)
    rates = (before.inv() * after).as_rotvec() / 2e-4
    return Gyro(times, rates + 0.01 * np.random.default_rng(seed).normal(size=rates.shape))


WANTED = np.arange(1.0, 2.0, 0.002)


@pytest.mark.parametrize(
    ("late", "noise"),
    [(0.0, 1e-4), (0.05, 1e-4), (0.26, 0.0), (0.26, 1.4e-4), (0.36, 1e-4), (0.5, 0.0), (0.5, 1.4e-4)],
)
def test_the_offset_between_the_clocks_is_found_whatever_the_network_delays(late, noise):
    """Markers have about 0.1 mm and 1 mrad of noise; a delay of 0.4 s is one of the trot's periods."""
    seen = velocity(poses(late=late, noise=noise), Placing(), gyro(), WANTED)
    clocks = seen.alignment
    assert clocks.offset == pytest.approx(AHEAD, abs=max(0.001, 3.0 * clocks.error))
    assert clocks.delay == pytest.approx(late, abs=0.012)
    assert clocks.correlation > 0.8
    np.testing.assert_allclose(seen.forward, 0.2, atol=0.015)
    np.testing.assert_allclose(seen.forward.mean(), 0.2, atol=2e-3)


def test_the_error_of_the_offset_is_as_stated():
    rates = gyro()
    off = [velocity(poses(noise=1e-4, seed=seed), Placing(), rates, WANTED).alignment for seed in range(12)]
    scaled = np.array([(one.offset - AHEAD) / one.error for one in off])
    assert np.mean(np.abs(scaled) < 2.0) >= 0.8  # 0.95, if the model holds exactly


def test_a_body_beside_the_base_that_looks_elsewhere_tells_the_base_s_velocity():
    placing = Placing((0.15, -0.08, 0.05), 70.0)
    seen = velocity(poses(placing, noise=1e-4), placing, gyro(), WANTED)
    assert seen.alignment.offset == pytest.approx(AHEAD, abs=0.005)
    np.testing.assert_allclose(seen.forward.mean(), 0.2, atol=3e-3)
    assert abs(seen.alignment.turned) < 2.0


@pytest.mark.parametrize("off", [-170.0, -90.0, -12.0, 12.0, 90.0, 180.0])
def test_a_heading_that_is_wrong_is_refused_with_the_right_one(off):
    placing = Placing((0.15, -0.08, 0.05), 70.0)
    with pytest.raises(MocapError, match=r"write heading=(7[01]|69)\b"):
        velocity(poses(placing, noise=5e-5), Placing(placing.position, 70.0 + off), gyro(), WANTED)


def test_a_heading_that_is_wrong_by_little_is_kept_and_its_error_said():
    seen = velocity(poses(Placing(heading=5.0), noise=1e-4), Placing(), gyro(), WANTED)
    assert 3.0 < seen.alignment.turned < 7.0 < TURNED


def test_a_body_that_does_not_tilt_as_the_robot_does_is_refused():
    level = gyro()._replace(rates=np.random.default_rng(3).normal(size=gyro().rates.shape))
    with pytest.raises(MocapError, match="do not follow"):
        velocity(poses(), Placing(), level, WANTED)


def test_poses_of_something_else_are_refused():
    rng = np.random.default_rng(0)
    turning = Rotation.from_rotvec(np.cumsum(1e-3 * rng.normal(size=(300, 3)), axis=0)).as_quat()
    with pytest.raises(MocapError, match="do not follow"):
        velocity(poses()._replace(quaternion=np.roll(turning, 1, axis=1)), Placing(), gyro(), WANTED)
    still = poses()._replace(quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (300, 1)))
    with pytest.raises(MocapError, match="do not follow"):
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
    seldom = ~between | (np.arange(len(times)) % 8 == 0)  # 12 a second: none has another within the window
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


@pytest.mark.parametrize("late", [2.01, 2.3, -0.1])
def test_a_pose_that_is_later_than_the_search_is_refused(late):
    """A pose cannot come before it was taken, either."""
    with pytest.raises(MocapError, match=r"do not follow|later than"):
        velocity(poses(late=late, noise=1e-4), Placing(), gyro(), WANTED)


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
