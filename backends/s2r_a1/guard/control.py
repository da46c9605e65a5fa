"""Speaks with a guard over its control socket: one JSON object a line, one reply for each request.

Requests are ``{"do": NAME, …}``; the reply is ``{"ok": true, "state": "STAND", …}`` or
``{"ok": false, "error": "one sentence", "state": …}``. Between them events come without being asked for:

    {"event": "state", "state": "DAMPING", "word": "fall", "reason": "the base is tilted by 0.52 rad …", "round": 4711}
    {"event": "wanted", "state": "STAND" or "RESTING", "word": "operator", "reason": …, "round": …}
    {"event": "warning", "reason": …, "round": …}

``word`` is one of the words of :mod:`s2r_a1.guard.limits`, or null where nothing is wrong. ``wanted`` asks a client
to come to a stop and to request ``halt``; after ``RAMP`` the guard halts by itself. An event leaves before the state
packet of the round after it is passed on.

Requests, and who may make them:

    hello {role: "client" | "operator", port: the client's UDP port, pid}    anybody, first
        → layout, clock, port: the guard's UDP port for this client, tick_unit
    status, halt, lie, damp {reason}, stop                                   anybody
    stand, walk: only while an operator is attached                              the client
    record {path, header}, stop_recording → path, packets, bytes                 the client
    leave: a robot that stands is held by the guard, until another client comes   the client
    connect, arm, reset                                                      an operator

``connect``, ``arm`` and ``reset`` are answered once their conditions are met, or refused after about two seconds.
A client that was attached when the robot was damped must connect anew before it may stand or walk again: so a
program that was stopped and wakes later cannot move the robot.
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
    **dict.fromkeys(("stand", "walk", "record", "stop_recording", "leave"), frozenset({"client"})),
    **dict.fromkeys(("connect", "arm", "reset"), frozenset({"operator"})),
}
"""A definition: who may make which request; None is a connection that has not said hello."""

LONGEST = 65536
"""A budget: bytes of a request, and of what waits to be read by a party; a party beyond it is closed."""
MANY = 16
"""A budget: requests of a party in one read; one that sends more without waiting for replies is closed. Answering takes
0.1 ms each, and may not hold up a round."""
PARTIES = 32
"""A budget: connections at a time; more are closed at once. ``select`` takes descriptors up to 1023."""
PATIENCE = 30.0
"""A budget [s]: how long a reply may take; ``connect`` takes up to five, and more on a busy machine."""


class ControlError(BackendError):
    """The guard does not answer any more."""


class RefusedError(BackendError):
    """The guard refused a request; the sentence says why."""


class Connection:
    """A party's end of the control socket; for one thread.

    Attributes:
        events: those that came and were not taken yet, oldest first.
    """

    def __init__(self, path: Path) -> None:
        """Connect to the guard that listens at a path.

        Raises:
            ControlError: none does.
        """
        self.events: deque[dict[str, Any]] = deque()
        self._buffer = b""
        self._replies: deque[dict[str, Any]] = deque()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.connect(str(path))
        except OSError as error:
            self._socket.close()
            raise ControlError(f"no guard listens at {path}: {error.strerror}") from None
        self._socket.setblocking(False)

    def request(self, do: str, /, **fields: Any) -> dict[str, Any]:
        """Make a request and return its reply.

        Raises:
            RefusedError: the guard refused it.
            ControlError: the guard ended, or does not answer.
        """
        self._send(json.dumps({"do": do, **fields}).encode() + b"\n")
        end = time.monotonic() + PATIENCE
        while not self._replies:
            left = end - time.monotonic()
            if left <= 0 or not select.select([self], [], [], left)[0]:
                raise ControlError(
                    f"the guard has not answered {do!r} for {PATIENCE:g} s; end it and start anew"
                )
            try:
                self._receive()
            except ControlError:
                if not self._replies:  # the last reply may come with the end
                    raise
        reply = self._replies.popleft()
        if not reply["ok"]:
            raise RefusedError(reply["error"])
        return reply

    def take(self) -> Iterator[dict[str, Any]]:
        """Yield the events that have come, oldest first, without waiting.

        Raises:
            ControlError: the guard ended; only after the last event.
        """
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
        """Return what ``select`` waits for."""
        return self._socket.fileno()

    def close(self) -> None:
        """Leave the guard; where a client does so while the robot stands or walks, the robot is damped."""
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
        """Take in what has come."""
        while True:
            try:
                data = self._socket.recv(LONGEST)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                raise ControlError("the guard has ended")
            *lines, self._buffer = (self._buffer + data).split(b"\n")
            for line in lines:
                message = json.loads(line)
                (self._replies if "ok" in message else self.events).append(message)


class Request(NamedTuple):
    """What a party asks for: the name of the request, and all its fields."""

    do: str
    fields: dict[str, Any]


class Party:
    """A connection as the guard sees it.

    Attributes:
        role: as its hello said; None before.
        pid: of its process, as its hello said.
        spent: whether it was the client when the robot was damped.
        open: whether it can still be written to.
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
        """Return the whole requests that have come, a sentence instead of one that cannot be read."""
        try:
            data = self._socket.recv(LONGEST)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        self.open = self.open and bool(data)
        *lines, self._in = (self._in + data).split(b"\n")
        if len(self._in) > LONGEST or len(lines) > MANY:
            self.open = False
        return [_request(line) for line in lines[:MANY]]

    def send(self, message: dict[str, Any]) -> None:
        """Send a message as far as the party takes it; never wait. One that reads nothing for long is closed."""
        self._out += json.dumps(message).encode() + b"\n"
        self.flush()

    def flush(self) -> None:
        """Send what waits."""
        try:
            while self._out:
                self._out = self._out[self._socket.send(self._out) :]
        except BlockingIOError:
            if len(self._out) > LONGEST:
                self.open = False
        except OSError:
            self.open = False

    def fileno(self) -> int:
        """Return what ``select`` waits for."""
        return self._socket.fileno()

    def close(self) -> None:
        """End the connection."""
        self.open = False
        self._socket.close()


