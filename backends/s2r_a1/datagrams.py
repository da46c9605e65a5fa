"""Send and receive the datagrams of one connection, in real time or in lock step.

A connection joins two sockets: guard and robot, or worker and guard. In *real time* a read returns at once with the
datagrams that have arrived. In *lock step* one datagram goes each way per round of 2 ms, and a read waits for the
peer's; an empty datagram means that nothing arrives in this round. Lock step is allowed only on this computer.
"""

from __future__ import annotations

import ipaddress
import select
import socket
import time
from collections.abc import Callable
from itertools import islice

from s2r_a1.ticks import PERIOD, Counters
from s2r_spec.errors import BackendError

LARGEST = 2048
"""A budget: bytes of the largest datagram that is read whole; a robot's have at most 807."""
WAITING = 4096
"""A budget: datagrams of one read; more wait for the next read, so that a flood cannot delay a round."""
PATIENCE = 30.0
"""A budget [s]: time that a read in lock step waits for a silent peer, which then counts as gone."""

Address = tuple[str, int]
TO_ROBOT, FROM_ROBOT = 1, 0
"""Definitions: the direction of a packet, as in the raw log."""


class LinkError(BackendError):
    """A robot cannot be reached: its address, a port or the answer is wrong."""


def open_port(
    address: Address,
    error: type[BackendError],
    which: str = "the local UDP port {}",
    remedy: str = "name another port",
) -> socket.socket:
    """Return a UDP socket with this local address, which never waits; raise the error if it cannot be opened."""
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.setblocking(False)
    try:
        opened.bind(address)
    except (OSError, OverflowError) as refused:
        opened.close()
        why = getattr(refused, "strerror", "no such port")
        raise error(
            f"{which.format(address[1])} cannot be opened: {why}; end the program that uses it, or {remedy}"
        ) from None
    return opened


class RealTimeSocket:
    """One end of a connection, which never waits.

    Attributes:
        counters: counts of packets since it was opened.
        gone: whether the peer has ended; always False in real time, where it cannot be known.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        """Open a local port, any free one (0), on every network with host ""; raise LinkError if it is in use."""
        self.counters = Counters()
        self.gone = False
        self._peer: Address | None = None
        self._socket = open_port((host, port), LinkError)

    @property
    def port(self) -> int:
        """The local UDP port."""
        return int(self._socket.getsockname()[1])

    def connect(self, peer: Address) -> None:
        """Connect only to this peer; raise LinkError if no network leads to it."""
        try:
            self._socket.connect((socket.gethostbyname(peer[0]), peer[1]))
        except (OSError, UnicodeError, OverflowError) as error:  # no network, no such name, no such port
            why = getattr(error, "strerror", None) or "no such address"
            raise LinkError(
                f"{peer[0]}:{peer[1]} cannot be reached: {why}; check address and network"
            ) from None
        self._peer = self._socket.getpeername()

    def receive(self) -> list[bytes]:
        """Return all waiting datagrams, oldest first; datagrams from another address are counted and left out."""
        return list(islice(iter(self._next, None), WAITING))

    def send(self, data: bytes) -> None:
        """Send one datagram; a datagram that the network refuses is counted and lost."""
        for _ in range(2):
            try:
                self._socket.send(data)
            except ConnectionRefusedError:  # about an earlier datagram; this one was not sent
                continue
            except OSError:
                break
            return
        self.counters.unsent += 1

    def skip(self) -> None:
        """Send nothing: in real time silence needs no datagram."""

    def now(self) -> float:
        """Return this computer's monotonic time [s]."""
        return time.monotonic()

    def fileno(self) -> int:
        """Return the descriptor for ``select``."""
        return self._socket.fileno()

    def close(self) -> None:
        """Release the port."""
        self._socket.close()

    def _next(self) -> bytes | None:
        while True:
            try:
                data, source = self._socket.recvfrom(LARGEST)
            except ConnectionRefusedError:  # nobody listened to an earlier datagram
                continue
            except OSError:  # nothing waits, or the network is down: silence in both cases
                return None
            # A datagram from before the connection may come from anybody.
            if source == self._peer:
                self.counters.received += 1
                return data
            self.counters.foreign += 1


class LockStepSocket(RealTimeSocket):
    """A socket that exchanges one datagram per round, only on this computer; ``rounds`` counts those of the peer."""

    def __init__(self, port: int = 0) -> None:
        super().__init__("127.0.0.1", port)
        self.rounds = 0

    def connect(self, peer: Address) -> None:
        """Connect only to this peer; raise LinkError if no network leads to it."""
        if not is_loopback(peer[0]):
            raise LinkError(
                f"lock step needs a peer on this computer, and {peer[0]} is another; leave out lockstep"
            )
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
        """Return the time of the rounds so far [s]; it reads no clock."""
        return self.rounds * PERIOD


def is_loopback(host: str) -> bool:
    """Return whether a host is this computer itself; a name is looked up."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        pass
    try:
        return ipaddress.ip_address(socket.gethostbyname(host)).is_loopback
    except (OSError, UnicodeError):
        return False


def is_free(address: Address) -> bool:
    """Return whether no process of this computer uses a UDP port.

    This is the only sign of a process that was killed after it received a datagram.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(address)
        except OSError:
            return False
    return True


def open_socket(peer: Address, *, lockstep: bool = False, port: int = 0) -> RealTimeSocket:
    """Return a socket that is connected to a peer, from a local port or any (0); raise LinkError if it cannot be."""
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
"""Receives every datagram with its direction, unchanged."""
