"""Rollouts over the wire, in lock step: this process walks, a guard in its own process forwards, a twin obeys."""

import math
import os
import signal
import socket
import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from s2r_a1 import rawlog, recording
from s2r_a1.backend import A1Backend
from s2r_a1.client import Client
from s2r_a1.datagrams import TO_ROBOT
from s2r_a1.guard.place import place
from s2r_a1.guard.start import attach
from s2r_a1.schedule import Schedule
from s2r_a1.twin import TwinSettings, read_inject
from s2r_a1.twin.start import read_start
from s2r_a1.wire import A1, Orders, pack, unpack_orders
from s2r_sim.controller.trot import Controller, Memory
from s2r_sim.plant.plant import Plant
from s2r_sim.plant.sensors import Sensors
from s2r_sim.robot.signals import MotorCommand, VelocityCommand
from s2r_sim.settings import Settings
from s2r_spec.backend import Coming
from s2r_spec.errors import BackendError
from s2r_spec.trace import Trace
from tests.a1.robots import Silent, Steered, in_a_process, served

SETTINGS = Settings()
DURATION = 0.1
TOUCH_DOWN = 100  # of the first pair of feet: they lift after 10 rounds, and swing for 90
PLAIN = {"place": "nominal", "delay": 0, "noise": False}


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A twin that everything is exact of, its guard and who attends to it: one robot for the whole module."""
    folder = tmp_path_factory.mktemp("a1")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("S2R_A1_RUN", str(folder / "run"))
        twin = Steered(TwinSettings(**PLAIN))
        mocap = free_port()
        with served(twin, mocap=mocap) as port:
            made = Session(twin, port, mocap, folder)
            yield made
            made.attended.end()


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def robot(port, folder, velocity="onboard"):
    text = f"host=127.0.0.1,port={port},velocity={velocity},operator=auto,clock=lockstep"
    return A1Backend(text).with_duration(DURATION).keeping(str(folder / "raw"))


class Session:
    def __init__(self, twin, port, mocap, folder):
        self.twin, self.folder, self.port, self.mocap = twin, folder, port, mocap
        self.backend = robot(port, folder)
        self.operator = Silent()
        self.attended = self.backend.attendance(self.operator)
        self.begun = False

    def rollout(self, params, seed, walking=None, backend=None):
        if not self.begun:
            self.attended.begin(Coming(4))
            self.begun = True
        self.attended.before(params)
        self.twin.rest()
        self.twin.walking = walking or (lambda n: None)
        try:
            trace = (backend or self.backend).rollout(params, seed)
        finally:
            self.twin.walking = lambda n: None
        self.attended.after(trace)
        return trace

    def inject(self, at, text, rounds=""):
        """Return what injects a fault at a round of the walk."""

        def walking(n):
            if n == at:
                now = self.twin.rounds
                self.twin.injects = (read_inject(f"{text}@{now}-{rounds and now + rounds}"),)

        return walking

    def guard_s_process(self):
        """Return the id of the guard's process, as the kernel knows it."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as one:
            one.connect(str(place("127.0.0.1", self.port).control))
            credentials = one.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
        return struct.unpack("3i", credentials)[0]

    def guard(self):
        """Return the status of the guard."""
        connection, _ = attach(self.backend.robot)
        try:
            return connection.request("status")
        finally:
            connection.close()


def same(one, other):
    """Return whether two traces are the same bit for bit but for what motion capture sees."""
    names = one.channels.keys() - {"vx", "vy"}
    return all(np.array_equal(one[name], other[name]) for name in names)


def trot(seed):
    """Return the ticks before the command."""
    return Schedule.of(VelocityCommand(), seed, 0, SETTINGS.gains).trot


@pytest.fixture(scope="module")
def first(session):
    """The first walk of the robot, with motion capture, and what it does not see of itself."""
    start, true = session.folder / "start.npz", {}

    def walking(n):
        truth = session.twin.truth()
        yaw = float(truth.rpy[2])
        true[n - trot(3)] = math.cos(yaw) * truth.velocity[0] + math.sin(yaw) * truth.velocity[1]
        if n == 0:
            session.twin.save(start)

    backend = robot(session.port, session.folder, f"mocap:{session.mocap}")
    return First(session.rollout({"vd": 0.2}, 3, walking, backend), backend, start, true)


class First(NamedTuple):
    """A trace, the backend that made it, the plant when the walk began, and true vx [m/s] by control tick."""

    trace: Trace
    backend: A1Backend
    start: Path
    true: dict[int, float]


def test_a_rollout_has_the_channels_that_were_promised(session, first):
    trace, backend = first.trace, first.backend
    assert trace.failure is None
    assert "void" not in trace.meta
    assert list(trace.channels) == [channel.name for channel in backend.channels]
    for channel in backend.channels:
        assert trace[channel.name].shape[1:] == ((channel.width,) if channel.width > 1 else ())
        assert trace.units[channel.name] == channel.unit
    assert (len(trace), trace.duration) == (51, DURATION)
    assert trace.meta["seed"] == 3
    assert trace.meta["model_hash"] == backend.model_hash
    assert trace.meta["twin"] is True
    assert trace["late"].sum() == 0.0
    assert (session.folder / "raw" / trace.meta["raw"]).exists()


def test_motion_capture_gives_the_true_velocity(first):
    trace = first.trace
    assert trace.meta["mocap"]["correlation"] > 0.8
    assert abs(trace.meta["mocap"]["turned"]) < 3.0
    seen = np.array([first.true[n] for n in range(len(trace))])
    assert abs((trace["vx"] - seen).mean()) < 0.005
    assert np.abs(trace["vx"] - seen).max() < 0.05
    assert np.abs(trace["vx"] - trace["vx_est"]).max() > 0.0


