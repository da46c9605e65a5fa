"""The control socket of a guard: one JSON object per line, one reply per request.

Requests are ``{"do": NAME, …}``; the reply is ``{"ok": true, "state": "STAND", …}`` or
``{"ok": false, "error": "one sentence", "state": …}``. Events arrive between them:

    {"event": "state", "state": "DAMPING", "word": "fall", "reason": "the base is tilted by 0.52 rad …", "round": 4711}
    {"event": "wanted", "state": "STAND" or "RESTING", "word": "operator", "reason": …, "round": …}
    {"event": "warning", "reason": …, "round": …}

``word`` is one of the words of :mod:`s2r_a1.guard.limits`, or null if nothing is wrong. ``wanted`` tells a client to
stop and to request ``halt``; after ``RAMP`` the guard halts by itself. An event is sent before the state packet of the
next round.

Requests, and who may make them:

    hello {role: "client" | "operator", port: the client's UDP port, pid}    anybody, first
        → layout, clock, port: the guard's UDP port for this client, tick_unit
    status, halt, lie, damp {reason}, stop                                   anybody
    stand, walk, excite, excite_held: only while an operator is attached         the client
    record {path, header}, stop_recording → path, packets, bytes                 the client
    leave: a robot that stands is held by the guard, until another client comes   the client
    connect, arm, reset                                                      an operator

``connect``, ``arm`` and ``reset`` are answered when their conditions are met, or refused after about two seconds. A
client that was attached when the robot was damped must connect again before the robot may stand or walk, so that a
stopped program that continues later cannot move the robot.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, NamedTuple

from s2r_spec.errors import BackendError

Role = Literal["client", "operator"]
ROLES: dict[str, frozenset[Role | None]] = {
    **dict.fromkeys(
        ("hello", "status", "halt", "lie", "damp", "stop"), frozenset({None, "client", "operator"})
    ),
    **dict.fromkeys(
        ("stand", "walk", "excite", "excite_held", "record", "stop_recording", "leave"), frozenset({"client"})
    ),
    **dict.fromkeys(("connect", "arm", "reset"), frozenset({"operator"})),
}
"""A definition: request → roles that may make it; None is a connection before its hello."""

LONGEST = 65536
"""A budget: bytes of a request, and of unread replies of a party; a party beyond it is closed."""
MANY = 16
"""A budget: requests of a party in one read; a party that sends more without waiting for replies is closed. An answer
takes 0.1 ms, and must not delay a round."""
PARTIES = 32
"""A budget: simultaneous connections; further ones are closed at once. ``select`` accepts descriptors up to 1023."""
PATIENCE = 30.0
"""A budget [s]: time for a reply; ``connect`` takes up to five seconds, and more on a busy machine."""


class ControlError(BackendError):
    """The guard no longer answers."""


class RefusedError(BackendError):
    """The guard refused a request; the message says why."""


class Connection:
    """A party's end of the control socket, for one thread; ``events`` holds those that were not taken yet."""

    def __init__(self, path: Path) -> None:
        """Connect to the guard that listens at a path; raise ControlError if none does."""
        self.events: deque[dict[str, Any]] = deque()
        self._buffer = b""
        self._replies: deque[dict[str, Any]] = deque()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.connect(str(path))
        except OSError as error:
            self._socket.close()
            raise ControlError(
                f"no guard listens at {path}: {error.strerror}; start one with s2r check, gap or certify"
            ) from None
        self._socket.setblocking(False)

    def request(self, do: str, /, **fields: Any) -> dict[str, Any]:
        """Make a request and return its reply; raise RefusedError, or ControlError if the guard does not answer."""
        self._send(json.dumps({"do": do, **fields}).encode() + b"\n")
        end = time.monotonic() + PATIENCE
        while not self._replies:
            left = end - time.monotonic()
            if left <= 0 or not select.select([self], [], [], left)[0]:
                raise ControlError(
                    f"the guard has not answered {do!r} for {PATIENCE:g} s; end it, and run the command again"
                )
            try:
                self._receive()
            except ControlError:
                if not self._replies:  # the last reply may arrive together with the end
                    raise
        reply = self._replies.popleft()
        if not reply["ok"]:
            raise RefusedError(reply["error"])
        return reply

    def take(self) -> Iterator[dict[str, Any]]:
        """Yield the received events, oldest first, without waiting; then raise ControlError if the guard ended."""
        ended = None
        try:
            self._receive()
        except ControlError as error:
            ended = error
        while self.events:
            yield self.events.popleft()
        if ended:
            raise ended

    def fileno(self) -> int:
        """Return the descriptor for ``select``."""
        return self._socket.fileno()

    def close(self) -> None:
        """Disconnect; if a client does so while the robot stands or walks, the robot is damped."""
        self._socket.close()

    def _send(self, data: bytes) -> None:
        try:
            while data:
                with contextlib.suppress(BlockingIOError):
                    data = data[self._socket.send(data) :]
                if data:
                    select.select([], [self], [], PATIENCE)
        except OSError:
            raise ControlError("the guard has ended") from None

    def _receive(self) -> None:
        """Read all received data; raise ControlError if the guard ended."""
        while (data := _receive(self._socket)) is not None:
            if not data:
                raise ControlError("the guard has ended")
            *lines, self._buffer = (self._buffer + data).split(b"\n")
            for line in lines:
                message = json.loads(line)
                (self._replies if "ok" in message else self.events).append(message)


