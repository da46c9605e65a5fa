"""The rounds of a guard: inputs, a step of the state machine, outputs.

In real time a round begins every 2 ms by the computer's monotonic clock. States are passed on to the client as they
arrive. A round begins with the client's newest commands, and sends its own command at once.

In lock step no clock is read. A round sends the command, waits for the robot's datagram, passes it on, waits for the
client's, and makes one step. A client's request between a state and its answer acts in that round, so a run repeats
bit for bit. Without a client, rounds go on only while the robot moves or a request waits for them. Every wait serves
requests.
"""

from __future__ import annotations

import contextlib
import gc
import time
from math import inf
from typing import Any

from s2r_a1 import datagrams
from s2r_a1.datagrams import Address, LinkError, RealTimeSocket, is_free, is_loopback
from s2r_a1.guard import moves, transitions
from s2r_a1.guard.client_session import ClientSession
from s2r_a1.guard.control import Listener, Party
from s2r_a1.guard.limits import LIMITS, ROUND, SECOND
from s2r_a1.guard.place import RobotAddress
from s2r_a1.guard.serving import Answer, RequestServer
from s2r_a1.guard.states import RULES, Arrival, Inputs, Machine, State
from s2r_a1.guard.step import judge_arrival, merge, step
from s2r_a1.guard.transitions import Conditions
from s2r_a1.link import Link, UdpLink
from s2r_a1.rawlog import RawLogError, RawLogWriter
from s2r_a1.wire import LAYOUTS, MotorPacket, Orders

SINKING = {State.DAMPING: 3 * SECOND, State.RESTING: SECOND}
"""A budget [ns]: time of damping until a robot lies."""
LOOKED = 0.2
"""A budget [s]: interval at which an idle guard checks whether it must end."""
UNANSWERED = 1.0
"""A budget [s]: wait in lock step for a client that may no longer move the robot, since it would delay damping."""
GREETED = 10.0
"""A budget [s]: extra time that a new guard waits for the program that started it."""
MUTE = 3.0
"""A budget [s]: time for the first answer of a twin in lock step."""
RENEWED = 500
"""A budget [rounds]: interval between two checks of the control socket; each takes 10 µs."""

AT_REST = frozenset({State.OFF, State.LINKED, State.ARMED, State.RESTING})
"""A definition: states in which the robot lies or hangs without support of its motors, so a guard may end."""


