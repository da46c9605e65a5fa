"""Walks one test: stand, trot in place, the command at t = 0, ramp down, stand again.

    line.receive()      the newest state of the robot, through the guard
    line.request(...)   what the guard is asked for: it acts in the round of that state
    line.send(orders)   what the motors are to do

The guard decides: it ends the walk when a limit is passed, and says so by a change of its state. Before t = 0 that is
no rollout (:class:`NotBegunError`); after it, the walk so far and the guard's word for what ended it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from s2r_a1.pilot import Note, Pilot, orders
from s2r_a1.schedule import Schedule
from s2r_a1.ticks import TickUnit
from s2r_a1.wire import Orders, Reading, WireError
from s2r_spec.errors import BackendError, NotBegunError

GETTING_UP = 5000
"""A budget [rounds of 2 ms]: how long getting up or down may take, 10 s. Twice as much waits longer for one that is
stuck."""
SETTLING = 250
"""A budget [rounds of 2 ms]: of standing still before a walk and after it, 0.5 s. Twice as much costs 1 s a rollout."""
GONE = "GONE"
"""A definition: the state of a guard that ended while the robot was in its care."""


class Change(NamedTuple):
    """A state of the guard, and why it is in it: a word and a sentence, empty where all is well."""

    state: str
    word: str = ""
    reason: str = ""


class Line(Protocol):
    """The way to the robot: the guard's, or a test's own.

    Attributes:
        unit: of the robot's clock.
        change: the newest state of the guard, as of the last ``receive`` or ``request``.
        wanted: what the guard asks for, STAND or RESTING, and why; None as long as the robot may walk on.
    """

    unit: TickUnit
    change: Change
    wanted: Change | None

    def receive(self) -> Reading | None:
        """Return the state of this round; None where none came that can be used."""
        ...

    def send(self, orders: Orders | None) -> None:
        """Send the orders of this round, or none."""
        ...

    def request(self, do: str, **fields: Any) -> Mapping[str, Any]:
        """Ask the guard for something, and return its reply.

        Raises:
            BackendError: it refuses; the sentence says why.
        """
        ...


@dataclass(frozen=True)
class Walked:
    """What a walk left behind.

    Attributes:
        notes: at every reading, from the first tick of trotting in place on, up to a stop that was asked for.
        ending: what ended it early; None where it went as planned.
    """

    notes: tuple[Note, ...]
    ending: Change | None


def walk(
    line: Line,
    pilot: Pilot,
    schedule: Schedule,
    ready: Callable[[], None] | None = None,
    begins: Callable[[], None] | None = None,
) -> Walked:
    """Walk one test; the robot stands afterwards, unless something ended the walk.

    Args:
        line: to the robot.
        pilot: has practised: what compiles for a second now is silence to the guard.
        schedule: of the test.
        ready: raises a NotBegunError if a robot that stands shall not walk yet.
        begins: is called at t = 0.

    Raises:
        NotBegunError: something ended it before t = 0.
        BackendError: the guard refused a request.
    """
    reading = stand(line)
    if ready is not None:
        ready()
    notes, ending = _walk(line, pilot, schedule, reading, begins)
    if ending is None or ending.state != GONE:
        _settle(line)
    if not notes or notes[-1].tick < 0:
        raise NotBegunError(_sentence(line.change if ending is None else ending))
    return Walked(tuple(notes), ending)


def stand(line: Line) -> Reading:
    """Have the robot stand up, or stand on, and return the newest reading of one that stands still.

    Raises:
        NotBegunError: the guard ended it, or it took too long.
    """
    reading = line.receive()
    if line.change.state in ("ARMED", "RESTING"):
        line.request("stand")
    stood = 0
    for _ in range(GETTING_UP):
        if line.change.state not in ("STANDING_UP", "STAND"):
            raise NotBegunError(_sentence(line.change))
        stood += line.change.state == "STAND"
        if stood > SETTLING and reading is not None:
            return reading
        line.send(None)
        reading = line.receive()
    raise NotBegunError("the robot did not stand up within 10 s; look what holds it, and try again")


def rest(line: Line) -> None:
    """Have a robot that stands lie down, and return when it does, or when the guard has another plan.

    Raises:
        BackendError: the guard refuses.
    """
    if line.change.state in ("STANDING_UP", "STAND"):
        line.request("lie")
    for _ in range(GETTING_UP):
        if line.change.state != "LYING_DOWN":
            return
        line.send(None)
        line.receive()


def _walk(
    line: Line, pilot: Pilot, schedule: Schedule, reading: Reading, begins: Callable[[], None] | None
) -> tuple[list[Note], Change | None]:
    """Return the notes of a walk that begins at a reading, and what ended it early."""
    notes: list[Note] = []
    pilot.begin(schedule, line.unit)
    line.request("walk")
    newest: Reading | None = reading
    ordered: Orders | None = None
    stopped: Change | None = None
    while True:
        if newest is not None:
            if line.wanted and not stopped:
                stopped = line.wanted
                pilot.stop()
            note = pilot.step(newest)
            if not stopped:  # what comes after is no longer of the test
                notes.append(note)
            if begins is not None and note.tick >= 0:
                begins()
                begins = None
            if pilot.is_done(note):
                return notes, _halted(line) or stopped
            ordered = orders(note)
        # Without a new state the last orders go out again: the guard is to know that this end is alive.
        try:
            line.send(ordered)
            newest = line.receive()
        except WireError as error:
            return notes, _damped(line, f"the controller asks for what no motor can do: {error}")
        except BackendError as error:
            return notes, Change(GONE, "link", str(error))
        if line.change.state != "WALK":
            return notes, line.change


def _halted(line: Line) -> Change | None:
    """Have the guard take over; return what it did instead, if it was quicker."""
    try:
        line.request("halt")
    except BackendError:
        return line.change
    return None


def _damped(line: Line, reason: str) -> Change:
    """Have the robot damped; what its controller does is an outcome."""
    with suppress(BackendError):
        line.request("damp", reason=reason)
    return Change("DAMPING", "torque", reason)


def _settle(line: Line) -> None:
    """Let rounds pass until the robot is still; the recording goes on."""
    with suppress(BackendError):
        for _ in range(SETTLING):
            if line.change.state == GONE:
                break
            line.send(None)
            line.receive()


def _sentence(change: Change) -> str:
    """Return why a walk did not begin."""
    return (
        change.reason or f"the guard of the robot is in the state {change.state}, in which no walk can begin"
    )