def _receive(connection: socket.socket) -> bytes | None:
    """Return received data; None if nothing waits, and nothing (b"") if the other end is gone."""
    try:
        return connection.recv(LONGEST)
    except BlockingIOError:
        return None
    except OSError:
        return b""


class Request(NamedTuple):
    """A request: its name, and its other fields."""

    do: str
    fields: dict[str, Any]


class Party:
    """The guard's end of a connection, which is ``open`` while it can be written to; role and pid come from its hello.

    ``spent`` tells whether it was the client when the robot was damped.
    """

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        self.role: Role | None = None
        self.pid: int | None = None
        self.spent = False
        self.open = True
        self._socket = connection
        self._in = b""
        self._out = b""

    def requests(self) -> list[Request | str]:
        """Return the received requests; a message in place of each request that cannot be read."""
        data = _receive(self._socket)
        if data is None:
            return []
        self.open = self.open and bool(data)
        *lines, self._in = (self._in + data).split(b"\n")
        if len(self._in) > LONGEST or len(lines) > MANY:
            self.open = False
        return [_request(line) for line in lines[:MANY]]

    def send(self, message: dict[str, Any]) -> None:
        """Send a message without waiting; a party with too much unread data is closed."""
        self._out += json.dumps(message).encode() + b"\n"
        self.flush()

    def flush(self) -> None:
        """Send waiting data."""
        try:
            while self._out:
                self._out = self._out[self._socket.send(self._out) :]
        except BlockingIOError:
            if len(self._out) > LONGEST:
                self.open = False
        except OSError:
            self.open = False

    def fileno(self) -> int:
        """Return the descriptor for ``select``."""
        return self._socket.fileno()

    def close(self) -> None:
        """End the connection."""
        self.open = False
        self._socket.close()


def _request(line: bytes) -> Request | str:
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        message = None
    if not isinstance(message, dict) or not isinstance(message.get("do"), str):
        return 'a request must be one JSON object on a line, with "do" and its fields'
    if message["do"] not in ROLES:
        return f"there is no request {message['do'][:40]!r}; use one of {', '.join(sorted(ROLES))}"
    return Request(message.pop("do"), message)


def _listen(path: Path) -> socket.socket:
    path.unlink(missing_ok=True)
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listening.bind(str(path))
        path.chmod(0o600)
        listening.listen(16)
        listening.setblocking(False)
    except OSError:
        listening.close()
        raise
    return listening


class Listener:
    """The guard's end of the control socket; ``parties`` are all open connections."""

    def __init__(self, path: Path) -> None:
        """Listen at a path; an existing file is replaced, because the caller holds the robot's lock."""
        self.parties: list[Party] = []
        self._path = path
        self._socket = _listen(path)

    def renew(self) -> None:
        """Listen again if the socket's file was deleted, so that the guard can be reached."""
        if self._path.exists():
            return
        with contextlib.suppress(OSError):  # the folder was deleted, too; open connections go on
            fresh = _listen(self._path)
            self._socket.close()
            self._socket = fresh

    def fileno(self) -> int:
        """Return the descriptor for ``select``."""
        return self._socket.fileno()

    def filenos(self) -> list[int]:
        """Return the descriptors of the listener and of all parties."""
        return [self.fileno(), *(party.fileno() for party in self.parties)]

    def take(self, ready: set[int]) -> list[tuple[Party, Request | str]]:
        """Return the requests of the parties whose descriptor is ready; accept a new connection.

        A party whose connection has ended stays in ``parties``, not ``open``, until :meth:`ended` returns it.
        """
        if self.fileno() in ready:
            with contextlib.suppress(OSError):
                connection = self._socket.accept()[0]
                if len(self.parties) < PARTIES:
                    self.parties.append(Party(connection))
                else:
                    connection.close()
        asking = [party for party in self.parties if party.fileno() in ready]
        return [(party, request) for party in asking for request in party.requests()]

    def ended(self) -> list[Party]:
        """Close and remove the parties whose connection has ended, and return them."""
        ended = [party for party in self.parties if not party.open]
        if ended:
            self.parties = [party for party in self.parties if party.open]
            for party in ended:
                party.close()
        return ended

    def publish(self, event: dict[str, Any]) -> None:
        """Send an event to every party with a role."""
        for party in self.parties:
            if party.role is not None:
                party.send(event)

    def close(self) -> None:
        """Close all connections, and remove the socket's file."""
        for party in self.parties:
            party.close()
        self._socket.close()
        with contextlib.suppress(OSError):
            os.unlink(self._path)
