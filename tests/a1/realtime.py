"""A twin, a guard and a client in real time, each in a process of its own: for signals, and for what the clock says."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import select
import signal
import threading
import time
from collections import deque

import numpy as np

from s2r_a1.datagrams import TO_ROBOT, RealTimeSocket
from s2r_a1.guard.control import RefusedError
from s2r_a1.guard.place import RobotAddress
from s2r_a1.guard.start import attach, start
from s2r_a1.twin import Twin, TwinSettings, read_inject
from s2r_a1.twin.server import Server
from s2r_a1.undisturbed import undisturbed
from s2r_a1.wire import A1, unpack_orders
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.errors import BackendError
from tests.a1.rig import STAND_ON, damping
from tests.a1.robots import end_guard

PROCESSES = multiprocessing.get_context("spawn")
PATIENCE = 60.0
PRIORITY = 30
"""Of a robot, which nothing on its own computer holds up; where the system allows it."""


class TooBusyError(Exception):
    """This machine lets nobody walk in real time now."""


def _come_first():
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))


class _Stamped(Twin):
    """A twin that notes when its rounds ended [ns], until somebody takes the notes."""

    def __init__(self, settings):
        super().__init__(settings)
        self.stamps = deque()
        self._ended = 0

    def round(self, arrived):
        answers = super().round(arrived)
        if self.begun:
            self.stamps.append((self._ended, time.monotonic_ns()))
            self._ended += 1
        return answers


def _emptied(notes):
    """Return what a deque holds, and empty it, while another thread may add to it.

    To send the notes of a whole life again and again would hold the robot up.
    """
    return [notes.popleft() for _ in range(len(notes))]


def _robot(line, place):
    twin = _Stamped(TwinSettings(place=place))
    received = deque()

    def tap(at, direction, data):
        if direction == TO_ROBOT:
            received.append((time.monotonic_ns(), data))

    with Server(twin, ("127.0.0.1", 0), tap=tap) as server:

        def obeys():
            while True:
                do, *values = line.recv()
                if do == "inject":
                    first = twin.rounds + 1
                    twin.injects = tuple(read_inject(f"{text}@{first}-") for text in values)
                    line.send(first)
                elif do == "taken":
                    line.send((dict(_emptied(twin.stamps)), _emptied(received)))
                else:
                    server.stop()
                    return

        threading.Thread(target=obeys, daemon=True).start()
        line.send(server.port)
        _come_first()
        server.serve_in_real_time()


def _client(line, robot):
    """Stand, walk, and go on ordering whatever happens; say when it walks, and what it was refused in the end."""
    socket = RealTimeSocket()
    try:
        with undisturbed(first=True):
            control, hello = attach(robot, "client", port=socket.port)
            socket.connect(("127.0.0.1", hello["port"]))
            control.request("stand")
            if not _orders_until(control, socket, "STAND"):
                raise BackendError(control.request("status")["reason"])
            control.request("walk")
            line.send("walks")
            _orders_until(control, socket, "DAMPING")
            refused = []
            for do in ("walk", "stand", "halt"):
                try:
                    control.request(do)
                except BackendError as error:
                    refused.append(str(error))
            for _ in range(100):
                time.sleep(0.002)
                socket.send(STAND_ON)
        line.send(refused)
    except BackendError as error:
        line.send(str(error))
    line.close()


def _search(line, robot):
    """Attend the robot from a process with the memory of a search, until it is killed."""
    points = np.linspace(0.0, 1.0, 500)[:, None]
    np.linalg.eigh(Kernel("rbf", 0.3).gram(points, points))
    operator, _ = start(robot)
    line.send("attends")
    select.select([operator], [], [])
    line.recv()


def _orders_until(control, socket, state):
    """Answer every state with orders until the guard is in a state; return whether it came to it."""
    while True:
        select.select([socket, control], [], [], 0.004)
        if socket.receive():
            socket.send(STAND_ON)
        for event in control.take():
            if event["event"] == "state" and event["state"] in (state, "DAMPING"):
                return event["state"] == state


class Walking:
    """A robot in real time. :meth:`walk` lets a new client walk; :meth:`taken` returns what the robot got since.

    Attributes:
        operator: a connection to the guard; None after it was killed.
        client: the process that moves the robot.
        client_closed: when the system closed the connections of a client that was killed [ns].
    """

    def __init__(self, place="nominal"):
        self._line, theirs = PROCESSES.Pipe()
        self._twin = PROCESSES.Process(target=_robot, args=(theirs, place), daemon=True)
        self._twin.start()
        self.robot = RobotAddress("127.0.0.1", self._line.recv())
        self.operator, self.client, self.client_closed = None, None, None

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._end_client()
        if self.operator:
            self.operator.close()
        end_guard(self.robot.port)
        self._line.send(("end",))
        self._twin.join(PATIENCE)
        self._twin.kill()

    def walk(self, tries=5):
        """Bring the robot to WALK by a new client; a machine that is busy may need several tries."""
        for _ in range(tries):
            self._end_client()
            try:
                self._ready()
            except RefusedError as error:  # the self-test found the computer too slow
                why = str(error)
                continue
            self.client_reply, theirs = PROCESSES.Pipe()
            self.client = PROCESSES.Process(target=_client, args=(theirs, self.robot), daemon=True)
            self.client.start()
            theirs.close()
            try:
                why = self.client_reply.recv()
            except EOFError:
                why = "the client ended"
            time.sleep(0.02)
            if why == "walks" and self.status()["state"] == "WALK":
                self.taken()
                return
        raise TooBusyError(f"this machine is too busy to walk in real time: {why}; {self.status()['reason']}")

    def _ready(self):
        self._line.send(("inject",))
        self._line.recv()
        if self.operator is None:
            self.operator, _ = start(self.robot)
        state = self.status()["state"]
        if state in ("STANDING_UP", "STAND", "WALK", "LYING_DOWN"):
            self.operator.request("damp")
            state = "DAMPING"
        if state == "DAMPING":
            self.operator.request("reset")
        self.operator.request("connect")
        self.operator.request("arm")

    def _end_client(self):
        if self.client:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.client.pid, signal.SIGCONT)
            self.client.kill()
            self.client.join()
            self.client = None

    def status(self):
        return self.operator.request("status")

    def inject(self, *texts):
        """Give the twin faults; return the round of the first state that has them."""
        self._line.send(("inject", *texts))
        return self._line.recv()

    def taken(self):
        """Return {round: when it ended [ns]} of the twin and (time, packet) of what came, since the last call."""
        self._line.send(("taken",))
        return self._line.recv()

    def kill_guard(self):
        os.kill(self.status()["pid"], signal.SIGKILL)
        self.operator.close()
        self.operator = None

    def kill_search(self):
        """Let a search attend the robot alone, and kill it; return when [ns]."""
        line, theirs = PROCESSES.Pipe()
        search = PROCESSES.Process(target=_search, args=(theirs, self.robot), daemon=True)
        search.start()
        line.recv()
        self.operator.close()
        time.sleep(0.1)
        now = time.monotonic_ns()
        search.kill()
        search.join()
        self.operator, _ = start(self.robot)
        return now

    def until_client_closed(self):
        """Wait until a client that was killed has no connection any more, and note when that was."""
        with contextlib.suppress(EOFError):
            while True:
                self.client_reply.recv()
        self.client_closed = time.monotonic_ns()


def first_damped(received, since):
    """Return when the first packet that damps came after a time [ns]; None if none did."""
    return next((at for at, data in received if at >= since and damping(data)), None)


def moves_after(received, since):
    """Return how many packets with a gain on an angle, or a torque, came after a time [ns]."""
    orders = (unpack_orders(data, A1) for at, data in received if at > since)
    return sum(bool(np.any(one.kp) or np.any(one.tau)) for one in orders)
