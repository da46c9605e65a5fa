"""Walk one test: stand, trot in place, step to the command at t = 0, ramp down, stand again.

    line.receive()      the newest state of the robot, through the guard
    line.request(...)   a request to the guard, which acts in the round of that state
    line.send(orders)   the commands for the motors

The guard ends the walk when a limit is exceeded, and changes its state. Before t = 0 there is then no rollout
(:class:`NotBegunError`); later the result is the walk so far, and the guard's word for the cause.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

from s2r_a1.client import GONE, Client, StateChange
from s2r_a1.excitation import Player
from s2r_a1.guard.limits import LIMITS, MS, SECOND
from s2r_a1.pilot import Note, Pilot, orders
from s2r_a1.schedule import Schedule
from s2r_a1.ticks import PERIOD
from s2r_a1.wire import Orders, Reading, WireError
from s2r_spec.errors import BackendError, NotBegunError

GETTING_UP = 5000
"""A budget [rounds of 2 ms]: time to stand up or to lie down, 10 s."""
SETTLING = 250
"""A budget [rounds of 2 ms]: time of standing still before and after a walk, 0.5 s."""


class Walked(NamedTuple):
    """The notes of a motion from its first tick up to a requested stop, and the cause of an early end if any."""

    notes: tuple[Note, ...]
    ending: StateChange | None


def walk(
    line: Client,
    pilot: Pilot,
    schedule: Schedule,
    ready: Callable[[], None] | None = None,
    begins: Callable[[], None] | None = None,
) -> Walked:
    """Walk one test; the robot stands afterwards, unless the guard ended the walk.

    Args:
        line: connection to the robot.
        pilot: pilot with compiled code, because compiling now would be silence to the guard.
        schedule: the test.
        ready: raises a NotBegunError if the standing robot must not walk yet.
        begins: function to call at t = 0.

    Raises:
        NotBegunError: the walk ended before t = 0.
        BackendError: the guard refused a request.
    """

    def practise(reading: Reading) -> None:
        pilot.begin(schedule, line.unit)
        pilot.step(reading)

    # In lock step no computer is too slow.
    reading = stand(line, None if line.lockstep else practise)
    pilot.begin(schedule, line.unit)
    return _move_on(line, pilot, "walk", reading, ready, begins)


def move(
    line: Client,
    mover: Pilot | Player,
    motion: str,
    ready: Callable[[], None] | None = None,
    begins: Callable[[], None] | None = None,
) -> Walked:
    """Let a mover move the robot, in the guard's state of this ``motion``; see :func:`walk`."""
    return _move_on(line, mover, motion, stand(line), ready, begins)


def _move_on(
    line: Client,
    mover: Pilot | Player,
    motion: str,
    reading: Reading,
    ready: Callable[[], None] | None,
    begins: Callable[[], None] | None,
) -> Walked:
    """Move a standing robot from a reading on."""
    if ready is not None:
        ready()
    notes, ending = _move(line, mover, motion, reading, begins)
    if ending is None or ending.state != GONE:
        with suppress(BackendError):  # until the robot is still; the recording goes on
            _wait(line, SETTLING, lambda: line.change.state == GONE)
    if not notes or notes[-1].tick < 0:
        raise NotBegunError(_sentence(line.change if ending is None else ending))
    return Walked(tuple(notes), ending)


def stand(line: Client, practise: Callable[[Reading], None] | None = None) -> Reading:
    """Have the robot stand up if it lies, and return the newest reading once it stands still.

    Meanwhile ``practise`` does the work of a walk at every reading, so that a computer that is too slow is found before
    the robot walks.

    Raises:
        NotBegunError: the guard ended it, it took too long, or this computer is too slow.
    """
    reading = line.receive()
    if line.change.state in ("ARMED", "RESTING"):
        line.request("stand")
    stood = read = 0
    before = longest = 0.0
    for _ in range(GETTING_UP):
        if line.change.state not in ("STANDING_UP", "STAND"):
            raise NotBegunError(_sentence(line.change))
        stood += line.change.state == "STAND"
        read += reading is not None
        if stood > SETTLING and reading is not None:
            if longest >= PERIOD + LIMITS.bridged / SECOND:
                raise NotBegunError(
                    "this computer is too slow for a robot: it delayed the walking program by "
                    f"{1e3 * (longest - PERIOD):.0f} ms while the robot stood, and {LIMITS.bridged / MS:.0f} ms are "
                    "too long; end other programs, or use another computer"
                )
            return reading
        if stood and practise is not None:
            now = time.monotonic()
            longest, before = max(longest, now - (before or now)), now
            if reading is not None:
                practise(reading)
        line.send(None)
        reading = line.receive()
    if read < GETTING_UP // 2:
        raise NotBegunError(
            f"this computer is too slow for the robot: the walking program got a state in {read} of {GETTING_UP} "
            "rounds; end other programs, and try again"
        )
    raise NotBegunError("the robot did not stand up within 10 s; check what holds it, and try again")


def rest(line: Client) -> None:
    """Have a standing robot lie down, and wait until it lies or the guard acts; raise BackendError if it refuses."""
    if line.change.state in ("STANDING_UP", "STAND"):
        line.request("lie")
    # A robot that still settles stands for a while before it lies down.
    _wait(line, GETTING_UP, lambda: line.change.state not in ("STANDING_UP", "STAND", "LYING_DOWN"))


def _wait(line: Client, rounds: int, until: Callable[[], bool]) -> None:
    """Answer states without commands, for some rounds or until a condition holds."""
    for _ in range(rounds):
        if until():
            return
        line.send(None)
        line.receive()


def _move(
    line: Client, mover: Pilot | Player, motion: str, reading: Reading, begins: Callable[[], None] | None
) -> tuple[list[Note], StateChange | None]:
    """Return the notes of a motion from a reading on, and the cause of an early end."""
    line.request(motion)
    notes: list[Note] = []
    newest: Reading | None = reading
    ordered: Orders | None = None
    stopped: StateChange | None = None
    while True:
        if newest is not None:
            if line.wanted and not stopped:
                stopped = line.wanted
                mover.stop()
            note = mover.step(newest)
            if not stopped:  # later notes do not belong to the test
                notes.append(note)
            if begins is not None and note.tick >= 0:
                begins()
                begins = None
            if mover.is_done(note):
                try:
                    line.request("halt")
                except BackendError:  # the guard acted before
                    return notes, line.change
                return notes, stopped
            ordered = orders(note)
        # Without a new state the last orders are sent again, to show the guard that this process is alive.
        try:
            line.send(ordered)
            newest = line.receive()
        except WireError as error:
            reason = f"the controller commands a number that no motor can take: {error}"
            with suppress(BackendError):
                line.request("damp", reason=reason)
            return notes, StateChange("DAMPING", "torque", reason)  # a fault of the controller is an outcome
        except BackendError as error:
            return notes, StateChange(GONE, "link", str(error))
        if line.change.state != motion.upper():
            return notes, line.change


def _sentence(change: StateChange) -> str:
    """Return why a walk did not begin."""
    return change.reason or f"the guard of the robot is in the state {change.state}; a walk begins in STAND"
