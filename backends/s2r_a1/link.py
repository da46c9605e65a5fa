"""Read states and write commands over one connection; only this module and the ones below use sockets.

Both connections use the same wire protocol: guard and robot, worker and guard. The sender of commands has a
:class:`Link`, and the receiver a :class:`RobotSide`. The socket below decides between real time and lock step
(:mod:`s2r_a1.datagrams`).

    link = UdpLink(open_socket(("127.0.0.1", 8007)), A1)
    link.write(orders)
    reading = link.read()       # None: no new state in this round; see link.fault and link.packet
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Literal, TypeVar

from s2r_a1.datagrams import FROM_ROBOT, TO_ROBOT, RealTimeSocket, Tap
from s2r_a1.ticks import Counters, TickFault, Ticks, TickUnit
from s2r_a1.wire import Fault, Layout, MotorPacket, Orders, Reading, WireError, pack, read_command, unpack

LinkFault = Literal["silence", "gone"] | Fault | TickFault
"""Why a read gave no state: no packet, a peer that ended (in lock step), or a packet that is not valid or not new."""
Content = TypeVar("Content")


class Link(ABC):
    """The end of a connection that sends commands.

    Attributes:
        counters: counts of packets since the link was opened.
        packet: the datagram that decided the last read, unchanged; empty if none arrived.
        fault: the reason why the last read gave no state; None if it gave one.
        tap: function that receives every datagram with its direction, for instance a raw log.
    """

    def __init__(self, layout: Layout, counters: Counters, unit: TickUnit | None = None) -> None:
        self.counters = counters
        self.packet = b""
        self.fault: LinkFault | None = None
        self.tap: Tap | None = None
        self._layout = layout
        self._ticks = Ticks(counters, unit)

    @property
    def unit(self) -> TickUnit | None:
        """The unit of the robot's ticks; None until it is measured, half a second after the first state."""
        return self._ticks.unit

    @property
    def refusal(self) -> str | None:
        """A message if the robot's ticks have no known unit."""
        return self._ticks.refusal

    @abstractmethod
    def read(self) -> Reading | None:
        """Return the newest state that was not returned before; None if there is none."""

    @abstractmethod
    def write(self, orders: Orders | MotorPacket) -> None:
        """Send commands to the motors; raise WireError if a number does not fit its field."""

    @abstractmethod
    def skip(self) -> None:
        """Send nothing in this round; lock step goes on."""

    def forget(self) -> None:
        """Accept the next state as new and measure the unit again, as after the robot was switched off and on."""
        self._ticks.forget()

    @abstractmethod
    def fileno(self) -> int | None:
        """Return the descriptor for ``select``; None if only a read shows whether a state arrived."""

    @abstractmethod
    def close(self) -> None:
        """Release the link's resources."""


class _SocketEnd:
    """An end of a connection over a socket."""

    counters: Counters
    packet: bytes
    fault: LinkFault | None
    _socket: RealTimeSocket

    def skip(self) -> None:
        """Send nothing in this round; lock step goes on."""
        self._socket.skip()

    def fileno(self) -> int:
        """Return the descriptor for ``select``."""
        return self._socket.fileno()

    def close(self) -> None:
        """Release the port."""
        self._socket.close()

    def _newest(
        self, judge: Callable[[bytes], tuple[Content, LinkFault | None]], tap: Tap | None = None
    ) -> Content | None:
        """Return the newest valid content of this round's datagrams; count the others by their fault.

        ``judge`` returns a datagram's content and its fault, or raises WireError.
        """
        newest: Content | None = None
        arrived = self._socket.receive()
        self.packet, self.fault = b"", "gone" if self._socket.gone else "silence"
        for data in arrived:
            if tap:
                tap(FROM_ROBOT, data)
            fault: LinkFault | None
            try:
                content, fault = judge(data)
            except WireError as error:
                fault = error.fault
                if fault == "number":
                    self.counters.numbers += 1
                else:
                    self.counters.corrupt += 1
            if fault is None:
                newest, self.packet, self.fault = content, data, None
            elif newest is None:
                self.packet, self.fault = data, fault
        self.counters.late += newest is None
        return newest


class UdpLink(_SocketEnd, Link):
    """A link over a socket, in real time or in lock step.

    Of several datagrams in a read the newest valid one counts; if none is valid, ``fault`` describes the last one.
    """

    def __init__(self, socket: RealTimeSocket, layout: Layout, unit: TickUnit | None = None) -> None:
        super().__init__(layout, socket.counters, unit)
        self._socket = socket

    def read(self) -> Reading | None:
        """Return the newest state that was not returned before; None if there is none."""
        return self._newest(self._judge, self.tap)

    def write(self, orders: Orders | MotorPacket) -> None:
        """Send commands to the motors; raise WireError if a number does not fit its field."""
        self.send(pack(orders, self._layout))

    def send(self, data: bytes) -> None:
        """Send a command that is packed already."""
        self._socket.send(data)
        if self.tap:
            self.tap(TO_ROBOT, data)

    def _judge(self, data: bytes) -> tuple[Reading, LinkFault | None]:
        reading = unpack(data, self._layout)
        return reading, self._ticks.judge(reading.tick, self._socket.now())


class RobotSide(_SocketEnd):
    """The end of a connection that receives commands: the guard for its client, or a test's robot for the guard.

    ``counters``, ``packet`` and ``fault`` are as in :class:`Link`, but of commands.
    """

    def __init__(self, socket: RealTimeSocket, layout: Layout) -> None:
        self.counters = socket.counters
        self.packet, self.fault = b"", None
        self._socket, self._layout = socket, layout

    def read(self) -> Orders | None:
        """Return the newest valid commands of this round, as orders; None if there are none."""
        command = self.receive()
        return command and command.orders()

    def receive(self) -> MotorPacket | None:
        """Return the newest valid command of this round; None if there is none."""
        return self._newest(lambda data: (read_command(data, self._layout), None))

    def send(self, data: bytes) -> None:
        """Send a state that is packed already, unchanged."""
        self._socket.send(data)
