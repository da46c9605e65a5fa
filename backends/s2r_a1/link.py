"""Reads states and writes orders over one leg of the wire; nothing above knows sockets.

Both legs speak the same wire: guard and robot, worker and guard. Whoever gives orders holds a :class:`Link`, and
whoever obeys them a :class:`RobotSide`. Whether they run in real time or in lock step is the business of the socket
under them (:mod:`s2r_a1.datagrams`).

    link = UdpLink(opened(("127.0.0.1", 8007)), A1)
    link.write(orders)
    reading = link.read()       # None: nothing new in this round; link.fault says why, link.packet what came
"""

from __future__ import annotations

from typing import Literal, Protocol

from s2r_a1.datagrams import FROM_ROBOT, TO_ROBOT, LinkError, Socket, Tap
from s2r_a1.ticks import Counters, TickFault, Ticks, TickUnit
from s2r_a1.wire import Command, Fault, Layout, Orders, Reading, WireError, pack, read_command, unpack

__all__ = ["Link", "LinkError", "LinkFault", "RobotSide", "UdpLink"]

LinkFault = Literal["silence", "gone"] | Fault | TickFault
"""Why a read gave nothing: no packet; in lock step, a peer that ended; a packet that must not be used; an old one."""


class Link(Protocol):
    """The side of the wire that gives orders.

    Attributes:
        counters: what happened since the link was opened.
        packet: the datagram that the last read came to its answer by, as it came; empty where none came.
        fault: why the last read gave nothing; None where it gave a reading.
        tap: sees every datagram with its direction; a raw log, for instance.
    """

    counters: Counters
    packet: bytes
    fault: LinkFault | None
    tap: Tap | None

    @property
    def unit(self) -> TickUnit | None:
        """The unit of the robot's ticks; None until it is measured, half a second after the first state."""

    @property
    def refusal(self) -> str | None:
        """A sentence if the robot's ticks have neither known unit."""

    def read(self) -> Reading | None:
        """Return the newest state that was not returned before, or None if no such state came."""

    def write(self, orders: Orders | Command) -> None:
        """Send orders to the motors.

        Raises:
            WireError: a number does not fit its field; nothing is sent.
        """

    def skip(self) -> None:
        """Send nothing in this round; lock step goes on all the same."""

    def forget(self) -> None:
        """Take the next state for new and measure the unit again, as after the robot was switched off and on."""

    def fileno(self) -> int | None:
        """Return what ``select`` waits for; None where only a read tells whether a state came."""

    def close(self) -> None:
        """Free what the link holds."""


class UdpLink:
    """A :class:`Link` over a socket, in real time or in lock step.

    Attributes:
        counters: what happened since the link was opened.
        packet: the datagram that the last read came to its answer by, as it came; empty where none came.
        fault: why the last read gave nothing; None where it gave a reading.
        tap: sees every datagram with its direction; a raw log, for instance.
    """

    def __init__(self, socket: Socket, layout: Layout, unit: TickUnit | None = None) -> None:
        self.counters = socket.counters
        self.packet = b""
        self.fault: LinkFault | None = None
        self.tap: Tap | None = None
        self._socket = socket
        self._layout = layout
        self._ticks = Ticks(socket.counters, unit)

    @property
    def unit(self) -> TickUnit | None:
        """The unit of the robot's ticks, if it is known."""
        return self._ticks.unit

    @property
    def refusal(self) -> str | None:
        """A sentence if the robot's ticks have no known unit."""
        return self._ticks.refusal

    def read(self) -> Reading | None:
        """Return the newest state that was not returned before, or None if no such state came.

        Of several datagrams the newest that can be used counts; ``fault`` is of the last one where none can.
        """
        arrived = self._socket.receive()
        newest: Reading | None = None
        self.packet, self.fault = b"", "gone" if self._socket.gone else "silence"
        for data in arrived:
            if self.tap:
                self.tap(FROM_ROBOT, data)
            fault, reading = self._judge(data)
            if reading:
                newest, self.packet, self.fault = reading, data, None
            elif newest is None:
                self.packet, self.fault = data, fault
        self.counters.late += newest is None
        return newest

    def write(self, orders: Orders | Command) -> None:
        """Send orders to the motors.

        Raises:
            WireError: a number does not fit its field; nothing is sent.
        """
        self.send(pack(orders, self._layout))

    def send(self, data: bytes) -> None:
        """Send a command that is packed already."""
        self._socket.send(data)
        if self.tap:
            self.tap(TO_ROBOT, data)

    def skip(self) -> None:
        """Send nothing in this round; lock step goes on all the same."""
        self._socket.skip()

    def forget(self) -> None:
        """Take the next state for new and measure the unit again, as after the robot was switched off and on."""
        self._ticks.forget()

    def fileno(self) -> int:
        """Return what ``select`` waits for."""
        return self._socket.fileno()

    def close(self) -> None:
        """Free the port."""
        self._socket.close()

    def _judge(self, data: bytes) -> tuple[LinkFault | None, Reading | None]:
        """Return the reading of a datagram, or what is wrong with it."""
        try:
            reading = unpack(data, self._layout)
        except WireError as error:
            _count(self.counters, error)
            return error.fault, None
        fault = self._ticks.judge(reading.tick, self._socket.now())
        return fault, None if fault else reading


class RobotSide:
    """The side of the wire that obeys: the guard towards its client, a twin towards whoever drives it.

    Attributes:
        counters: what happened since the side was opened.
        packet: the datagram that the last read came to its answer by; empty where none came.
        fault: why the last read gave nothing; None where it gave orders.
        tap: sees every datagram with its direction.
    """

    def __init__(self, socket: Socket, layout: Layout) -> None:
        self.counters = socket.counters
        self.packet = b""
        self.fault: LinkFault | None = None
        self.tap: Tap | None = None
        self._socket = socket
        self._layout = layout

    def read(self) -> Orders | None:
        """Return the newest orders of this round, or None if none came that can be used."""
        command = self.receive()
        return command and command.orders()

    def receive(self) -> Command | None:
        """Return the newest command of this round, or None if none came that can be used."""
        newest: Command | None = None
        arrived = self._socket.receive()
        self.packet, self.fault = b"", "gone" if self._socket.gone else "silence"
        for data in arrived:
            if self.tap:
                self.tap(TO_ROBOT, data)
            try:
                newest = read_command(data, self._layout)
            except WireError as error:
                _count(self.counters, error)
                if newest is None:
                    self.packet, self.fault = data, error.fault
            else:
                self.packet, self.fault = data, None
        self.counters.late += newest is None
        return newest

    def send(self, data: bytes) -> None:
        """Send a state that is packed already, unchanged."""
        self._socket.send(data)
        if self.tap:
            self.tap(FROM_ROBOT, data)

    def skip(self) -> None:
        """Send no state in this round; lock step goes on all the same."""
        self._socket.skip()

    def fileno(self) -> int:
        """Return what ``select`` waits for."""
        return self._socket.fileno()

    def close(self) -> None:
        """Free the port."""
        self._socket.close()


def _count(counters: Counters, error: WireError) -> None:
    if error.fault == "number":
        counters.numbers += 1
    else:
        counters.corrupt += 1
