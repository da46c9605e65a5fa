"""Guard, twin and pilot in one process: the lock-step rollout of `a1` without sockets, bit for bit the same.

The guard's state machine, the twin, the packets of both legs and the walk are the ones of the package; only who carries
a packet from one to the next is another. `a1_headline.py` needs thousands of rollouts, and shows on a few that they
are those of `a1:…,clock=lockstep`.

Units: times of the guard [ns], a round is 2 ms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from s2r_a1.guard import states
from s2r_a1.guard.answers import PATIENCE
from s2r_a1.guard.limits import LIMITS, ROBOT_WORDS, ROUND
from s2r_a1.guard.states import ROWS, Arrival, Conditions, Inputs, Machine, State
from s2r_a1.link import UdpLink
from s2r_a1.pilot import Pilot
from s2r_a1.schedule import Schedule
from s2r_a1.ticks import PERIOD, Counters, TickUnit
from s2r_a1.twin import Twin
from s2r_a1.walk import Change, walk
from s2r_a1.wire import A1, Orders, Reading, pack, unpack_orders
from s2r_sim.controller.gains import RATE
from s2r_sim.robot.signals import Command
from s2r_spec.errors import BackendError
from s2r_spec.trace import Trace


class _Wire:
    """A lock-step socket (:class:`s2r_a1.datagrams.Socket`) whose peer is a twin in this process."""

    port = 0

    def __init__(self, twin: Twin) -> None:
        self.counters = Counters()
        self.gone = False
        self._twin = twin
        self._rounds = 0
        self._came: list[bytes] = []

    def connect(self, peer: tuple[str, int]) -> None:
        """Do nothing: there is one peer."""

    def send(self, data: bytes) -> None:
        """Let a round of the twin pass."""
        self._came = self._twin.round([data])[-1:]

    def skip(self) -> None:
        """Let a round pass in which nothing reaches the twin."""
        self.send(b"")

    def receive(self) -> list[bytes]:
        """Return the state of the round."""
        came, self._came = self._came, []
        self._rounds += 1
        self.counters.received += len(came)
        return came

    def now(self) -> float:
        """Return the time of the rounds so far [s]."""
        return self._rounds * PERIOD

    def fileno(self) -> int:
        """There is nothing to wait for."""
        return -1

    def close(self) -> None:
        """There is nothing to free."""


class Line:
    """A :class:`s2r_a1.walk.Line` to a guard and a twin in this process; the twin is armed when it is made.

    Attributes:
        unit: of the robot's clock.
        change: the state of the guard.
        wanted: never set: nobody is there to ask for a stop.
        true: of every state that came since ``keep``: its tick, and the true forward velocity [m/s].
    """

    def __init__(self, twin: Twin) -> None:
        self._twin = twin
        self._link = UdpLink(_Wire(twin), A1)
        self._machine = Machine()
        self._orders: Orders | None = None
        self._rounds = 0
        self._found = Arrival()
        self.true: dict[int, float] = {}
        self.change = Change(State.OFF)
        self.wanted: Change | None = None
        self._be_armed()
        unit = self._link.unit
        assert unit is not None
        self.unit: TickUnit = unit

    def receive(self) -> Reading | None:
        """Send the command of the last round, and return the robot's state, as the guard forwards it."""
        if self._orders is not None:
            self._link.write(self._orders)
        self._found = states.arrived(LIMITS, self._link.read(), self._link.fault)
        if self._found.reading is not None:
            truth = self._twin.truth()
            yaw = float(truth.rpy[2])
            forward = math.cos(yaw) * truth.velocity[0] + math.sin(yaw) * truth.velocity[1]
            self.true[self._found.reading.tick] = float(forward)
        return self._found.reading

    def send(self, orders: Orders | None) -> None:
        """End the round: the guard takes the client's orders, as they are on the wire, and makes one step."""
        came = None if orders is None else unpack_orders(pack(orders, A1), A1)
        self._rounds += 1
        inputs = Inputs(self._rounds * ROUND, self._found, came)
        step = states.step(self._machine, inputs, LIMITS)
        self._orders = step.orders
        self._become(step.machine)

    def request(self, do: str, **fields: Any) -> Mapping[str, Any]:
        """Ask the guard for a motion.

        Raises:
            BackendError: it refuses.
        """
        if do == "leave":
            self.send(None)
            return {}
        machine, refusal = states.request(self._machine, do, "client", fields.get("reason"), LIMITS)
        if refusal:
            raise BackendError(refusal)
        self._become(machine)
        return {"state": machine.state}

    def _be_armed(self) -> None:
        """Give both consents, as ``operator=auto`` does."""
        self._become(states.connected(self._machine, 0))
        self._orders = ROWS[self._machine.state].orders(self._machine, 0, LIMITS)
        self._turn_until(lambda: self._link.unit is not None)
        conditions = Conditions(True, None, True)
        self._turn_until(lambda: states.unready(self._machine, conditions, LIMITS) is None)
        self._become(states.armed(self._machine, self._rounds * ROUND))

    def _turn_until(self, met: Any) -> None:
        for _ in range(PATIENCE + 1):
            self.receive()
            self.send(None)
            if met():
                return
        raise BackendError("the twin does not get ready")

    def _become(self, machine: Machine) -> None:
        self._machine = machine
        if machine.state != self.change.state:
            self.change = Change(machine.state, machine.word or "", machine.reason or "")


class Rollout(NamedTuple):
    """One test that was walked.

    Attributes:
        onboard: forward velocity by the robot's own estimate, as `a1:velocity=onboard` has it in ``vx``.
        true: the same test with the forward velocity that the twin really has.
        void: the word of what ended it, if that was not the robot.
    """

    onboard: Trace
    true: Trace
    void: str | None


def rollout(line: Line, pilot: Pilot, vd: float, seed: int, seconds: float) -> Rollout:
    """Walk one test of a forward velocity [m/s], from wherever the robot is; it stands afterwards.

    Raises:
        NotBegunError: it ended before t = 0.
    """
    hold = round(seconds * RATE)
    schedule = Schedule.of(Command(vd, 0.0, 0.0), seed, hold, pilot.settings.gains)
    line.true.clear()
    walked = walk(line, pilot, schedule)
    line.request("leave")
    notes = [note for note in walked.notes if 0 <= note.tick <= hold]
    times = np.array([note.tick for note in notes]) / RATE
    meta: dict[str, Any] = {"params": {"vd": vd}, "seed": seed}
    void = None
    if walked.ending is not None and notes[-1].tick < hold:
        word = walked.ending.word
        if word in ROBOT_WORDS:
            meta["failure"] = word
        else:
            void = word or "operator"
    yaw = np.array([note.state.rpy[2] for note in notes])
    x, y, _ = np.array([note.state.velocity for note in notes]).T
    estimate = np.cos(yaw) * x + np.sin(yaw) * y
    true = np.array([line.true[note.clock] for note in notes])
    units = {"vx": "m/s"}
    return Rollout(Trace(times, {"vx": estimate}, units, meta), Trace(times, {"vx": true}, units, meta), void)