def test_poses_that_come_half_a_second_late_are_aligned_and_their_delay_is_in_the_trace(session):
    session.twin.injects = (read_inject("late_poses=0.5"),)
    try:
        trace = session.rollout(
            {"vd": 0.1}, 4, None, robot(session.port, session.folder, f"mocap:{session.mocap}")
        )
    finally:
        session.twin.injects = ()
    assert "void" not in trace.meta
    assert trace.meta["mocap"]["delay"] == pytest.approx(0.5, abs=0.01)
    assert abs((trace["vx"] - trace["vx_est"]).mean()) < 0.05


def test_from_the_same_start_the_simulator_takes_the_same_way_until_a_foot_touches_down(session, first):
    """Without delay or noise, and with readings and commands as they are on the wire."""
    trace, start = first.trace, first.start
    log = rawlog.read(session.folder / "raw" / trace.meta["raw"])
    walked = list(recording.Packets(log).walked())
    plant = Plant(SETTINGS.robot, SETTINGS.physics, knees=True)
    plant.restore(read_start(start))
    sensors = Sensors(SETTINGS.robot, SETTINGS.physics, "estimate")
    controller = Controller(SETTINGS.robot, SETTINGS.gains)
    # A robot's own world begins where it stands, and looks where it looks.
    (x, y, _), (_, _, yaw) = plant.truth().position, plant.truth().rpy
    controller.restore(Memory(np.array([x, y, yaw])))
    apart = 0.0
    for tick in range(TOUCH_DOWN):
        truth = plant.truth()
        apart = max(apart, np.abs(walked[tick].q - truth.q).max())
        orders = Orders(
            *controller.tick(sensors.read(truth, plant.play, controller.stance), VelocityCommand()).motors
        )
        plant.step(MotorCommand(*unpack_orders(pack(orders, A1), A1)), -math.inf)
    assert apart < 1e-3


def test_the_recording_holds_what_the_robot_saw_and_makes_the_same_trace_alone(session, first):
    trace = first.trace
    path = session.folder / "raw" / trace.meta["raw"]
    log = rawlog.read(path)
    sent = [data for data, to in zip(log.packets, log.directions, strict=True) if to == TO_ROBOT]
    came = session.twin.came
    begin = came.index(sent[0])
    assert came[begin : begin + len(sent)] == sent
    assert same(trace, recording.trace_of(path))


@pytest.mark.slow
def test_a_fall_after_the_command_is_the_robot_s_failure(session, first):
    trace = session.rollout({"vd": 0.2}, 5, session.inject(trot(5) + 20, "tilt=0.7"))
    session.twin.injects = ()
    assert trace.failure == "fall"
    assert "tilt" in trace.meta["reason"]
    assert 15 <= len(trace) <= 25
    assert session.guard()["state"] == "DAMPING"
    alone = recording.trace_of(session.folder / "raw" / trace.meta["raw"])
    assert (alone.failure, alone.meta["reason"]) == (trace.failure, trace.meta["reason"])
    assert same(trace, alone)


@pytest.mark.slow
def test_ctrl_c_in_a_test_makes_it_void_and_the_robot_lies(session, first):
    def walking(n):
        if n == trot(6) + 20:
            session.attended.interrupt(urgent=False)

    trace = session.rollout({"vd": 0.2}, 6, walking)
    assert trace.failure is None
    assert trace.meta["void"] == "operator"
    assert trace.duration < DURATION
    alone = recording.trace_of(session.folder / "raw" / trace.meta["raw"])
    assert (alone.meta["void"], alone.meta["reason"]) == ("operator", trace.meta["reason"])
    assert abs(len(alone) - len(trace)) <= 1
    session.attended.end()
    session.begun = False
    assert session.guard()["state"] == "RESTING"
    client = Client(session.backend.robot)
    try:
        with pytest.raises(BackendError, match="another program"):
            Client(session.backend.robot)
    finally:
        client.close()


@pytest.mark.slow
def test_a_guard_that_is_killed_in_a_test_leaves_a_void_rollout(session, first):
    def walking(n):
        if n == trot(7) + 30:
            os.kill(session.guard_s_process(), signal.SIGKILL)

    trace = session.rollout({"vd": 0.2}, 7, walking)
    assert trace.failure is None
    assert trace.meta["void"] == "link"
    assert 0.0 < trace.duration < DURATION
    assert not rawlog.read(session.folder / "raw" / trace.meta["raw"]).finished
    session.attended.before({"vd": 0.2})
    assert session.guard()["state"] == "ARMED"


@pytest.mark.slow
def test_the_same_walk_in_other_processes_is_the_same_bit_for_bit(monkeypatch, tmp_path, session, first):
    trace = first.trace
    monkeypatch.setenv("S2R_A1_RUN", str(tmp_path / "run"))
    record = tmp_path / "twin.a1log"
    with in_a_process("--place", "nominal", "--delay", 0, "--noise", "off", "--record", record) as port:
        backend = robot(port, tmp_path)
        attended = backend.attendance(Silent())
        try:
            attended.begin(Coming(1))
            other = backend.rollout({"vd": 0.2}, 3)
        finally:
            attended.end()
    assert same(trace, other)
    np.testing.assert_array_equal(other["vx"], other["vx_est"])
    log = rawlog.read(record)
    sent = [data for data, to in zip(log.packets, log.directions, strict=True) if to == TO_ROBOT]
    shared = 1000 + trot(3)  # standing up, and half of the walk at least
    assert sent[:shared] == session.twin.came[:shared]
