"""Sends and receives the datagrams of one leg of the wire, in real time or in lock step.

A leg joins two sockets: guard and robot, or worker and guard. In *real time* nothing waits: whatever has arrived is
taken at once. In *lock step* one datagram goes each way in a round of 2 ms, and a read waits for the peer's; an empty
datagram says that nothing arrives in this round. Only on this machine is lock step allowed.
"""

from __future__ import annotations

import ipaddress
import select
import socket
import time
from collections.abc import Callable
from typing import Protocol

from s2r_a1.ticks import PERIOD, Counters
from s2r_spec.errors import BackendError

LARGEST = 2048
"""A budget: bytes of the largest datagram that is read whole; the robots' have 807 at most."""
WAITING = 4096
"""A budget: datagrams taken in one read; more wait for the next one, so that a flood cannot hold up a round."""
PATIENCE = 30.0
"""A budget [s]: how long a read in lock step waits for a peer that neither sends nor ends; then it is gone."""

Address = tuple[str, int]
TO_ROBOT, FROM_ROBOT = 1, 0
"""Definitions: the direction of a packet, as the raw log has it."""


class LinkError(BackendError):
    """A robot cannot be reached from here: its address, a port, or what answers there."""


class Socket(Protocol):
    """One end of a leg.

    Attributes:
        counters: what happened since it was opened.
        gone: whether the peer is known to be no more; in real time nobody knows.
    """

    counters: Counters
    gone: bool

    @property
    def port(self) -> int:
        """The local UDP port."""

    def connect(self, peer: Address) -> None:
        """Speak with this peer only."""

    def receive(self) -> list[bytes]:
        """Return the datagrams of this round from the peer, oldest first."""

    def send(self, data: bytes) -> None:
        """Send one datagram; one that the network does not take is counted, and lost."""

    def skip(self) -> None:
        """Send nothing in this round."""

    def now(self) -> float:
        """Return the time of this round [s]."""

    def fileno(self) -> int:
        """Return what ``select`` waits for."""

    def close(self) -> None:
        """Free the port."""


class RealTimeSocket:
    """A socket that never waits."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        """Open a local port; 0 takes any that is free, and the host "" every network.

        Raises:
            LinkError: the port is not to be had.
        """
        self.counters = Counters()
        self.gone = False
        self._peer: Address | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise LinkError(
                f"the local UDP port {port} cannot be opened: {getattr(error, 'strerror', 'no such port')}; "
                "end the program that holds it, or name another port"
            ) from None
        self._socket.setblocking(False)

    @property
    def port(self) -> int:
        """The local UDP port."""
        return int(self._socket.getsockname()[1])

    def connect(self, peer: Address) -> None:
        """Speak with this peer only.

        Raises:
            LinkError: the address is none, or no network leads there.
        """
        try:
            self._socket.connect((socket.gethostbyname(peer[0]), peer[1]))
        except (OSError, UnicodeError, OverflowError) as error:  # no network, no such name, no such port
            why = getattr(error, "strerror", None) or "no such address"
            raise LinkError(f"{peer[0]}:{peer[1]} cannot be reached: {why}") from None
        self._peer = self._socket.getpeername()

    def receive(self) -> list[bytes]:
        """Return all datagrams that wait, oldest first; those from another address are counted and left out."""
        found: list[bytes] = []
        for _ in range(WAITING):
            data = self._next()
            if data is None:
                break
            found.append(data)
        return found

    def send(self, data: bytes) -> None:
        """Send one datagram; one that the network does not take is counted, and lost."""
        for _ in range(2):
            try:
                self._socket.send(data)
            except ConnectionRefusedError:  # it speaks of an earlier datagram, and this one was not sent
                continue
            except OSError:
                break
            return
        self.counters.unsent += 1

    def skip(self) -> None:
        """Send nothing: silence needs no datagram here."""

    def now(self) -> float:
        """Return the machine's monotonic time [s]."""
        return time.monotonic()

    def fileno(self) -> int:
        """Return what ``select`` waits for."""
        return self._socket.fileno()

    def close(self) -> None:
        """Free the port."""
        self._socket.close()

    def _next(self) -> bytes | None:
        """Return the oldest datagram of the peer that waits, if there is one."""
        while True:
            try:
                data, source = self._socket.recvfrom(LARGEST)
            except ConnectionRefusedError:  # nobody listened to an earlier datagram
                continue
            except OSError:  # nothing waits, or the network is down: silence either way
                return None
            # What arrived before the socket was connected may be anybody's.
            if source == self._peer:
                self.counters.received += 1
                return data
            self.counters.foreign += 1


class LockStepSocket(RealTimeSocket):
    """A socket that gives and takes one datagram a round, on this machine only.

    Attributes:
        rounds: datagrams that came from the peer.
    """

    def __init__(self, port: int = 0) -> None:
        super().__init__("127.0.0.1", port)
        self.rounds = 0

    def connect(self, peer: Address) -> None:
        """Speak with this peer only.

        Raises:
            LinkError: the peer is on another machine.
        """
        if not is_loopback(peer[0]):
            raise LinkError(f"lock step needs a peer on this machine, and {peer[0]} is another; leave it out")
        super().connect(peer)

    def receive(self) -> list[bytes]:
        """Wait for the peer's datagram of this round; return it, or nothing if it is empty or the peer is gone."""
        until = time.monotonic() + PATIENCE
        while not self.gone:
            try:
                data, source = self._socket.recvfrom(LARGEST)
            except BlockingIOError:
                self.gone = not select.select([self], [], [], max(0.0, until - time.monotonic()))[0]
            except OSError:
                self.gone = True
            else:
                if source != self._peer:
                    self.counters.foreign += 1
                    continue
                self.rounds += 1
                self.counters.received += bool(data)
                return [data] if data else []
        return []

    def send(self, data: bytes) -> None:
        """Send the datagram of this round; a peer without a port is gone."""
        try:
            self._socket.send(data)
        except OSError:
            self.counters.unsent += 1
            self.gone = True

    def skip(self) -> None:
        """Send the empty datagram that stands for silence."""
        self.send(b"")

    def now(self) -> float:
        """Return the time of the rounds so far [s]; no clock of the machine is read."""
        return self.rounds * PERIOD


def is_loopback(host: str) -> bool:
    """Return whether a host is this machine's own network; a name is looked up."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        pass
    try:
        return ipaddress.ip_address(socket.gethostbyname(host)).is_loopback
    except (OSError, UnicodeError):
        return False


def opened(peer: Address, *, lockstep: bool = False, port: int = 0) -> Socket:
    """Return a socket that is connected to a peer, from a local port; 0 takes any that is free.

    Raises:
        LinkError: the port or the peer is not to be had.
    """
    if lockstep:
        link: RealTimeSocket = LockStepSocket(port)
    else:
        link = RealTimeSocket("127.0.0.1" if is_loopback(peer[0]) else "", port)
    try:
        link.connect(peer)
    except LinkError:
        link.close()
        raise
    return link


Tap = Callable[[int, bytes], None]
"""What sees every datagram with its direction, as it came or went."""
