"""Turns the rounds of a guard: what came in, a step of the state machine, what goes out.

In real time a round begins every 2 ms by the machine's monotonic clock. States are passed on to the client as they
come; its newest orders are taken when the round begins, and the command leaves at once.

In lock step nobody looks at a clock. A round sends the command, waits for the robot's datagram, passes it on, waits
for the client's, and makes one step. What a client requests between a state and its answer acts in that round, so
that a run is repeated bit for bit. Without a client, rounds go on only while the robot moves, or a request waits for
them. Requests are served in all waits.
"""

from __future__ import annotations

import contextlib
import gc
import select
import socket as socketlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from s2r_a1.datagrams import Address, LinkError, Socket, is_loopback, opened
from s2r_a1.guard import moves, states
from s2r_a1.guard.control import Listener, Party, RefusedError, Request
from s2r_a1.guard.limits import LIMITS, ROUND, SECOND
from s2r_a1.guard.place import Robot
from s2r_a1.guard.states import ROWS, Arrival, Conditions, Inputs, Machine, State
from s2r_a1.link import Link, RobotSide, UdpLink
from s2r_a1.rawlog import RawLogError, RawLogWriter
from s2r_a1.wire import LAYOUTS, Command, Orders

SINKING = {State.DAMPING: 3 * SECOND, State.RESTING: SECOND}
"""A budget [ns]: how long a robot that was let go is looked after, until it lies. Twice as long delays the end."""
LOOKED = 0.2
"""A budget [s]: how long an idle guard waits before it looks whether it is to end."""
UNANSWERED = 1.0
"""A budget [s]: how long a client in lock step is waited for that may move nothing any more. One that was stopped for
good would hold up the damping of the robot; twice as long does so for longer."""
GREETED = 10.0
"""A budget [s]: how much longer a new guard waits for who started it. Twice as long leaves a useless one for longer."""
MUTE = 3.0
"""A budget [s]: how long the first answer of a twin in lock step may take. Twice as long reveals a wrong one later."""
RENEWED = 500
"""A budget [rounds]: how often a guard looks whether its control socket is still there; each look takes 10 µs."""
POLLED = 0.005
"""A budget [s]: how often a request that waits for the disk is looked at."""

AT_REST = frozenset({State.OFF, State.LINKED, State.ARMED, State.RESTING})
"""A definition: states in which nothing holds the robot up, and a guard may end."""


class Deferred(NamedTuple):
    """A request that is answered later.

    Attributes:
        party: who waits.
        poll: returns the reply, or None while it must wait; raises RefusedError.
        rounds: whether it waits for rounds, and not for the disk.
    """

    party: Party
    poll: Callable[[], dict[str, Any] | None]
    rounds: bool


@dataclass
class Client:
    """The program that moves the robot: its connection, and its leg of the wire."""

    party: Party
    address: Address
    socket: Socket
    side: RobotSide


Answer = Callable[["Guard", Party, Request], dict[str, Any] | Deferred]