class Guard:
    """The guard of one robot, with a machine whose state is a value.

    Attributes:
        link: link to the robot; None before the first consent.
        client: program that moves the robot; None if there is none.
        log: current recording; None if there is none.
        late: number of rounds that began more than one round late.
        event: last published event.
        packet: packet of the last valid state.
        ending: whether the guard ends as soon as the robot lies.
        terminated: set by the signal handler, and handled in the next wait.
    """

    def __init__(self, robot: RobotAddress, listener: Listener, answer: Answer, idle: float = 60.0) -> None:
        self.robot = robot
        self.layout = LAYOUTS[robot.layout]
        self.limits = LIMITS
        self.lockstep = robot.clock == "lockstep"
        self.loopback = is_loopback(robot.host)
        self.listener, self.answer = listener, answer
        self.machine = Machine()
        self.link: Link | None = None
        self.client: ClientSession | None = None
        self.log: RawLogWriter | None = None
        self.rounds = self.late = 0
        self.event: dict[str, Any] | None = None
        self.packet = b""
        self.ending = self.terminated = False
        self._requests = RequestServer(self, listener)
        self._socket: RealTimeSocket | None = None
        self._idle = idle
        self._orders: Orders | MotorPacket | None = None
        self._due = 0
        self._alone = time.monotonic() + GREETED

    @property
    def now(self) -> int:
        """Time of this round [ns]; in lock step it counts rounds."""
        return self.rounds * ROUND if self.lockstep else time.monotonic_ns()

    def become(self, machine: Machine) -> None:
        """Set the state of the machine, and publish its changes."""
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
        if wanted and wanted != before.wanted and RULES[machine.state].client:
            self._publish("wanted", state=wanted.state, word=wanted.word, reason=wanted.reason)
        for name, sentence in machine.warnings:
            if name not in dict(before.warnings):
                self._publish("warning", reason=sentence)

    def connect(self) -> None:
        """Open the link to the robot.

        Raises:
            LinkError: the local port is in use, no network leads to the robot, or the vendor's module is not valid.
        """
        if self.link is None:
            self.link = self._open_link()
            self.link.tap = self._record
        self.become(transitions.connect(self.machine, self.now))
        self._orders, self._due = RULES[self.machine.state].orders(self.machine, self.now, self.limits), 0

    def _open_link(self) -> Link:
        robot = self.robot
        peer = (robot.host, robot.port)
        if not robot.module:
            self._socket = datagrams.open_socket(peer, lockstep=self.lockstep, port=robot.local)
            return UdpLink(self._socket, self.layout)
        if self.lockstep:
            raise LinkError("the vendor's module runs only in real time; leave out module or clock=lockstep")
        from s2r_a1 import vendor  # imported only if the user names a third-party module

        return vendor.open_link(robot.module, self.layout, peer, robot.local)

    def disconnect(self) -> None:
        """Close the link to a robot that does not answer."""
        self.become(transitions.disconnect(self.machine, self.now))
        self._close_link()

    def reset(self) -> None:
        """Take the operator's word that a damped robot lies."""
        self.become(transitions.reset(self.machine, self.now))
        if self._socket and self._socket.gone:
            self._close_link()
            self.connect()
        elif self.link:
            self.link.forget()

    def conditions(self) -> Conditions:
        """Return the conditions of the link for arming."""
        if self.link is None:
            return Conditions(False, None, self.loopback)
        return Conditions(self.link.unit is not None, self.link.refusal, self.loopback)

    def attach(self, party: Party, port: int) -> int:
        """Make a party the client, and return the guard's UDP port for it; raise LinkError if it is out of reach."""
        self.client = ClientSession(party, port, self.layout, self.lockstep)
        return self.client.socket.port

    @property
    def attended(self) -> bool:
        """Whether an operator is attached and can stop the robot."""
        return any(party.role == "operator" and party.open for party in self.listener.parties)

    def leave(self, party: Party) -> None:
        """Remove a party whose connection has ended, and act on it.

        A standing robot is damped if its client disconnects, and a moving one if the last operator does, because nobody
        could stop it. A robot that stands without a client lies down when nobody is attached.
        """
        if self.client and self.client.party is party:
            self.release()
            self.become(transitions.leave(self.machine, self.now))
        elif self.client and party.role == "operator" and not self.attended:
            self.become(transitions.leave(self.machine, self.now, "operator"))
        elif not self.client and not self.listener.parties:
            self._lie("no program is attached to the guard")

    def release(self) -> None:
        """Remove the client; the robot's state does not change."""
        if self.client:
            self.client.socket.close()
            self.client = None

    def forget_orders(self) -> None:
        """Discard the client's earlier commands at the beginning of a new motion."""
        if self.client and not self.lockstep:
            self.client.socket.receive()

    def record(self, path: str, header: dict[str, Any]) -> RawLogWriter:
        """Begin a recording of all packets from and to the robot; finish the current one."""
        if self.log:
            self.log.finish()
        self.log = RawLogWriter(path, header)
        return self.log

    def finish_recording(self) -> RawLogWriter | None:
        """Request the end of the recording, and return it."""
        log, self.log = self.log, None
        if log:
            log.finish()
        return log

    def run(self) -> None:
        """Run rounds and serve requests until the guard ends."""
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
        """Damp the robot until it lies."""
        if self.link is None or self.machine.state in (State.OFF, State.LINKED):
            return
        for _ in range(SINKING[State.DAMPING] // ROUND):
            self.link.write(moves.DAMPED)
            if self.lockstep:
                self.link.read()
            else:
                time.sleep(ROUND / SECOND)

    def turn(self) -> None:
        """Run one round, or serve requests for a while if no rounds go on."""
        waited_for = any(waits.rounds for waits in self._requests.pending)
        if self.link and (not self.lockstep or self.client or waited_for or self.moving()):
            self._round()
        else:
            self._serve(self._requests.ready([], LOOKED))
            self.listener.renew()

    def close(self) -> None:
        """Close the sockets, and finish a recording."""
        log = self.finish_recording()
        if log:
            with contextlib.suppress(RawLogError):  # all complete blocks that fit are on the disk
                log.close(10.0)
        self.release()
        self._close_link()
        self.listener.close()

    def stop(self, reason: str) -> None:
        """Make a standing robot lie down, and then end."""
        self.ending = True
        self._lie(reason)

    def _lie(self, reason: str) -> None:
        self.become(transitions.stop(self.machine, True, "operator", reason))

    def _ended(self) -> bool:
        machine = self.machine
        if self.ending and machine.state in (*AT_REST, State.DAMPING) and not self._sinking():
            return True
        # A damped twin may have ended; a real robot stays damped until an operator resets it.
        damped = machine.state is State.DAMPING and not self._sinking()
        twin = (self.robot.host, self.robot.port) if damped and self.loopback else None
        if self.listener.parties or not (machine.state in AT_REST or (twin and is_free(twin))):
            self._alone = time.monotonic()
        return time.monotonic() - self._alone >= self._idle

    def moving(self) -> bool:
        """Return whether the robot moves without a client; rounds must then go on."""
        machine = self.machine
        return RULES[machine.state].moves or machine.wanted is not None or self._sinking()

    def _sinking(self) -> bool:
        return self.now - self.machine.since < SINKING.get(self.machine.state, 0)

    def _round(self) -> None:
        brought = self._lock_step() if self.lockstep else self._real_time()
        self.rounds += 1
        if self.rounds % RENEWED == 0:
            self.listener.renew()
        machine, self._orders = step(self.machine, brought._replace(now=self.now), self.limits)
        self.become(machine)
        if not self.lockstep:
            self._send()
        if self.log:
            self._look_at_log(self.log)
        self._requests.answer_later(rounds=True)

    def _send(self) -> None:
        if self.link and self._orders:
            self.link.write(self._orders)

    def _real_time(self) -> Inputs:
        now = time.monotonic_ns()
        if not self._due or now - self._due > 2 * ROUND:
            self.late += self._due > 0
            self._due = now
        self._due += ROUND
        link, arrival = self.link, Arrival()
        assert link is not None
        watched = link.fileno()
        while True:
            left = self._due - time.monotonic_ns()
            ready = self._requests.ready([] if watched is None else [watched], max(left, 0) / SECOND)
            is_due = left <= 0 or (not ready and time.monotonic_ns() >= self._due)
            if watched in ready or (watched is None and is_due):
                arrival = merge(arrival, self._read(link))
            self._serve(ready)
            if is_due:
                return self._ordered(self.client, arrival)

    def _serve(self, ready: set[int]) -> None:
        self._requests.serve(ready)
        if self.terminated and not self.ending:
            self.stop("the guard was asked to end")

    def _lock_step(self) -> Inputs:
        """Send the command, wait for the robot's datagram, pass it on, and wait for the client's."""
        self._send()
        link, socket = self.link, self._socket
        assert link
        assert socket
        # A peer that never answers uses another protocol; for one that has answered there is no time limit.
        self._await(socket, (self.robot.host, self.robot.port), inf if link.counters.received else MUTE)
        arrival = self._read(link)
        client = self.client
        if client:
            if arrival.reading is None:
                client.send(b"")
            self._await(client.socket, client.address, client=client)
        return self._ordered(client if client is self.client else None, arrival)

    def _await(
        self, socket: RealTimeSocket, peer: Address, seconds: float = inf, client: ClientSession | None = None
    ) -> None:
        """Serve requests until a datagram arrives at a socket.

        Without one the peer counts as gone if its port is free, or after ``seconds``.
        """
        began = time.monotonic()
        while not socket.gone and (client is None or self.client is client):
            ready = self._requests.ready([socket.fileno()], LOOKED)
            self._serve(ready)
            if socket.fileno() in ready:
                return
            silent = time.monotonic() - began
            if client and client.party.spent and silent >= UNANSWERED:
                self.release()
                return
            socket.gone = silent >= seconds or (silent >= LOOKED and is_free(peer))

    def _read(self, link: Link) -> Arrival:
        """Return the arrived states; pass a valid one on to the client."""
        arrival = judge_arrival(self.limits, link.read(), link.fault)
        if arrival.reading is not None:
            self.packet = link.packet
            if self.client:
                self.client.send(link.packet)
        return arrival

    def _ordered(self, client: ClientSession | None, arrival: Arrival) -> Inputs:
        if client is None:
            return Inputs(0, arrival)
        return Inputs(0, arrival, *client.orders(RULES[self.machine.state].client))

    def _record(self, direction: int, data: bytes) -> None:
        if self.log:
            self.log.append(self.now, direction, data)

    def _look_at_log(self, log: RawLogWriter) -> None:
        """Make the robot lie down if the disk fails, and end the recording of a client that has left."""
        if log.failure and not self.machine.wanted:
            self.become(transitions.stop(self.machine, True, "disk", log.failure, at_once=True))
        if self.client is None and not self.moving() and not RULES[self.machine.state].stands:
            self.finish_recording()

    def _publish(self, event: str, **fields: Any) -> None:
        self.event = {"event": event, **fields, "round": self.rounds}
        if self.log:
            self.log.note(self.now, self.event)
        self.listener.publish(self.event)

    def _close_link(self) -> None:
        if self.link:
            self.link.close()
        self.link = self._socket = None
