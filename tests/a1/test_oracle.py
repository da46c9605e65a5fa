"""Packets and limits against the vendor's own compiled code: the Go1's packets, and the A1's limits.

The package speaks the Go1's wire, with the A1's motor blocks, scales and checksum in another frame, and its ``Safety``
knows the A1's limits. It returns −1 where the A1's library ends the process, so it can be asked here.
"""

import os
import select
import struct
import threading
import time

import numpy as np
import pytest

from s2r_a1.datagrams import RealTimeSocket
from s2r_a1.guard.checks import JOINT, CheckedQuantities, clip, power, power_count
from s2r_a1.guard.limits import LIMITS, Limits
from s2r_a1.guard.place import RobotAddress, hold, place
from s2r_a1.guard.start import start
from s2r_a1.link import RobotSide
from s2r_a1.vendor import open_link
from s2r_a1.wire import CLOSED_LOOP, GO1, POSITION_OFF, Orders, Reading, checksum, pack_reading, unpack
from tests.processes import until

sdk = pytest.importorskip(
    "unitree_legged_sdk.robot_interface",
    reason="the vendor's code comes with the extra [dev] on Python 3.11 for Linux on x86-64 only",
)
pytestmark = pytest.mark.dev
HERE = "127.0.0.1"
NAME = "unitree_legged_sdk.robot_interface"


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def free_port():
    one = RealTimeSocket()
    port = one.port
    one.close()
    return port


@pytest.fixture
def robot():
    """The robot's side of a leg, whose other end is the vendor's ``UDP``."""
    port = free_port()
    socket = RealTimeSocket()
    socket.connect((HERE, port))
    side = RobotSide(socket, GO1)
    side.local, side.peer = socket.port, port
    yield side
    side.close()


@pytest.fixture
def udp(robot):
    return sdk.UDP(0xFF, robot.peer, HERE, robot.local)


def some_reading(rng, tick):
    return Reading(
        quaternion=rng.normal(size=4).astype(np.float32),
        gyro=rng.normal(size=3).astype(np.float32),
        accelerometer=rng.normal(size=3).astype(np.float32),
        q=rng.normal(size=12).astype(np.float32),
        dq=rng.normal(size=12).astype(np.float32),
        tau=rng.integers(-32768, 32768, 12) / 256,
        temperature=rng.integers(-128, 128, 12),
        mode=rng.integers(0, 256, 12),
        tick=tick,
        remote=rng.bytes(40),
        error=rng.integers(0, 2**32, 12),
        foot_force=rng.integers(-32768, 32768, 4),
    )


def taken(udp, state):
    """Return what ``Recv`` says of the next datagram, after it was handed out."""
    answer = udp.Recv()
    udp.GetRecv(state)
    return answer


def test_the_vendor_s_commands_are_read(robot, udp, rng):
    command = sdk.LowCmd()
    udp.InitCmdData(command)
    udp.SetSend(command)
    assert udp.Send() == GO1.command.itemsize
    orders = robot.read()
    assert np.all(orders.q == np.float32(POSITION_OFF))
    assert not np.any([orders.kp, orders.kd, orders.tau])
    for _ in range(200):
        q, dq = rng.normal(size=(2, 12)).astype(np.float32)
        kp, kd = rng.uniform(0, 1023, 12), rng.uniform(0, 2047, 12)
        tau = rng.uniform(-127, 127, 12)
        for i, motor in enumerate(command.motorCmd[:12]):
            motor.mode = CLOSED_LOOP
            motor.q, motor.dq, motor.Kp, motor.Kd, motor.tau = map(float, (q[i], dq[i], kp[i], kd[i], tau[i]))
        udp.SetSend(command)
        udp.Send()
        sent = robot.read()
        assert robot.fault is None
        assert np.array_equal(sent.q, q)
        assert np.array_equal(sent.dq, dq)
        for values, given, count in ((sent.kp, kp, 32), (sent.kd, kd, 16), (sent.tau, tau, 256)):
            assert np.array_equal(values, np.trunc(given.astype(np.float32) * np.float32(count)) / count)