class Guard:
    """One robot's guard.

    Attributes:
        robot: its address.
        machine: the state, a value.
        link: to the robot; None before the first consent.
        client: who moves the robot.
        log: the recording that is being written.
        rounds: so far.
        late: rounds that began more than a round late.
        event: the last that was published.
        packet: the last good state, as it came.
        ending: whether the guard is to end as soon as the robot lies.
        terminated: set by a signal's handler; the next wait sees to it.
        answer: replies to a request, or says when; raises RefusedError.
    """

    def __init__(self, robot: Robot, listener: Listener, answer: Answer, idle: float = 60.0) -> None:
        self.robot = robot
        self.layout = LAYOUTS[robot.layout]
        self.limits = LIMITS
        self.lockstep = robot.clock == "lockstep"
        self.loopback = is_loopback(robot.host)
        self.listener = listener
        self.machine = Machine()
        self.link: Link | None = None
        self.client: Client | None = None
        self.log: RawLogWriter | None = None
        self.rounds = 0
        self.late = 0
        self.event: dict[str, Any] | None = None
        self.packet = b""
        self.ending = False
        self.terminated = False
        self.answer = answer
        self._socket: Socket | None = None
        self._pending: list[Deferred] = []
        self._idle = idle
        self._orders: Orders | Command | None = None
        self._due = 0
        self._alone = time.monotonic() + GREETED

    # What the requests act on.

    @property
    def now(self) -> int:
        """The time of this round [ns]; in lock step it counts rounds."""
        return self.rounds * ROUND if self.lockstep else time.monotonic_ns()

    def become(self, machine: Machine) -> None:
        """Take a new state of the machine, and publish what has changed."""
        before, self.machine = self.machine, machine
        if machine is before:
            return
        if (machine.state, machine.since) != (before.state, before.since):
            self._publish("state", state=machine.state, word=machine.word, reason=machine.reason)
            if machine.state is State.DAMPING and self.client:
                self.client.party.spent = True
            if machine.state is State.RESTING:
                gc.collect()
        wanted = machine.wanted
        if wanted and wanted != before.wanted and ROWS[machine.state].client:
            self._publish("wanted", state=wanted.state, word=wanted.word, reason=wanted.reason)
        if machine.warnings and machine.warnings != before.warnings:
            old = {name for name, _ in before.warnings}
            for name, sentence in machine.warnings:
                if name not in old:
                    self._publish("warning", reason=sentence)

    def connect(self) -> None:
        """Open the link to the robot.

        Raises:
            LinkError: the local port is taken, no network leads to the robot, or the vendor's module is no such one.
        """
        if self.link is None:
            self.link = self._opened()
            self.link.tap = self._record
        self.become(states.connected(self.machine, self.now))
        self._orders, self._due = ROWS[self.machine.state].orders(self.machine, self.now, self.limits), 0

    def _opened(self) -> Link:
        robot = self.robot
        peer = (robot.host, robot.port)
        if not robot.module:
            self._socket = opened(peer, lockstep=self.lockstep, port=robot.local)
            return UdpLink(self._socket, self.layout)
        if self.lockstep:
            raise LinkError(
                "the vendor's module runs in real time only; leave it out, or leave out lock step"
            )
        from s2r_a1 import vendor  # loads a program of others, which only who names it wants

        return vendor.opened(robot.module, self.layout, peer, robot.local)

    def disconnect(self) -> None:
        """Close the link to a robot that does not answer."""
        self.become(states.disconnected(self.machine, self.now))
        self._close_link()

    def reset(self) -> None:
        """Take the operator's word that a damped robot lies."""
        self.become(states.reset(self.machine, self.now))
        if self._socket and self._socket.gone:
            self._close_link()
            self.connect()
        elif self.link:
            self.link.forget()

    def conditions(self) -> Conditions:
        """Return what the link says of the robot."""
        if self.link is None:
            return Conditions(False, None, self.loopback)
        return Conditions(self.link.unit is not None, self.link.refusal, self.loopback)

    def attach(self, party: Party, port: int) -> int:
        """Make a party the client, and return the guard's UDP port for it.

        Raises:
            LinkError: its port cannot be spoken to.
        """
        address = ("127.0.0.1", port)
        socket = opened(address, lockstep=self.lockstep)
        self.client = Client(party, address, socket, RobotSide(socket, self.layout))
        return socket.port

    @property
    def attended(self) -> bool:
        """Whether an operator is attached, who can stop the robot."""
        return any(party.role == "operator" and party.open for party in self.listener.parties)

    def leave(self, party: Party) -> None:
        """Forget a party whose connection has ended; a robot that its client held up is damped.

        So is one that a client moves when the last operator has gone: nobody could stop it any more. One that stands
        after its client took leave lies down when nobody is attached any more.
        """
        if self.client and self.client.party is party:
            self.release()
            self.become(states.left(self.machine, self.now))
        elif self.client and party.role == "operator" and not self.attended:
            self.become(states.left(self.machine, self.now, "operator"))
        elif not self.client and not self.listener.parties:
            reason = "nobody is attached to the guard any more"
            self.become(states.stopped(self.machine, True, "operator", reason))

    def release(self) -> None:
        """Have no client; the robot goes on as it does."""
        if self.client:
            self.client.socket.close()
            self.client = None

    def forget_orders(self) -> None:
        """Leave aside what the client has sent so far: a new motion begins."""
        if self.client and not self.lockstep:
            self.client.side.receive()

    def record(self, path: str, header: dict[str, Any]) -> RawLogWriter:
        """Begin a recording of all packets from and to the robot; one that runs is finished."""
        if self.log:
            self.log.finish()
        self.log = RawLogWriter(path, header)
        return self.log

    def finish_recording(self) -> RawLogWriter | None:
        """Ask for the end of the recording, and return it."""
        log, self.log = self.log, None
        if log:
            log.finish()
        return log

    # The loop.

    def run(self) -> None:
        """Turn rounds and serve requests until the guard is to end."""
        gc.collect()
        gc.freeze()
        gc.disable()
        try:
            while not self._ended():
                self.turn()
        except Exception:
            self._give_up()
            raise
        finally:
            self.close()

    def _give_up(self) -> None:
        """Damp the robot until it lies, after an error of the guard itself that nobody foresaw."""
        if self.link is None or self.machine.state in (State.OFF, State.LINKED):
            return
        for _ in range(SINKING[State.DAMPING] // ROUND):
            self.link.write(moves.DAMPED)
            if self.lockstep:
                self.link.read()
            else:
                time.sleep(ROUND / SECOND)

    def turn(self) -> None:
        """Turn one round, or serve requests for a while where no rounds go on."""
        if self._turning():
            self._round()
        else:
            self._serve(self._ready([], LOOKED))
            self.listener.renew()

    def close(self) -> None:
        """Free the sockets, and finish a recording."""
        log = self.finish_recording()
        if log:
            with contextlib.suppress(RawLogError):  # what could be written is there, in whole blocks
                log.close(10.0)
        if self.client:
            self.client.socket.close()
            self.client = None
        self._close_link()
        self.listener.close()

    def stop(self, reason: str) -> None:
        """Let the robot lie down if it stands, and end then."""
        self.ending = True
        self.become(states.stopped(self.machine, True, "operator", reason))

    def _ended(self) -> bool:
        """Return whether the guard has nothing left to do."""
        machine = self.machine
        if self.ending and machine.state in (*AT_REST, State.DAMPING) and not self._sinking():
            return True
        if self.listener.parties or not (machine.state in AT_REST or self._orphaned()):
            self._alone = time.monotonic()
        return time.monotonic() - self._alone >= self._idle

    def _orphaned(self) -> bool:
        """Return whether the robot was a twin that has ended, and was damped before: nobody is to be looked after.

        A real robot is damped for as long as nobody resets it.
        """
        damped = self.machine.state is State.DAMPING and not self._sinking()
        return damped and self.loopback and is_free((self.robot.host, self.robot.port))

    def _turning(self) -> bool:
        """Return whether rounds go on."""
        if self.link is None:
            return False
        if not self.lockstep or self.client or any(waits.rounds for waits in self._pending):
            return True
        return self.moving()

    def moving(self) -> bool:
        """Return whether the robot moves by itself, so that rounds must go on though nobody looks."""
        machine = self.machine
        return ROWS[machine.state].moves or machine.wanted is not None or self._sinking()

    def _sinking(self) -> bool:
        """Return whether a robot that was let go may still be on its way down."""
        return self.now - self.machine.since < SINKING.get(self.machine.state, 0)

    def _round(self) -> None:
        brought = self._lock_step() if self.lockstep else self._real_time()
        self.rounds += 1
        if self.rounds % RENEWED == 0:
            self.listener.renew()
        step = states.step(self.machine, brought._replace(now=self.now), self.limits)
        self._orders = step.orders
        self.become(step.machine)
        if not self.lockstep:
            self._send()
        if self.log:
            self._look_at_log(self.log)
        if self._pending:
            self._answer_later(rounds=True)

    def _send(self) -> None:
        if self.link and self._orders:
            self.link.write(self._orders)

    def _real_time(self) -> Inputs:
        """Wait until the round is due; return what it brings."""
        now = time.monotonic_ns()
        if not self._due or now - self._due > 2 * ROUND:
            self.late += self._due > 0
            self._due = now
        self._due += ROUND
        link = self.link
        assert link is not None
        arrival = Arrival()
        watched = link.fileno()
        while True:
            left = self._due - time.monotonic_ns()
            ready = self._ready([] if watched is None else [watched], max(left, 0) / SECOND)
            is_due = left <= 0 or (not ready and time.monotonic_ns() >= self._due)
            if watched in ready or (watched is None and is_due):
                arrival = _newest(arrival, self._read(link))
            self._serve(ready)
            if is_due:
                return self._ordered(self.client, arrival)

    def _lock_step(self) -> Inputs:
        """Send the command, wait for the robot's datagram, pass it on, and wait for the client's."""
        self._send()
        link, socket = self.link, self._socket
        assert link is not None
        assert socket is not None
        # One that never answers does not understand us; one that has answered is waited for.
        peer = (self.robot.host, self.robot.port)
        self._await(socket, peer, None if link.counters.received else MUTE)
        arrival = self._read(link)
        client = self.client
        if client:
            if arrival.reading is None:
                client.side.skip()
            self._await(client.socket, client.address, client=client)
        return self._ordered(client if client is self.client else None, arrival)

    def _await(
        self, socket: Socket, peer: Address, seconds: float | None = None, client: Client | None = None
    ) -> None:
        """Serve requests until a datagram waits at a socket.

        Nothing may ever come: then its peer is gone, as it is after so many seconds, if any.
        """
        began = time.monotonic()
        while not socket.gone and (client is None or self.client is client):
            ready = self._ready([socket.fileno()], LOOKED)
            self._serve(ready)
            if socket.fileno() in ready:
                return
            silent = time.monotonic() - began
            if client and client.party.spent and silent >= UNANSWERED:
                self.release()
                return
            socket.gone = (seconds is not None and silent >= seconds) or (silent >= LOOKED and is_free(peer))

    def _read(self, link: Link) -> Arrival:
        """Return what came; a good reading is passed on to the client."""
        arrival = states.arrived(self.limits, link.read(), link.fault)
        if arrival.reading is not None:
            self.packet = link.packet
            if self.client:
                self.client.side.send(link.packet)
        return arrival

    def _ordered(self, client: Client | None, arrival: Arrival) -> Inputs:
        """Return what a round brings, with the client's newest orders."""
        inputs = Inputs(0, arrival)
        if client is None:
            return inputs
        if not ROWS[self.machine.state].client or client.party.spent:
            client.socket.receive()  # nobody follows it; not even decoded
            return inputs
        counters = client.side.counters
        before = counters.corrupt + counters.numbers
        orders = client.side.receive()
        return inputs._replace(orders=orders, dropped=counters.corrupt + counters.numbers - before)

    def _record(self, direction: int, data: bytes) -> None:
        if self.log:
            self.log.append(self.now, direction, data)

    def _look_at_log(self, log: RawLogWriter) -> None:
        """Let the robot lie down if the disk takes no more, and end a recording that nobody ends."""
        if log.failure and not self.machine.wanted:
            self.become(states.stopped(self.machine, True, "disk", log.failure, now_=True))
        if self.client is None and not self.moving() and not ROWS[self.machine.state].stands:
            self.finish_recording()

    # Requests.

    def _ready(self, files: list[int], seconds: float) -> set[int]:
        """Return the descriptors that can be read, after at most so many seconds."""
        if self._pending:
            seconds = min(seconds, POLLED)
        return set(select.select([*files, *self.listener.filenos()], [], [], seconds)[0])

    def _serve(self, ready: set[int]) -> None:
        """Answer the requests that have come, and those that can be answered now."""
        if ready:
            for party, request in self.listener.take(ready):
                self._reply(party, partial(self._answered, party, request))
            for party in self.listener.parties:
                party.flush()
            for party in self.listener.ended():
                self.leave(party)
        if self._pending:
            self._answer_later(rounds=False)
        if self.terminated and not self.ending:
            self.stop("the guard was asked to end")

    def _answer_later(self, rounds: bool) -> None:
        """Answer the requests that waited for rounds, or for the disk, if they can be answered now."""
        waiting, self._pending = self._pending, []
        for deferred in waiting:
            if deferred.rounds is not rounds:
                self._pending.append(deferred)
            elif deferred.party.open:
                self._reply(deferred.party, partial(_polled, deferred))

    def _answered(self, party: Party, request: Request | str) -> dict[str, Any] | Deferred:
        if isinstance(request, str):
            raise RefusedError(request)
        return self.answer(self, party, request)

    def _reply(self, party: Party, answered: Callable[[], dict[str, Any] | Deferred]) -> None:
        """Send the reply to a request, or keep it for later."""
        try:
            found = answered()
        except (RefusedError, LinkError) as error:
            party.send({"ok": False, "error": str(error), "state": self.machine.state})
            return
        if isinstance(found, Deferred):
            self._pending.append(found)
        else:
            party.send({"ok": True, "state": self.machine.state, **found})

    def _publish(self, event: str, **fields: Any) -> None:
        self.event = {"event": event, **fields, "round": self.rounds}
        if self.log:
            self.log.note(self.now, self.event)
        self.listener.publish(self.event)

    def _close_link(self) -> None:
        if self.link:
            self.link.close()
        self.link = self._socket = None


def _newest(before: Arrival, after: Arrival) -> Arrival:
    """Return what two reads of a round have brought: the newest good reading, or whether a bad one came."""
    if after.reading is not None:
        return after
    return before if before.reading is not None else after._replace(bad=before.bad or after.bad)


def _polled(deferred: Deferred) -> dict[str, Any] | Deferred:
    reply = deferred.poll()
    return deferred if reply is None else reply


def is_free(address: Address) -> bool:
    """Return whether no process of this machine holds a UDP port.

    A process that was killed after a datagram had reached it leaves no other trace.
    """
    with socketlib.socket(socketlib.AF_INET, socketlib.SOCK_DGRAM) as probe:
        try:
            probe.bind(address)
        except OSError:
            return False
    return True
