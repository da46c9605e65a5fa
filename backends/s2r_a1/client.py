"""The worker's two connections to the guard: requests over its control socket, packets over the robot's own wire."""

from __future__ import annotations

import os
import select
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from s2r_a1.datagrams import LockStepSocket, RealTimeSocket
from s2r_a1.guard.control import ControlError
from s2r_a1.guard.limits import LIMITS, impossible
from s2r_a1.guard.place import Robot
from s2r_a1.guard.start import attach
from s2r_a1.link import UdpLink
from s2r_a1.mocap import Listener
from s2r_a1.ticks import PERIOD, SECONDS, TickUnit
from s2r_a1.walk import GONE, Change
from s2r_a1.wire import LAYOUTS, Orders, Reading
from s2r_spec.errors import BackendError, NotBegunError

PATIENCE = 30.0
"""A budget [s]: how long a round of lock step may take. Twice as much waits longer for a guard that is stuck."""
WAIT = 2.0 * PERIOD
"""A budget [s]: how long a round waits for a state in real time, before the last orders go out again. The guard bridges
10 ms; four times as much would be taken for silence."""


class Client:
    """A :class:`~s2r_a1.walk.Line` to the guard of a robot.

    Attributes:
        lockstep: whether it runs in lock step.
        layout: name of the robot's packets, "a1".
        unit: of the robot's clock.
        change: the newest state of the guard, as of the last ``receive`` or ``request``.
        wanted: what the guard asks this client to come to, and why; None as long as it may walk on.
        mocap: takes in poses with every reading, if it is set.
    """

    def __init__(self, robot: Robot) -> None:
        """Attach to the guard of a robot.

        Raises:
            BackendError: none lives, it has a client, or it does not know the robot's clock yet.
        """
        self.wanted: Change | None = None
        self.mocap: Listener | None = None
        self.lockstep = robot.clock == "lockstep"
        self._socket = LockStepSocket() if self.lockstep else RealTimeSocket()
        try:
            self._attach(robot)
        except BaseException:
            self._socket.close()
            raise

    def _attach(self, robot: Robot) -> None:
        attached = attach(robot, "client", port=self._socket.port)
        if attached is None:
            raise BackendError(
                f"no guard of the robot at {robot.host}:{robot.port} is running; the command that holds the terminal "
                "starts it: s2r certify, gap or check"
            )
        self._control, hello = attached
        if hello["tick_unit"] is None:
            self._control.close()
            raise BackendError(
                "the guard has not measured the unit of the robot's clock yet; connect the robot first"
            )
        self.unit: TickUnit = hello["tick_unit"]
        self.change = Change(hello["state"])
        self._socket.connect(("127.0.0.1", int(hello["port"])))
        self.layout: str = hello["layout"]
        self._link = UdpLink(self._socket, LAYOUTS[self.layout], self.unit)

    def ready(self) -> None:
        """Say if there is no motion capture where it is needed.

        Raises:
            NotBegunError: see there.
        """
        if self.mocap is not None and not len(self.mocap.poses().times):
            raise NotBegunError(
                f"no motion capture came to the UDP port {self.mocap.port} of this machine; stream lines "
                "of JSON with t, x, y, z, qw, qx, qy, qz"
            )

    def receive(self) -> Reading | None:
        """Return the state of this round; None where none came that can be used.

        Raises:
            BackendError: in lock step, the guard does nothing any more.
        """
        if self.lockstep:
            self._wait()
        else:
            select.select([self._link], [], [], WAIT)
        self._listen()
        if self.change.state == GONE:
            return None
        reading = self._link.read()
        if reading is None or impossible(LIMITS, reading):  # the guard forwards what comes, and bridges it
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
        """Ask the guard for something, and return its reply.

        Raises:
            BackendError: it refuses, or is gone; the sentence says why.
        """
        reply: Mapping[str, Any] = self._control.request(do, **fields)
        self._listen()
        if reply["state"] != self.change.state:
            self.change = Change(reply["state"])
        return reply

    def record(self, path: Path, header: Mapping[str, Any]) -> None:
        """Have the guard record every packet to a file, which must not exist.

        Raises:
            BackendError: it cannot.
        """
        self.request("record", path=os.path.abspath(path), header=dict(header))

    def close(self) -> None:
        """Leave the guard. Where the robot stands or walks, that is a fault to it."""
        self._control.close()
        self._socket.close()

    def _wait(self) -> None:
        """Wait for the guard's datagram, or for its end, of which a datagram socket does not tell."""
        link = self._link
        while self.change.state != GONE:
            ready, _, _ = select.select([link.fileno(), self._control.fileno()], [], [], PATIENCE)
            if not ready:
                raise BackendError(
                    f"the guard of the robot has done nothing for {PATIENCE:g} s; end it, and start anew"
                )
            if link.fileno() in ready:
                return
            self._listen()

    def _listen(self) -> None:
        """Read the events that the guard has sent."""
        try:
            for event in self._control.take():
                change = Change(str(event.get("state")), event.get("word") or "", event.get("reason") or "")
                if event["event"] == "state":
                    self.change = change
                elif event["event"] == "wanted":
                    self.wanted = change
        except ControlError:
            self.change = Change(
                GONE, "link", "the guard of the robot has ended; nothing holds the robot now"
            )
