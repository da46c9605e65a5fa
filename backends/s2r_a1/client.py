"""The worker's two connections to the guard: requests over the control socket, packets over the wire protocol."""

from __future__ import annotations

import os
import select
from collections.abc import Mapping
from contextlib import ExitStack, closing
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

from s2r_a1.datagrams import LockStepSocket, RealTimeSocket
from s2r_a1.guard.checks import impossibility
from s2r_a1.guard.control import ControlError
from s2r_a1.guard.limits import LIMITS
from s2r_a1.guard.place import RobotAddress
from s2r_a1.guard.start import attach
from s2r_a1.link import UdpLink
from s2r_a1.mocap import SEARCH, Listener
from s2r_a1.ticks import PERIOD, SECONDS, TickUnit
from s2r_a1.wire import LAYOUTS, Orders, Reading
from s2r_spec.errors import BackendError, NotBegunError

PATIENCE = 30.0
"""A budget [s]: longest time of a round in lock step."""
WAIT = 2.0 * PERIOD
"""A budget [s]: time that a round waits for a state in real time, before it repeats the last orders. The guard bridges
10 ms; four times as much would count as silence."""


GONE = "GONE"
"""A definition: the state of a guard that ended while a client was attached."""


class StateChange(NamedTuple):
    """A state of the guard, with the reason as a word and a sentence; both "" if nothing is wrong."""

    state: str
    word: str = ""
    reason: str = ""


class Client:
    """A connection to the guard of a robot, in lock step or not, for a robot with a ``layout`` and a clock's ``unit``.

    Attributes:
        change: the newest state of the guard, as of the last ``receive`` or ``request``.
        wanted: the state that the guard requests, STAND or RESTING, and why; None while the robot may walk on.
        mocap: listener that collects poses with every reading; None for none.
    """

    def __init__(self, robot: RobotAddress, mocap: int | None = None) -> None:
        """Attach to the guard of a robot; collect poses at the UDP port ``mocap``.

        Raises:
            BackendError: no guard runs, it has another client, it has not measured the robot's clock yet, or the port
                cannot be opened.
        """
        self.wanted: StateChange | None = None
        self.mocap: Listener | None = None
        self.lockstep = robot.clock == "lockstep"
        with ExitStack() as opened:
            if mocap is not None:
                self.mocap = opened.enter_context(closing(Listener(mocap)))
            socket = opened.enter_context(closing(LockStepSocket() if self.lockstep else RealTimeSocket()))
            attached = attach(robot, "client", port=socket.port)
            if attached is None:
                raise BackendError(
                    f"no guard of the robot at {robot.host}:{robot.port} is running; start it with s2r certify, gap or "
                    "check in a terminal"
                )
            self._control, hello = attached
            opened.callback(self._control.close)
            if hello["tick_unit"] is None:
                raise BackendError(
                    "the guard has not measured the unit of the robot's clock yet; connect the robot first"
                )
            self.unit: TickUnit = hello["tick_unit"]
            self.change = StateChange(hello["state"])
            socket.connect(("127.0.0.1", int(hello["port"])))
            self.layout: str = hello["layout"]
            # The guard passes on only states whose clock is right, so a state that is new is enough here.
            self._link = UdpLink(socket, LAYOUTS[self.layout], self.unit, ahead=inf)
            self._opened = opened.pop_all()

    def ready(self) -> None:
        """Raise NotBegunError if the velocity comes from motion capture, and no pose arrives in time."""
        if self.mocap is None:
            return
        for _ in range(round(SEARCH / PERIOD)):
            if len(self.mocap.poses().times):
                break
            self.send(None)
            self.receive()
        else:
            raise NotBegunError(
                f"the UDP port {self.mocap.port} of this computer received no poses; stream lines of JSON with t, x, "
                "y, z, qw, qx, qy, qz"
            )

    def receive(self) -> Reading | None:
        """Return the state of this round, or None; in lock step, raise BackendError if the guard no longer answers."""
        if self.lockstep:
            self._wait()
        else:
            select.select([self._link], [], [], WAIT)
        self._listen()
        if self.change.state == GONE:
            return None
        reading = self._link.read()
        # The guard forwards every state, and bridges bad ones.
        if reading is None or impossibility(LIMITS, reading):
            return None
        if self.mocap is not None:
            self.mocap.take(reading.tick * SECONDS[self.unit])
        return reading

    def send(self, orders: Orders | None) -> None:
        """Send the orders of this round, or none."""
        if orders is None:
            self._link.skip()
        else:
            self._link.write(orders)

    def request(self, do: str, **fields: Any) -> Mapping[str, Any]:
        """Send a request to the guard, and return its reply; raise BackendError if it refuses, or has ended."""
        reply: Mapping[str, Any] = self._control.request(do, **fields)
        self._listen()
        if reply["state"] != self.change.state:
            self.change = StateChange(reply["state"])
        return reply

    def record(self, path: Path, header: Mapping[str, Any]) -> None:
        """Have the guard record every packet to a new file; raise BackendError if it cannot."""
        self.request("record", path=os.path.abspath(path), header=dict(header))

    def close(self) -> None:
        """Disconnect from the guard, which damps a robot that stands or walks."""
        self._opened.close()

    def _wait(self) -> None:
        """Wait for the guard's datagram, or for its end, which only the control socket shows."""
        link = self._link
        while self.change.state != GONE:
            ready, _, _ = select.select([link.fileno(), self._control.fileno()], [], [], PATIENCE)
            if not ready:
                raise BackendError(
                    f"the guard of the robot has not answered for {PATIENCE:g} s; end it, and run the command again"
                )
            if link.fileno() in ready:
                return
            self._listen()

    def _listen(self) -> None:
        """Read the guard's new events."""
        try:
            for event in self._control.take():
                change = StateChange(
                    str(event.get("state")), event.get("word") or "", event.get("reason") or ""
                )
                if event["event"] == "state":
                    self.change = change
                elif event["event"] == "wanted":
                    self.wanted = change
        except ControlError:
            self.change = StateChange(
                GONE, "link", "the guard of the robot has ended; nothing holds the robot now"
            )