def test_the_vendor_s_code_accepts_our_states_field_by_field(robot, udp, rng):
    state = sdk.LowState()
    for tick in range(1, 101):
        reading = some_reading(rng, tick)
        robot.send(pack_reading(reading, GO1))
        assert taken(udp, state) == 0
        assert state.tick == tick
        assert state.imu.quaternion == reading.quaternion.tolist()
        assert state.imu.gyroscope == reading.gyro.tolist()
        assert state.imu.accelerometer == reading.accelerometer.tolist()
        motors = state.motorState[:12]
        assert [motor.q for motor in motors] == reading.q.tolist()
        assert [motor.dq for motor in motors] == reading.dq.tolist()
        assert [motor.tauEst for motor in motors] == reading.tau.tolist()
        assert [motor.temperature for motor in motors] == reading.temperature.tolist()
        assert [motor.mode for motor in motors] == reading.mode.tolist()
        assert [motor.reserve[0] for motor in motors] == reading.error.tolist()
        assert bytes(state.wirelessRemote) == reading.remote
        assert state.footForce == reading.foot_force.tolist()


def test_both_refuse_the_same_damaged_states(robot, udp, rng):
    state = sdk.LowState()
    good = pack_reading(some_reading(rng, 1)._replace(remote=bytes(40)), GO1)
    robot.send(good)
    taken(udp, state)
    assert state.tick == 1
    other = pack_reading(some_reading(rng, 2), GO1)
    for byte in rng.choice(len(good), 60, replace=False):
        damaged = other[:byte] + bytes([other[byte] ^ 4]) + other[byte + 1 :]
        robot.send(damaged)
        answer = taken(udp, state)
        try:
            unpack(damaged, GO1)
        except ValueError:
            assert answer < 0
            assert state.tick == 1  # the last good one is handed out again
        else:
            assert answer == 0
            robot.send(good)
            taken(udp, state)
    robot.send(other[:600])
    assert taken(udp, state) < 0


def test_our_link_drives_the_vendor_s_module(robot, rng):
    """``VendorLink`` over the module as it is, against the robot's side of our own wire."""
    link = open_link(NAME, GO1, (HERE, robot.local), port=robot.peer)
    assert link.read() is None
    assert link.fault == "silence"
    for tick in range(1, 20):
        orders = Orders(*rng.uniform(0, 30, (5, 12)).astype(np.float32).astype(float))
        link.write(orders)
        assert np.array_equal(robot.read().kp, np.trunc(orders.kp * 32) / 32)
        reading = some_reading(rng, 2 * tick)
        robot.send(pack_reading(reading, GO1))
        read = link.read()
        for name, value in reading._asdict().items():
            assert np.array_equal(getattr(read, name), value), name
        assert link.read() is None
        assert link.fault == "repeated"
    assert robot.counters.corrupt == 0
    link.close()


@pytest.fixture
def guarded(robot, tmp_path, monkeypatch):
    """An operator's connection to a guard that speaks through the vendor's module; it ends with the test."""
    monkeypatch.setenv("S2R_A1_RUN", str(tmp_path / "run"))
    where = RobotAddress(HERE, robot.local, layout="go1", local=robot.peer, module=NAME)
    connection, _ = start(where)
    yield connection
    connection.request("stop")
    connection.close()
    until(lambda: free(place(HERE, robot.local)))


def free(where):
    """Return whether no process holds a robot's lock."""
    held = hold(where)
    if held is not None:
        os.close(held)
    return held is not None


@pytest.fixture
def answering(robot, rng):
    """A robot that answers every command with a state, 2 ms later by its own clock; yields what it was sent."""
    got, ended = [], threading.Event()
    still = some_reading(rng, 0)._replace(
        quaternion=np.array([1.0, 0, 0, 0]),
        q=np.tile([0, 1.3, -2.7], 4),
        dq=np.zeros(12),
        temperature=np.full(12, 25),
    )

    def answer():
        begun = time.monotonic()
        while not ended.is_set():
            if select.select([robot], [], [], 0.05)[0] and (orders := robot.read()):
                got.append(orders)
                robot.send(pack_reading(still._replace(tick=round((time.monotonic() - begun) * 1e3)), GO1))

    thread = threading.Thread(target=answer)
    thread.start()
    yield got
    ended.set()
    thread.join()


def test_a_guard_drives_a_robot_through_the_vendor_s_module(guarded, answering):
    assert guarded.request("status")["state"] == "OFF"
    assert not answering  # nothing is sent before the operator's first consent
    status = guarded.request("connect")
    assert (status["state"], status["tick_unit"]) == ("LINKED", "ms")
    assert status["counters"]["received"] > 100
    assert len(answering) > 100
    assert not any(np.any([orders.kp, orders.kd, orders.tau]) for orders in answering)


