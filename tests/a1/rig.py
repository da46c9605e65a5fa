"""A guard, a twin and the program that moves it, round after round in one process, without sockets or clocks.

The guard, its links and its state machine are those of a user; only what carries bytes is made here. Whatever a test
says of the robot it reads from :attr:`Rig.received`: the datagrams that came to the twin.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import traceback
import warnings
from collections.abc import Callable
from typing import Any
from unittest import mock

import numpy as np

from s2r_a1 import datagrams
from s2r_a1.guard import loop, moves
from s2r_a1.guard.answers import answer
from s2r_a1.guard.control import Request
from s2r_a1.guard.place import RobotAddress
from s2r_a1.guard.states import State
from s2r_a1.ticks import PERIOD, Counters
from s2r_a1.twin import Twin, TwinSettings, read_inject
from s2r_a1.wire import A1, CLOSED_LOOP, Orders, checksum, pack, unpack, unpack_orders

ROBOT_PORT, CLIENT_PORT = 8007, 40000
SETTLING = 40
"""Rounds of a state before its faults."""
ZERO = np.zeros(12)
HELD = Orders(moves.STANDING, ZERO, moves.KP, moves.KD, np.full(12, 0.5))
"""What the client orders: the stand, with a torque of its own by which its orders are known."""
STAND_ON = pack(HELD, A1)
DAMPED = Orders(ZERO, ZERO, ZERO, np.full(12, 3.0), ZERO)


def raw(orders, **words):
    """Return the bytes of orders in which some words of motor 4 are others, as on the wire; the checksum is right."""
    packet = np.frombuffer(bytearray(pack(orders, A1)), A1.command).reshape(()).copy()
    for name, word in words.items():
        packet["motors"][name][4] = word
    data = packet.tobytes()
    return data[:-4] + checksum(data).to_bytes(4, "little")


def damping(data):
    """Return whether a packet damps the robot: every motor in its loop, Kd 3, and nothing else."""
    motors = np.frombuffer(data, A1.command).reshape(())["motors"][:12]
    kd = (motors["mode"] == CLOSED_LOOP).all() and (motors["kd"] == 3 * 16).all()
    return bool(kd) and not any(motors[name].any() for name in ("q", "dq", "tau", "kp"))


def limp(data):
    """Return whether a packet has neither gains nor torque."""
    orders = unpack_orders(data, A1)
    return not (orders.kp.any() or orders.kd.any() or orders.tau.any())


class Party:
    """A connection to the guard, in memory.

    Attributes:
        replies: to its requests, oldest first.
        events: that the guard published.
    """

    def __init__(self, listener):
        self.role, self.pid, self.spent, self.open = None, None, False, True
        self.replies, self.events = [], []
        self._listener = listener
        listener.parties.append(self)

    def ask(self, do, **fields):
        """Make a request, which is served when the guard next looks."""
        self._listener.asked.append((self, Request(do, fields)))

    def send(self, message):
        (self.replies if "ok" in message else self.events).append(message)

    def flush(self):
        pass

    def close(self):
        self.open = False


class Listener:
    def __init__(self, ready):
        self.parties, self.asked = [], []
        self._ready = ready

    def filenos(self):
        return [self._ready]

    def take(self, ready):
        asked, self.asked = self.asked, []
        return asked

    def ended(self):
        ended = [party for party in self.parties if not party.open]
        self.parties = [party for party in self.parties if party.open]
        return ended

    def publish(self, event):
        for party in self.parties:
            if party.role is not None:
                party.send(event)

    def renew(self):
        pass

    def close(self):
        pass


class Leg:
    """One end of a leg of the wire; ``exchange`` is the other one: a datagram in, what arrives in that round out."""

    def __init__(self, ready, exchange):
        self.counters, self.gone, self.port = Counters(), False, 1
        self._ready, self._exchange, self._arrived, self._rounds = ready, exchange, [], 0

    def send(self, data):
        self._arrived = self._exchange(data)

    def skip(self):
        self.send(b"")

    def receive(self):
        self._rounds += 1
        self.counters.received += len(self._arrived)
        return [(data, self._rounds * PERIOD) for data in self._arrived]

    def fileno(self):
        return self._ready

    def close(self):
        pass


class Rig:
    """A twin that its guard keeps, and the program that moves it.

    Attributes:
        twin: as a user's; ``inject`` gives it a fault.
        guard: as a user's.
        operator, client: their connections.
        orders: what the client sends every round: bytes, or what returns them from the round's state.
        received: (round of the twin, datagram) of all that came to the twin.
        client_ticks: ticks of the states that the client got.
    """

    def __init__(self, **settings):
        settings.setdefault("place", "nominal")
        self.twin = Twin(TwinSettings(**settings))
        self._ready, self._other = os.pipe()
        os.write(self._other, b"\0")  # never read: what waits for this waits for nothing
        listener = Listener(self._ready)
        layout = self.twin.settings.layout.name.lower()
        self.guard = loop.Guard(RobotAddress("127.0.0.1", ROBOT_PORT, layout, "lockstep"), listener, answer)
        self.operator, self.client = Party(listener), Party(listener)
        self.orders = STAND_ON
        self.received, self.client_ticks = [], []
        self.ask(self.operator, "hello", role="operator")

    def _opened(self, peer, **how):
        return Leg(self._ready, self._to_robot if peer[1] == ROBOT_PORT else self._to_client)

    def _to_robot(self, data):
        self.received.append((self.twin.rounds, data))
        return self.twin.round([data])

    def _to_client(self, data):
        if data:
            self.client_ticks.append(unpack(data, A1).tick)
        sent = self.orders(data) if callable(self.orders) else self.orders
        return [sent] if sent else []

    @property
    def state(self):
        return self.guard.machine.state

    def turn(self, rounds=1):
        """Turn rounds; the sockets that the guard opens meanwhile are the rig's."""
        with mock.patch.object(datagrams, "open_socket", self._opened):
            for _ in range(rounds):
                self.guard.turn()

    def until(self, state, rounds=3000):
        for _ in range(rounds):
            if self.state is state:
                return
            self.turn()
        raise AssertionError(f"{self.guard.machine.state} is not {state}: {self.guard.machine.reason}")

    def ask(self, party, do, **fields):
        """Make a request, turn rounds until its reply comes, and return that."""
        before = len(party.replies)
        party.ask(do, **fields)
        for _ in range(2000):
            if len(party.replies) > before:
                return party.replies[-1]
            self.turn()
        raise AssertionError(f"no reply to {do}")

    def inject(self, *texts, rounds=None):
        """Give the twin faults from its next round on, for a number of rounds; return that round."""
        first = self.twin.rounds
        last = "" if rounds is None else first + rounds - 1
        self.twin.injects += tuple(read_inject(f"{text}@{first}-{last}") for text in texts)
        return first

    def bring(self, state):
        """Bring the robot to a state by the requests of its operator and its client."""
        for ends, party, do in (
            (State.LINKED, self.operator, "connect"),
            (State.ARMED, self.operator, "arm"),
            (State.ARMED, self.client, "hello"),
            (State.STANDING_UP, self.client, "stand"),
            (State.STAND, None, ""),
            (State.WALK, self.client, "walk"),
            (State.STAND, self.client, "halt"),
            (State.LYING_DOWN, self.client, "lie"),
            (State.RESTING, None, ""),
        ):
            if party:
                fields = {"role": "client", "port": CLIENT_PORT} if do == "hello" else {}
                reply = self.ask(party, do, **fields)
                assert reply["ok"], reply
            self.until(ends)
            if do != "arm":
                self.turn(SETTLING)
                yield ends
        assert state is None

    def close(self):
        self.guard.close()
        os.close(self._ready)
        os.close(self._other)


def apart(function: Callable[[], Any]) -> Any:
    """Return what a function returns in a copy of this process, and leave this one as it is."""
    processes = multiprocessing.get_context("fork")
    mine, theirs = processes.Pipe(duplex=False)

    def run() -> None:
        try:
            theirs.send((function(), None))
        except BaseException:
            theirs.send((None, traceback.format_exc()))

    gc.freeze()  # what the copy does not touch is not copied
    process = processes.Process(target=run)
    with warnings.catch_warnings():
        # Of forks beside threads; the copy runs none of them.
        warnings.simplefilter("ignore", DeprecationWarning)
        process.start()
    theirs.close()
    try:
        found, error = mine.recv()
    finally:
        process.join()
        mine.close()
        gc.unfreeze()
    assert error is None, error
    return found
