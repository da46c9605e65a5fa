"""The worker's two connections to the guard: requests over its control socket, packets over the robot's own wire.

The control socket is a Unix stream of JSON objects, one a line. Every request has one reply; between replies the
guard tells of each change of its state, before it forwards the robot's packet of that round.
"""

from __future__ import annotations

import json
import os
import select
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from s2r_a1.datagrams import LinkError, LockStepSocket, RealTimeSocket
from s2r_a1.link import UdpLink
from s2r_a1.ticks import PERIOD, TickUnit
from s2r_a1.walk import GONE, Change
from s2r_a1.wire import LAYOUTS, Orders, Reading
from s2r_spec.errors import BackendError

PATIENCE = 30.0
"""A budget [s]: how long a reply of the guard may take. Twice as much waits longer for one that is stuck."""
WAIT = 2.0 * PERIOD
"""A budget [s]: how long a round waits for a state in real time, before the last orders go out again. The guard bridges
10 ms; from there on twice as much would be taken for silence."""


class GuardError(BackendError):
    """The guard refused a request, or is gone."""


class Control:
    """The control connection.

    Attributes:
        change: the newest state of the guard that was heard of.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Connect to the guard that listens at a path.

        Raises:
            GuardError: none does.
        """
        self.change = Change("OFF")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._received = b""
        try:
            self._socket.connect(os.fspath(path))
        except OSError:
            self._socket.close()
            raise GuardError(
                f"no guard of the robot is running (none listens at {os.fspath(path)}); it is started by the command"
                " that holds the terminal: s2r certify, gap or check"
            ) from None

    def request(self, do: str, **fields: Any) -> dict[str, Any]:
        """Send a request, and return the reply to it.

        Raises:
            GuardError: the guard refuses, is gone, or does not answer.
        """
        try:
            self._socket.sendall(json.dumps({"do": do, **fields}).encode() + b"\n")
        except OSError:
            self._end()
        while True:
            message = self._message(PATIENCE)
            if message is None:
                raise GuardError(
                    self.change.reason or f"the guard of the robot did not answer {do!r} within {PATIENCE:g} s"
                )
            if "ok" not in message:
                self._note(message)
                continue
            if not message["ok"]:
                raise GuardError(str(message.get("error") or f"the guard of the robot refuses to {do}"))
            if state := message.get("state"):
                self.change = self.change if state == self.change.state else Change(state)
            return message

    def listen(self, seconds: float = 0.0) -> Change:
        """Take in what the guard has told, waiting so long for it, and return its newest state."""
        while (message := self._message(seconds)) is not None:
            self._note(message)
            seconds = 0.0
        return self.change

    def fileno(self) -> int:
        """Return what ``select`` waits for."""
        return self._socket.fileno()

    def close(self) -> None:
        """Leave. In a state in which the robot stands or walks, that is a fault to the guard."""
        self._socket.close()

    def _note(self, message: Mapping[str, Any]) -> None:
        if message.get("event") == "state":
            words = (message.get(name) or "" for name in ("word", "reason"))
            self.change = Change(str(message["state"]), *map(str, words))

    def _message(self, seconds: float) -> dict[str, Any] | None:
        """Return the next line of the guard, or None if none comes in so many seconds, or ever again."""
        while b"\n" not in self._received:
            if self.change.state == GONE or not select.select([self._socket], [], [], seconds)[0]:
                return None
            try:
                data = self._socket.recv(65536)
            except OSError:
                data = b""
            if not data:
                self._end()
            self._received += data
        line, _, self._received = self._received.partition(b"\n")
        message = json.loads(line)
        if not isinstance(message, dict):
            raise GuardError("the guard of the robot speaks another language; install the same s2r for both")
        return message

    def _end(self) -> None:
        self.change = Change(GONE, "link", "the guard of the robot has ended; nothing holds the robot now")


class Client:
    """A :class:`~s2r_a1.walk.Line` over the guard's control socket and its UDP port.

    Attributes:
        unit: of the robot's clock.
        control: the control connection.
    """

    def __init__(self, path: str | os.PathLike[str], lockstep: bool) -> None:
        """Attach to the guard whose control socket is at a path.

        Raises:
            GuardError: there is none, it has a client, or it runs by another clock.
        """
        self.control = Control(path)
        self._socket = LockStepSocket() if lockstep else RealTimeSocket()
        try:
            self._hello(lockstep)
        except (BackendError, LinkError):
            self.close()
            raise

    def _hello(self, lockstep: bool) -> None:
        hello = self.control.request("hello", role="client", port=self._socket.port, pid=os.getpid())
        if (hello["clock"] == "lockstep") != lockstep:
            raise GuardError(
                f"the guard of the robot runs by the clock {hello['clock']!r}: say clock={hello['clock']}, or end it"
                " with python -m s2r_a1.guard stop"
            )
        if hello.get("tick_unit") is None:
            raise GuardError("the guard of the robot has not measured the robot's clock yet; connect it first")
        self.unit: TickUnit = hello["tick_unit"]
        self._lockstep = lockstep
        self._socket.connect(("127.0.0.1", int(hello["port"])))
        self.link = UdpLink(self._socket, LAYOUTS[hello["layout"].lower()], self.unit)

    @property
    def change(self) -> Change:
        """The newest state of the guard."""
        return self.control.change

    def receive(self) -> Reading | None:
        """Return the state of this round; None where none came that can be used."""
        if self._lockstep:
            self._wait()
        else:
            select.select([self.link], [], [], WAIT)
        self.control.listen()
        return None if self.change.state == GONE else self.link.read()

    def _wait(self) -> None:
        """Wait for the guard's datagram, or for its end, of which a datagram socket does not tell."""
        while self.change.state != GONE:
            ready, _, _ = select.select([self.link, self.control], [], [], PATIENCE)
            if not ready:
                raise GuardError(f"the guard of the robot did nothing for {PATIENCE:g} s; look what holds it")
            if self.link in ready:
                return
            self.control.listen()

    def send(self, orders: Orders | None) -> None:
        """Send the orders of this round, or none."""
        if orders is None:
            self.link.skip()
        else:
            self.link.write(orders)

    def request(self, do: str, **fields: Any) -> Mapping[str, Any]:
        """Ask the guard for something, and return its reply.

        Raises:
            GuardError: it refuses; the sentence says why.
        """
        return self.control.request(do, **fields)

    def record(self, path: Path, header: Mapping[str, Any]) -> None:
        """Have the guard record every packet to a file, which must not exist.

        Raises:
            GuardError: it cannot.
        """
        self.request("record", path=str(path.resolve()), header=dict(header))

    def close(self) -> None:
        """Leave the guard."""
        self.control.close()
        self._socket.close()