def _request(line: bytes) -> Request | str:
    """Return the request that a line holds, or a sentence."""
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        message = None
    if not isinstance(message, dict) or not isinstance(message.get("do"), str):
        return 'a request is one JSON object on a line, with "do" and its fields'
    if message["do"] not in ROLES:
        return f"there is no request {message['do'][:40]!r}; name one of {', '.join(sorted(ROLES))}"
    return Request(message.pop("do"), message)


def _listening(path: Path) -> socket.socket:
    """Return a socket that listens at a path; whatever lies there is replaced."""
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
    """The guard's end of the control socket.

    Attributes:
        parties: all connections that are open.
    """

    def __init__(self, path: Path) -> None:
        """Listen at a path; whatever lies there is replaced, since the caller holds the robot's lock."""
        self.parties: list[Party] = []
        self._path = path
        self._socket = _listening(path)

    def renew(self) -> None:
        """Listen anew if somebody has taken the socket's file away: a guard must stay within reach."""
        if self._path.exists():
            return
        with contextlib.suppress(OSError):  # its folder is away, too; connections that are open go on
            fresh = _listening(self._path)
            self._socket.close()
            self._socket = fresh

    def fileno(self) -> int:
        """Return what ``select`` waits for."""
        return self._socket.fileno()

    def filenos(self) -> list[int]:
        """Return the descriptors of the listener and of all parties."""
        return [self.fileno(), *(party.fileno() for party in self.parties)]

    def take(self, ready: set[int]) -> list[tuple[Party, Request | str]]:
        """Return the requests of those whose descriptor is ready; a new connection is taken in.

        Parties whose connection has ended stay in ``parties``, not ``open``, until :meth:`ended` returns them.
        """
        found: list[tuple[Party, Request | str]] = []
        if self.fileno() in ready:
            with contextlib.suppress(OSError):
                connection = self._socket.accept()[0]
                if len(self.parties) < PARTIES:
                    self.parties.append(Party(connection))
                else:
                    connection.close()
        for party in self.parties:
            if party.fileno() in ready:
                found += [(party, request) for request in party.requests()]
        return found

    def ended(self) -> list[Party]:
        """Return the parties whose connection has ended, closed and taken out."""
        ended = [party for party in self.parties if not party.open]
        if ended:
            self.parties = [party for party in self.parties if party.open]
            for party in ended:
                party.close()
        return ended

    def publish(self, event: dict[str, Any]) -> None:
        """Send an event to every party that has said hello."""
        for party in self.parties:
            if party.role is not None:
                party.send(event)

    def close(self) -> None:
        """Close all connections, and take the socket's file away."""
        for party in self.parties:
            party.close()
        self._socket.close()
        with contextlib.suppress(OSError):
            os.unlink(self._path)
