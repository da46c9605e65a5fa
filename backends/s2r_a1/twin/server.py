"""Serve a twin on a UDP socket of this computer, in real time or in lock step.

The sender of the last valid command is the peer: states go there, and other senders are ignored until they send one. In
lock step every datagram of the peer is a round and is answered by one datagram; an empty one means no packet.
"""

from __future__ import annotations

import contextlib
import select
import signal
import socket
import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Self

from s2r_a1 import hands
from s2r_a1.datagrams import FROM_ROBOT, LARGEST, TO_ROBOT, WAITING, Address, open_port
from s2r_a1.ticks import PERIOD
from s2r_a1.twin.twin import Twin
from s2r_a1.undisturbed import undisturbed
from s2r_spec.errors import BackendError

BEHIND = 0.1
"""A tolerance [s]: delay that the twin catches up with; after a longer delay its time has stood still."""
_NANOSECONDS = round(PERIOD * 1e9)

Tap = Callable[[int, int, bytes], None]
"""Receives every datagram: time of the twin [ns], direction, bytes."""


class Server:
    """A twin and its sockets.

    ``tap`` receives every datagram in both directions, from any sender, and in lock step also empty ones.
    """

    def __init__(
        self, twin: Twin, address: Address, mocap: int | None = None, tap: Tap | None = None
    ) -> None:
        """Open the port; raise BackendError if it cannot be opened."""
        self._twin, self._mocap, self._tap = twin, mocap, tap
        self._peer: Address | None = None
        self._socket = open_port(address, BackendError, "the UDP port {}", "name another with --port")
        self._woken, self._waker = socket.socketpair()
        for end in (self._woken, self._waker):
            end.setblocking(False)
        self.port: int = self._socket.getsockname()[1]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for end in (self._socket, self._woken, self._waker):
            end.close()

    @contextlib.contextmanager
    def until_signalled(self) -> Iterator[None]:
        """Within the block, SIGTERM and SIGINT end the serving instead of the process."""
        before = {one: signal.signal(one, lambda *_: None) for one in (signal.SIGTERM, signal.SIGINT)}
        woken_before = signal.set_wakeup_fd(self._waker.fileno())
        try:
            yield
        finally:
            signal.set_wakeup_fd(woken_before)
            for one, handler in before.items():
                signal.signal(one, handler)

    def stop(self) -> None:
        """End the serving, from another thread."""
        self._waker.send(b"\0")

    def serve_in_lock_step(self) -> None:
        """Answer datagrams until a signal arrives."""
        while self._wait():
            for data in self._received(1):
                answers = self._round([data])
                if self._twin.begun:
                    # A link that drains its socket would keep the last of several.
                    self._send(answers[-1] if answers else b"")

    def serve_in_real_time(self) -> None:
        """Simulate a round every 2 ms from the first command on, until a signal arrives."""
        while not self._twin.begun:
            if not self._wait():
                return
            for data in self._round(self._received(WAITING)):
                self._send(data)
        due = time.monotonic()
        with undisturbed(first=False):
            while self._rest_until(due := max(due + PERIOD, time.monotonic() - BEHIND)):
                for data in self._round(self._received(WAITING)):
                    self._send(data)

    def _round(self, arrived: list[bytes]) -> list[bytes]:
        twin = self._twin
        answers = twin.round(arrived)
        if self._mocap:
            for line in twin.mocap():
                with contextlib.suppress(OSError):
                    self._socket.sendto(line, ("127.0.0.1", self._mocap))
        return answers

    def _rest_until(self, due: float) -> bool:
        """Wait until a time; return False if a signal arrived."""
        return not select.select([self._woken], [], [], max(0.0, due - time.monotonic()))[0]

    def _wait(self) -> bool:
        """Wait for a datagram; return False if a signal arrived."""
        return self._woken not in select.select([self._socket, self._woken], [], [])[0]

    def _received(self, most: int) -> list[bytes]:
        """Return the waiting datagrams of the peer, or of a sender that becomes the peer by a valid command."""
        received = []
        for _ in range(most):
            try:
                data, source = self._socket.recvfrom(LARGEST)
            except OSError:  # nothing waits
                break
            if (place := hands.read(data)) is not None:
                self._twin.put(*place)
                with contextlib.suppress(OSError):
                    self._socket.sendto(data, source)
                continue
            self._note(TO_ROBOT, data)
            if source != self._peer and self._twin.accepts(data):
                self._peer = source
            if source == self._peer or self._peer is None:
                received.append(data)
        return received

    def _send(self, data: bytes) -> None:
        assert self._peer
        self._note(FROM_ROBOT, data)
        with contextlib.suppress(OSError):  # a full network loses packets
            self._socket.sendto(data, self._peer)

    def _note(self, direction: int, data: bytes) -> None:
        if self._tap:
            self._tap(self._twin.rounds * _NANOSECONDS, direction, data)
