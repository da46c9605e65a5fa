"""Read states and write commands over one connection; only this module and the ones below use sockets.

Both connections use the same wire protocol: guard and robot, worker and guard. The sender of commands has a
:class:`Link`, and the receiver a :class:`RobotSide`. The socket below decides between real time and lock step
(:mod:`s2r_a1.datagrams`).

    link = UdpLink(opened(("127.0.0.1", 8007)), A1)
    link.write(orders)
    reading = link.read()       # None: no new state in this round; see link.fault and link.packet
"""

from __future__ import annotations

from typing import Literal, Protocol

from s2r_a1.datagrams import FROM_ROBOT, TO_ROBOT, LinkError, Socket, Tap
from s2r_a1.ticks import AHEAD, Counters, TickFault, Ticks, TickUnit
from s2r_a1.wire import Fault, Layout, MotorPacket, Orders, Reading, WireError, pack, read_command, unpack

__all__ = ["Link", "LinkError", "LinkFault", "RobotSide", "UdpLink"]

LinkFault = Literal["silence", "gone"] | Fault | TickFault
"""Why a read gave no state: no packet, a peer that ended (in lock step), or a packet that is not valid or not new."""


class Link(Protocol):
    """The end of a connection that sends commands.

    Attributes:
        counters: counts of packets since the link was opened.
        packet: the datagram that decided the last read, unchanged; empty if none arrived.
        fault: the reason why the last read gave no state; None if it gave one.
        tap: function that receives every datagram with its direction, for instance a raw log.
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
        """A message if the robot's ticks have no known unit."""

    def read(self) -> Reading | None:
        """Return the newest state that was not returned before; None if there is none."""

    def write(self, orders: Orders | MotorPacket) -> None:
        """Send commands to the motors.

        Raises:
            WireError: a number does not fit its field; nothing is sent.
        """

    def skip(self) -> None:
        """Send nothing in this round; lock step goes on."""

    def forget(self) -> None:
        """Accept the next state as new and measure the unit again, as after the robot was switched off and on."""

    def fileno(self) -> int | None:
        """Return the descriptor for ``select``; None if only a read shows whether a state arrived."""

    def close(self) -> None:
        """Release the link's resources."""


class UdpLink:
    """A :class:`Link` over a socket, in real time or in lock step.

    Attributes:
        counters: counts of packets since the link was opened.
        packet: the datagram that decided the last read, unchanged; empty if none arrived.
        fault: the reason why the last read gave no state; None if it gave one.
        tap: function that receives every datagram with its direction, for instance a raw log.
    """

    def __init__(
        self, socket: Socket, layout: Layout, unit: TickUnit | None = None, ahead: float = AHEAD
    ) -> None:
        """Begin over an open socket; for ``unit`` and ``ahead`` see :class:`s2r_a1.ticks.Ticks`."""
        self.counters = socket.counters
        self.packet = b""
        self.fault: LinkFault | None = None
        self.tap: Tap | None = None
        self._socket = socket
        self._layout = layout
        self._ticks = Ticks(socket.counters, unit, ahead)

    @property
    def unit(self) -> TickUnit | None:
        """The unit of the robot's ticks, if it is known."""
        return self._ticks.unit

    @property
    def refusal(self) -> str | None:
        """A message if the robot's ticks have no known unit."""
        return self._ticks.refusal

    def read(self) -> Reading | None:
        """Return the newest state that was not returned before; None if there is none.

        Of several datagrams the newest valid one counts; if none is valid, ``fault`` describes the last one.
        """
        arrived = self._socket.receive()
        newest: Reading | None = None
        self.packet, self.fault = b"", "gone" if self._socket.gone else "silence"
        for data, arrival in arrived:
            if self.tap:
                self.tap(FROM_ROBOT, data)
            fault, reading = self._judge(data, arrival)
            if reading:
                newest, self.packet, self.fault = reading, data, None
            elif newest is None:
                self.packet, self.fault = data, fault
        self.counters.late += newest is None
        return newest

    def write(self, orders: Orders | MotorPacket) -> None:
        """Send commands to the motors.

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
        """Send nothing in this round; lock step goes on."""
        self._socket.skip()

    def forget(self) -> None:
        """Accept the next state as new and measure the unit again, as after the robot was switched off and on."""
        self._ticks.forget()

    def fileno(self) -> int:
        """Return the descriptor for ``select``."""
        return self._socket.fileno()

    def close(self) -> None:
        """Free the port."""
        self._socket.close()

    def _judge(self, data: bytes, arrival: float) -> tuple[LinkFault | None, Reading | None]:
        """Return (fault, reading) of a datagram that arrived at a time [s]; one of them is None."""
        try:
            reading = unpack(data, self._layout)
        except WireError as error:
            _count(self.counters, error)
            return error.fault, None
        fault = self._ticks.judge(reading.tick, arrival)
        return fault, None if fault else reading


class RobotSide:
    """The end of a connection that receives commands: the guard for its client, or a twin for the guard.

    Attributes:
        counters: counts of packets since it was opened.
        packet: the datagram that decided the last read; empty if none arrived.
        fault: the reason why the last read gave no command; None if it gave one.
        tap: function that receives every datagram with its direction.
    """

    def __init__(self, socket: Socket, layout: Layout) -> None:
        self.counters = socket.counters
        self.packet = b""
        self.fault: LinkFault | None = None
        self.tap: Tap | None = None
        self._socket = socket
        self._layout = layout

    def read(self) -> Orders | None:
        """Return the newest valid commands of this round, as orders; None if there are none."""
        command = self.receive()
        return command and command.orders()

    def receive(self) -> MotorPacket | None:
        """Return the newest valid command of this round; None if there is none."""
        newest: MotorPacket | None = None
        arrived = self._socket.receive()
        self.packet, self.fault = b"", "gone" if self._socket.gone else "silence"
        for data, _ in arrived:
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
        """Send no state in this round; lock step goes on."""
        self._socket.skip()

    def fileno(self) -> int:
        """Return the descriptor for ``select``."""
        return self._socket.fileno()

    def close(self) -> None:
        """Free the port."""
        self._socket.close()


def _count(counters: Counters, error: WireError) -> None:
    if error.fault == "number":
        counters.numbers += 1
    else:
        counters.corrupt += 1
