"""Serve the requests on a guard's control socket: at once, or later, after some rounds or when the disk is ready."""

from __future__ import annotations

import select
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from s2r_a1.datagrams import LinkError
from s2r_a1.guard.control import Listener, Party, RefusedError, Request

if TYPE_CHECKING:
    from s2r_a1.guard.loop import Guard

POLLED = 0.005
"""A budget [s]: interval between two checks of a request that waits for the disk."""


class Deferred(NamedTuple):
    """A party's request with a later reply.

    Attributes:
        poll: returns the reply, or None while it must wait; raises RefusedError.
        rounds: whether it waits for rounds (True) or for the disk (False).
    """

    party: Party
    poll: Callable[[], dict[str, Any] | None]
    rounds: bool

    def reply(self) -> dict[str, Any] | Deferred:
        """Return the reply, or this request while it must wait."""
        reply = self.poll()
        return self if reply is None else reply


Answer = Callable[["Guard", Party, Request], dict[str, Any] | Deferred]


class RequestServer:
    """Serves requests while a guard waits; ``pending`` are those with a later reply."""

    def __init__(self, guard: Guard, listener: Listener) -> None:
        self.pending: list[Deferred] = []
        self._guard, self._listener = guard, listener

    def ready(self, files: list[int], seconds: float) -> set[int]:
        """Return the descriptors that can be read, after at most this time [s]."""
        if self.pending:
            seconds = min(seconds, POLLED)
        return set(select.select([*files, *self._listener.filenos()], [], [], seconds)[0])

    def serve(self, ready: set[int]) -> None:
        """Answer new requests, and requests that waited for the disk; remove the parties that have left."""
        if ready:
            for party, request in self._listener.take(ready):
                self._reply(party, partial(self._answered, party, request))
            for party in self._listener.parties:
                party.flush()
            for party in self._listener.ended():
                self._guard.leave(party)
        if self.pending:
            self.answer_later(rounds=False)

    def answer_later(self, rounds: bool) -> None:
        """Answer requests that waited for rounds, or for the disk, if their reply is ready."""
        waiting, self.pending = self.pending, []
        for deferred in waiting:
            if deferred.rounds is not rounds:
                self.pending.append(deferred)
            elif deferred.party.open:
                self._reply(deferred.party, deferred.reply)

    def _answered(self, party: Party, request: Request | str) -> dict[str, Any] | Deferred:
        if isinstance(request, str):
            raise RefusedError(request)
        return self._guard.answer(self._guard, party, request)

    def _reply(self, party: Party, answered: Callable[[], dict[str, Any] | Deferred]) -> None:
        """Send the reply to a request, or keep the request for later."""
        try:
            reply = answered()
        except (RefusedError, LinkError) as error:
            party.send({"ok": False, "error": str(error), "state": self._guard.machine.state})
            return
        if isinstance(reply, Deferred):
            self.pending.append(reply)
        else:
            party.send({"ok": True, "state": self._guard.machine.state, **reply})