def test_a_bit_of_every_word_counts_in_the_checksum(rng):
    """The vendor's arithmetic once more, as its header describes it, on random words."""
    for length in (610, 614, 771, 807):
        data = rng.bytes(length)
        register = 0xFFFFFFFF
        for (word,) in struct.iter_unpack("<I", data[: (length // 4 - 1) * 4]):
            register ^= word
            for _ in range(32):
                register = (register << 1) ^ 0x04C11DB7 if register & 0x80000000 else register << 1
                register &= 0xFFFFFFFF
        assert checksum(data) == register


def test_limits_of_angles_are_the_vendor_s(rng):
    safety, command = sdk.Safety(sdk.LeggedType.A1), sdk.LowCmd()
    motors = command.motorCmd[:12]
    ones = np.ones(12)
    for _ in range(10_000):
        q = rng.choice(
            [rng.normal(scale=0.5, size=12) + np.tile([0, 0.9, -1.8], 4), rng.normal(scale=9, size=12)]
        )
        q = q.astype(np.float32)
        for motor, angle in zip(motors, q.tolist(), strict=True):
            motor.q = angle
        safety.PositionLimit(command)
        ours, _ = clip(LIMITS, Orders(q.astype(float), 0 * ones, ones, ones, 0 * ones))
        assert ours.q.astype(np.float32).tolist() == [motor.q for motor in motors]


def test_the_count_of_power_is_the_vendor_s(rng):
    """1000 random sequences at all ten levels and two beyond; powers are exact in single precision, some at a level."""
    command, state = sdk.LowCmd(), sdk.LowState()
    motors = state.motorState[:12]
    tables = [Limits(power_level=level) for level in range(0, 12)]
    any_reading, tripped = some_reading(rng, 0), np.zeros(len(tables))
    for _ in range(1000):
        safeties = [sdk.Safety(sdk.LeggedType.A1) for _ in tables]
        counts = [0] * len(tables)
        base = rng.integers(1, 11) * 100
        for _ in range(16):
            watts = base + rng.choice([-60, -1, 0, 1, 5, 80, 80])
            shares = rng.multinomial(watts, np.full(12, 1 / 12))
            signs = rng.choice([-1, 1], (2, 12))
            speeds = rng.choice([0.5, 1, 2, 4], 12)
            dq, tau = signs[0] * speeds, signs[1] * shares / speeds
            for motor, speed, torque in zip(motors, dq.tolist(), tau.tolist(), strict=True):
                motor.dq, motor.tauEst = speed, torque
            measured = power(any_reading._replace(dq=dq, tau=tau))
            for level, (limits, safety) in enumerate(zip(tables, safeties, strict=True)):
                counts[level] = power_count(limits, counts[level], measured)
                trips = counts[level] >= limits.power_rounds
                assert (safety.PowerProtect(command, state, limits.power_level) < 0) == trips
                if trips:  # where the A1's library ends the process
                    tripped[level] += 1
                    counts[level] = 0
                    safeties[level] = sdk.Safety(sdk.LeggedType.A1)
    assert tripped.min() > 20, tripped


def test_the_margin_of_joints_is_the_vendor_s(rng):
    safety, command, state = sdk.Safety(sdk.LeggedType.A1), sdk.LowCmd(), sdk.LowState()
    motors = state.motorState[:12]
    low, high = LIMITS.span
    zero, count = np.zeros(12), np.zeros(12, dtype=np.int64)
    found = 0
    for _ in range(1000):
        near = rng.uniform(0.02, 0.3, 12) + 0.1 * rng.integers(0, 2)
        q = np.where(rng.random(12) < 0.5, low + near, high - near).astype(np.float32)
        for motor, angle in zip(motors, q.tolist(), strict=True):
            motor.q = angle
        reading = Reading(zero[:4], zero[:3], zero[:3], q.astype(float), zero, zero, zero, count, 0)
        sentence = JOINT.find(LIMITS, CheckedQuantities(reading, None, 0, 0, 0, 0, 0, count, count))
        assert (safety.PositionProtect(command, state, LIMITS.margin) < 0) == (sentence is not None)
        found += sentence is not None
    assert 300 < found < 700
