"""The program that moves the robot, as its guard sees it: a control connection and a packet connection."""

from __future__ import annotations

from s2r_a1 import datagrams
from s2r_a1.guard.control import Party
from s2r_a1.link import RobotSide
from s2r_a1.wire import Layout, MotorPacket


class ClientSession:
    """The client of a guard: its control connection, its UDP address, and the guard's socket for its packets."""

    def __init__(self, party: Party, port: int, layout: Layout, lockstep: bool) -> None:
        """Open a socket to the client's UDP port; raise LinkError if it cannot be reached."""
        self.party = party
        self.address = ("127.0.0.1", port)
        self.socket = datagrams.open_socket(self.address, lockstep=lockstep)
        self._side = RobotSide(self.socket, layout)

    def send(self, state: bytes) -> None:
        """Send a state of the robot, or in lock step an empty datagram for silence."""
        if state:
            self._side.send(state)
        else:
            self._side.skip()

    def orders(self, follow: bool) -> tuple[MotorPacket | None, int]:
        """Return the newest valid commands, and the number of packets that are not valid.

        Commands that the guard does not ``follow`` are discarded without decoding.
        """
        if not follow or self.party.spent:
            self.socket.receive()
            return None, 0
        counters = self._side.counters
        before = counters.corrupt + counters.numbers
        orders = self._side.receive()
        return orders, counters.corrupt + counters.numbers - before
