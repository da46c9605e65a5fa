"""Decides what a robot is sent, and when it must be damped: a state machine of pure functions.

Data of a round: the newest reading, a client's orders, requests. State: a :class:`Machine`, a value. A round is
:func:`step`: machine and inputs lead to the next machine and the orders to send. Requests are :func:`request`.

    OFF → (connect) LINKED → (arm) ARMED → (stand) STANDING_UP → STAND → (walk) WALK → (halt) STAND
    STAND → (lie) LYING_DOWN → RESTING → (stand) STANDING_UP …
    from ARMED on, by any limit of the state: DAMPING → (reset) LINKED

OFF sends nothing. LINKED and ARMED send neither gain nor torque. DAMPING is latched: nothing but an operator's
``reset`` leaves it, and then the robot must be armed anew. What holds in a state is a row of :data:`ROWS`: another
motion of a client is another member of :class:`State`, a row, and the request in :data:`BEGINNINGS` that leads to it.

Times are whole nanoseconds of the guard's clock, which in lock step counts rounds.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_a1 import remote
from s2r_a1.guard import limits as limit
from s2r_a1.guard import moves
from s2r_a1.guard.control import Role
from s2r_a1.guard.limits import Check, IntArray, Limits, Seen, Word
from s2r_a1.guard.moves import Motion
from s2r_a1.wire import MOTORS, Command, Orders, Reading

FloatArray = NDArray[np.float64]

RAMP = 1500 * limit.MS
"""A budget [ns]: how long a client may take to come to a stop when it is asked to; then the guard halts. Twice as long
lets a robot walk on for so long after Ctrl-C."""
SINKING = 1000 * limit.MS
"""A budget [ns]: how long a robot is damped at least, so that a reset does not drop it. Twice as long delays resets."""


class State(StrEnum):
    """What the guard does with the robot."""

    OFF = "OFF"
    LINKED = "LINKED"
    ARMED = "ARMED"
    STANDING_UP = "STANDING_UP"
    STAND = "STAND"
    WALK = "WALK"
    LYING_DOWN = "LYING_DOWN"
    RESTING = "RESTING"
    DAMPING = "DAMPING"


class Memory(NamedTuple):
    """What the rounds so far have left.

    Attributes:
        now: of the last round.
        reading: the newest good one.
        fresh: when it came.
        bad: readings in a row that cannot be.
        power: the vendor's count.
        strong: (12,) readings in a row with more than the largest torque.
        strained: (12,) the same with more than the torque of a warning.
        pose: (12,) angles [rad] from which no joint has moved away.
        still: since when.
    """

    now: int = 0
    reading: Reading | None = None
    fresh: int = 0
    bad: int = 0
    power: int = 0
    strong: IntArray = np.zeros(MOTORS, dtype=np.int64)
    strained: IntArray = np.zeros(MOTORS, dtype=np.int64)
    pose: FloatArray | None = None
    still: int = 0


class Followed(NamedTuple):
    """A client's orders.

    Attributes:
        orders: the newest that could be used, within the limits; None before the first.
        at: when they came; before the first, when the client's motion began.
        dropped: packets since then that could not be used.
        clipped: numbers of all its orders that were beyond a limit.
        unusable: packets that could not be used, in all.
        excused: whether its silence has begun anew since the newest orders, because the robot's states were late.
    """

    orders: Orders | Command | None = None
    at: int = 0
    dropped: int = 0
    clipped: int = 0
    unusable: int = 0
    excused: bool = False


class Wanted(NamedTuple):
    """A stop that was asked for while a client moves the robot: STAND, or RESTING by way of it."""

    state: State
    since: int
    word: Word | None
    reason: str | None


class Machine(NamedTuple):
    """The state of a guard, a value.

    Attributes:
        state: what it does.
        since: when it began to.
        word: what made the robot stop, else None.
        reason: the same in a sentence.
        motion: the guard's own, or the one that a client's followed.
        wanted: a stop that is coming.
        warnings: sentences that hold now, by the check's name.
        remote: when a remote control was last on; None if none was when the robot was armed.
    """

    state: State = State.OFF
    since: int = 0
    word: Word | None = None
    reason: str | None = None
    motion: Motion | None = None
    wanted: Wanted | None = None
    memory: Memory = Memory()
    followed: Followed = Followed()
    warnings: tuple[tuple[str, str], ...] = ()
    remote: int | None = None


class Arrival(NamedTuple):
    """What the link has brought, as :func:`arrived` judges it.

    Attributes:
        reading: the newest state, if a good one came.
        bad: whether one came with numbers that cannot be, and no good one.
        calm: whether the reading is far from every limit.
    """

    reading: Reading | None = None
    bad: bool = False
    calm: bool = False


class Inputs(NamedTuple):
    """What a round brings.

    Attributes:
        now: the time.
        arrival: of the robot's states.
        orders: the client's, if any came that can be decoded.
        dropped: packets of the client that cannot be.
    """

    now: int
    arrival: Arrival = Arrival()
    orders: Orders | Command | None = None
    dropped: int = 0


class Step(NamedTuple):
    """What a round leads to; orders are None where nothing may be sent."""

    machine: Machine
    orders: Orders | Command | None


class Row(NamedTuple):
    """What holds in a state.

    Attributes:
        checks: its limits, in the order of which word counts; any of them leads to DAMPING.
        orders: what is sent.
        then: the state after the guard's own motion has ended.
        client: whether a client's orders move the robot.
        stands: whether a client that leaves, leaves the robot damped.
        moves: whether the robot may move by itself: rounds go on even if nobody looks.
        warnings: what is said and stops nothing.
    """

    checks: tuple[Check, ...]
    orders: Callable[[Machine, int, Limits], Orders | Command | None]
    then: State | None = None
    client: bool = False
    stands: bool = False
    moves: bool = False
    warnings: tuple[Check, ...] = ()


def _nothing(machine: Machine, now: int, limits: Limits) -> None:
    return None


def _limp(machine: Machine, now: int, limits: Limits) -> Orders:
    return moves.LIMP


def _damped(machine: Machine, now: int, limits: Limits) -> Orders:
    return moves.DAMPED


def _own(machine: Machine, now: int, limits: Limits) -> Orders:
    assert machine.motion is not None
    return moves.orders(machine.motion, now)


def _followed(machine: Machine, now: int, limits: Limits) -> Orders | Command:
    """Return the client's orders; without their torques where they, or what they rest on, are old."""
    orders, at, dropped = machine.followed[:3]
    if orders is None:
        return _own(machine, now, limits)
    if max(now - at, now - machine.memory.fresh) >= limits.bridged or dropped >= limits.dropped:
        return _decoded(orders)._replace(tau=moves.ZERO)
    return orders


def _decoded(orders: Orders | Command) -> Orders:
    return orders.orders() if isinstance(orders, Command) else orders


# After a pause of the guard itself, what it sees is what the pause did: the robot's own rule has acted meanwhile.
# Else a robot that falls, and a link that breaks, in one round: that it fell counts.
_ROBOT = (limit.HELD_UP, limit.TILT, limit.MOTOR, limit.HEAT, limit.TORQUE, limit.POWER)
_VOID = (limit.LINK, limit.NUMBERS, limit.BUTTON)
_LIES = (limit.MOTOR, limit.ABSENT, limit.NUMBERS, limit.BUTTON)
_WARNINGS = (limit.WARMTH, limit.STRAIN)

ROWS: dict[State, Row] = {
    State.OFF: Row((), _nothing),
    State.LINKED: Row((), _limp),
    State.ARMED: Row(_LIES, _limp),
    State.STANDING_UP: Row(
        (*_ROBOT, limit.DEVIATION, *_VOID), _own, State.STAND, stands=True, moves=True, warnings=_WARNINGS
    ),
    State.STAND: Row(
        (*_ROBOT, limit.HEIGHT, limit.JOINT, limit.DEVIATION, *_VOID), _own, stands=True, warnings=_WARNINGS
    ),
    State.WALK: Row(
        (*_ROBOT, limit.HEIGHT, limit.JOINT, *_VOID, limit.CLIENT),
        _followed,
        client=True,
        stands=True,
        warnings=_WARNINGS,
    ),
    State.LYING_DOWN: Row(
        (*_ROBOT, limit.DEVIATION, *_VOID), _own, State.RESTING, moves=True, warnings=_WARNINGS
    ),
    State.RESTING: Row(_LIES, _damped),
    State.DAMPING: Row((), _damped),
}
"""A definition: the table of states."""

BEGINNINGS: dict[str, tuple[frozenset[State], State]] = {
    "stand": (frozenset({State.ARMED, State.RESTING}), State.STANDING_UP),
    "walk": (frozenset({State.STAND}), State.WALK),
}
"""A definition: the state that a client's request leads to, and from which ones."""


def arrived(limits: Limits, reading: Reading | None, fault: str | None) -> Arrival:
    """Return what came in a round.

    Args:
        limits: what is possible.
        reading: from the link.
        fault: of the link, where it has no reading.
    """
    if reading is None:
        return Arrival(bad=fault == "number")
    if limit.calm(limits, reading):
        return Arrival(reading, calm=True)
    return Arrival(bad=True) if limit.impossible(limits, reading) else Arrival(reading)


def step(machine: Machine, inputs: Inputs, limits: Limits) -> Step:
    """Return what a round leads to."""
    row = ROWS[machine.state]
    now, late = inputs.now, inputs.now - machine.memory.now
    memory = _remembered(machine, inputs, limits)
    followed = _obeyed(machine, inputs, limits) if row.client else machine.followed
    machine = machine._replace(memory=memory, followed=followed)
    if row.checks:
        seen = _seen(machine, now, late)
        new, calm = inputs.arrival.reading is not None, inputs.arrival.calm
        for check in row.checks:
            if (check.measures and not new) or (check.covered and calm):
                continue
            if sentence := check.find(limits, seen):
                machine = damped(machine, now, check.word, sentence)
                break
        else:
            if new:
                checks = [check for check in row.warnings if not (check.covered and calm)]
                machine = _warned(machine, checks, seen, limits)
            machine = _watched(_proceeded(machine, row, now), now)
    return Step(machine, ROWS[machine.state].orders(machine, now, limits))


def damped(machine: Machine, now: int, word: Word, reason: str) -> Machine:
    """Return the machine in DAMPING; in a state from which no gain may follow, as it was."""
    if machine.state in (State.OFF, State.LINKED, State.DAMPING):
        return machine
    return machine._replace(
        state=State.DAMPING, since=now, word=word, reason=reason, motion=None, wanted=None, warnings=()
    )


def left(machine: Machine, now: int, role: Role = "client") -> Machine:
    """Return the machine after its client, or its last operator, has gone without a word.

    A robot that stands is damped, unless it is to lie down: nobody steers it any more, or nobody can stop it.
    """
    lying = machine.state is State.STAND and machine.wanted and machine.wanted.state is State.RESTING
    if ROWS[machine.state].stands and not lying:
        who = "the program that moves the robot" if role == "client" else "the operator's program"
        return damped(machine, now, role, f"{who} has gone")
    return machine


class Conditions(NamedTuple):
    """What the link says that a robot must fulfil before it is armed.

    Attributes:
        unit: whether the unit of the robot's clock is known.
        refusal: a sentence if it has none.
        loopback: whether it is a twin on this machine, which needs no remote control.
    """

    unit: bool
    refusal: str | None
    loopback: bool


def unready(machine: Machine, conditions: Conditions, limits: Limits) -> str | None:
    """Return a sentence about why a robot must not be armed, or None."""
    memory = machine.memory
    reading = memory.reading
    if reading is None or memory.now - memory.fresh >= limits.silence:
        return "no state comes from the robot; check that it is on, its address, and the cable"
    if memory.bad:
        return "the robot's states have numbers that cannot be; switch it off and on"
    if conditions.refusal:
        return conditions.refusal
    if not conditions.unit:
        return "the robot's clock is still being measured; ask again in a second"
    seen = _seen(machine, memory.now, 0)
    for check in (limit.MOTOR, limit.WARMTH, limit.BUTTON):
        if sentence := check.find(limits, seen):
            return sentence
    if memory.pose is None or memory.now - memory.still < limits.still_time:
        return (
            f"joints move by more than {limits.still:g} rad/s; "
            "end the factory's controller, and let the robot hang or lie"
        )
    if not (conditions.loopback or remote.seen(reading.remote)):
        return "no remote control is on; switch it on, and keep it at hand"
    return None


def connected(machine: Machine, now: int) -> Machine:
    """Return the machine after the operator's first consent: packets without gains may go out."""
    if machine.state is not State.OFF:
        return machine
    return Machine(State.LINKED, now, memory=Memory(now=now))


def disconnected(machine: Machine, now: int) -> Machine:
    """Return the machine that sends nothing any more, after a connection that found no robot."""
    return Machine(State.OFF, now, memory=Memory(now=now)) if machine.state is State.LINKED else machine


def armed(machine: Machine, now: int) -> Machine:
    """Return the machine after the operator's second consent; the caller has asked :func:`unready`."""
    if machine.state is not State.LINKED:
        return machine
    reading = machine.memory.reading
    there = reading is not None and remote.seen(reading.remote)
    return machine._replace(
        state=State.ARMED, since=now, word=None, reason=None, remote=now if there else None
    )


def reset(machine: Machine, now: int) -> Machine:
    """Return the machine after the operator's word that a damped robot lies; it must be armed anew."""
    if machine.state is not State.DAMPING:
        return machine
    return Machine(State.LINKED, now, memory=Memory(now=now))


def request(
    machine: Machine, do: str, role: Role | None, reason: str | None, limits: Limits
) -> tuple[Machine, str | None]:
    """Return the machine after a request for a motion, and a sentence if it is refused.

    Requests are those of :data:`BEGINNINGS`, and halt, lie and damp. One that asks for what is so already changes
    nothing and is not refused.
    """
    now = machine.memory.now
    if do in BEGINNINGS:
        return _begun(machine, do, limits)
    word: Word | None = None if role == "client" else "operator"
    who = "the program that moves the robot" if role == "client" else "the operator"
    if do == "damp":
        sentence = reason or f"{who} asked for it"
        return damped(machine, now, word or "client", sentence), None
    if machine.state is State.DAMPING:
        return machine, f"the robot is damped ({machine.reason}); only an operator's reset leaves that"
    return stopped(machine, do == "lie", word, word and (reason or f"{who} asked the robot to {do}")), None


def stopped(
    machine: Machine, lie: bool, word: Word | None, reason: str | None, *, now_: bool = False
) -> Machine:
    """Return the machine that brings the robot to a stand, or further down to rest.

    Args:
        machine: in any state; where the robot lies, nothing changes.
        lie: whether it lies down then.
        word: why, where it is not the client's own will.
        reason: the same in a sentence.
        now_: whether a client has no time to come to a stop.
    """
    now = machine.memory.now
    if ROWS[machine.state].client:
        end = State.RESTING if lie else State.STAND
        if machine.wanted and machine.wanted.state is State.RESTING:
            end = State.RESTING
        if word and not now_:
            if machine.wanted:
                return machine._replace(wanted=machine.wanted._replace(state=end))
            return machine._replace(wanted=Wanted(end, now, word, reason))
        return _halted(machine, end, word, reason)
    if not lie or machine.state not in (State.STANDING_UP, State.STAND):
        return machine
    if word:
        machine = machine._replace(word=word, reason=reason)
    if machine.state is State.STAND:  # it may still be settling
        return machine._replace(wanted=Wanted(State.RESTING, now, machine.word, machine.reason))
    return _lying(machine, now)


def _begun(machine: Machine, do: str, limits: Limits) -> tuple[Machine, str | None]:
    """Return the machine after a client's request for a motion."""
    origins, state = BEGINNINGS[do]
    if machine.state is state or (ROWS[state].then is machine.state and not machine.wanted):
        return machine, None
    if machine.state not in origins or machine.wanted:
        return machine, (
            f"the robot is in {machine.state}; {do} begins in {' or '.join(sorted(origins))}"
            + (" and not while it is to lie down" if machine.wanted else "")
        )
    memory, now = machine.memory, machine.memory.now
    reading = memory.reading
    if reading is None or now - memory.fresh >= limits.bridged:
        return machine, "no new state comes from the robot; wait, or check the cable"
    if machine.remote is not None and (lost := remote.lost(now - machine.remote)):
        return machine, lost
    seen = _seen(machine._replace(motion=None), now, 0)._replace(client=0)
    for check in (*ROWS[state].checks, limit.WARMTH):
        if sentence := check.find(limits, seen):
            return machine, sentence
    begun = machine._replace(state=state, since=now, word=None, reason=None)
    if ROWS[state].client:
        # The stand goes on until the client's first orders.
        kept = machine.followed
        return begun._replace(followed=Followed(None, now, 0, kept.clipped, kept.unusable)), None
    return begun._replace(motion=moves.standing_up(reading.q, now)), None


def _halted(machine: Machine, end: State, word: Word | None, reason: str | None) -> Machine:
    """Return the machine in STAND, with a motion that catches the walk."""
    memory = machine.memory
    assert memory.reading is not None
    wanted = machine.wanted
    if wanted and word is None:
        word, reason = wanted.word, wanted.reason
    motion = machine.motion
    if machine.followed.orders is not None or motion is None:
        motion = moves.catching(memory.reading.q, memory.reading.tau, memory.now)
    ahead = Wanted(State.RESTING, memory.now, word, reason) if end is State.RESTING else None
    return machine._replace(
        state=State.STAND, since=memory.now, word=word, reason=reason, motion=motion, wanted=ahead
    )


def _lying(machine: Machine, now: int) -> Machine:
    """Return the machine in LYING_DOWN, from where the joints are held."""
    assert machine.motion is not None
    q, _ = moves.desired(machine.motion, now)
    return machine._replace(state=State.LYING_DOWN, since=now, motion=moves.lying_down(q, now), wanted=None)


def _proceeded(machine: Machine, row: Row, now: int) -> Machine:
    """Return the machine after what happens by itself: the end of a motion, and of a client's time to stop."""
    wanted = machine.wanted
    if row.client:
        if wanted and now - wanted.since >= RAMP:
            return _halted(machine, wanted.state, wanted.word, wanted.reason)
        return machine
    if machine.motion is None or not moves.done(machine.motion, now):
        return machine
    if row.then is not None:
        stays = machine.motion if ROWS[row.then].stands else None
        return machine._replace(state=row.then, since=now, motion=stays)
    return _lying(machine, now) if wanted else machine


def _watched(machine: Machine, now: int) -> Machine:
    """Return the machine after a look at the remote: without one nobody can stop the robot by hand, so it lies down."""
    reading = machine.memory.reading
    if machine.remote is None or reading is None:
        return machine
    if remote.seen(reading.remote):
        return machine._replace(remote=now)
    lost = remote.lost(now - machine.remote)
    if not lost or machine.wanted or not ROWS[machine.state].stands:
        return machine
    return stopped(machine, True, "operator", lost)


def _remembered(machine: Machine, inputs: Inputs, limits: Limits) -> Memory:
    """Return the memory after a round."""
    memory, (reading, bad, calm), now = machine.memory, inputs.arrival, inputs.now
    if reading is None:
        return memory._replace(now=now, bad=memory.bad + bad)
    watts = limit.power(reading)
    strong = strained = _NEVER
    if not calm:
        tau = np.abs(reading.tau)
        strong = np.where(tau > limits.torque, memory.strong + 1, 0)
        strained = np.where(tau > limits.strain, memory.strained + 1, 0)
    pose, still = memory.pose, memory.still
    # Only what LINKED leads to asks whether the robot is still.
    if machine.state is State.LINKED and (
        pose is None or np.abs(reading.q - pose).max() > limits.still * limits.still_time / limit.SECOND
    ):
        pose, still = reading.q, now
    return Memory(
        now=now,
        reading=reading,
        fresh=now,
        bad=0,
        power=limit.powered(limits, memory.power, watts),
        strong=strong,
        strained=strained,
        pose=pose,
        still=still,
    )


_NEVER = np.zeros(MOTORS, dtype=np.int64)


def _obeyed(machine: Machine, inputs: Inputs, limits: Limits) -> Followed:
    """Return what a client has ordered after a round."""
    followed = machine.followed
    dropped = inputs.dropped
    if isinstance(inputs.orders, Command) and limit.allowed(limits, inputs.orders):
        return Followed(inputs.orders, inputs.now, 0, followed.clipped, followed.unusable + dropped)
    if inputs.orders is not None:
        usable = limit.clipped(limits, _decoded(inputs.orders))
        if usable:
            within, beyond = usable
            return Followed(within, inputs.now, 0, followed.clipped + beyond, followed.unusable + dropped)
        dropped += 1
    if dropped:
        followed = followed._replace(dropped=followed.dropped + dropped, unusable=followed.unusable + dropped)
    bridged = inputs.arrival.reading is not None and inputs.now - machine.memory.fresh >= limits.bridged
    if bridged and not followed.excused:
        # It has had no state to answer. Its silence counts anew, but once: states that go on being late excuse nobody.
        followed = followed._replace(at=inputs.now, excused=True)
    return followed


def _seen(machine: Machine, now: int, late: int) -> Seen:
    """Return what the checks look at."""
    memory = machine.memory
    assert memory.reading is not None
    row = ROWS[machine.state]
    motion = machine.motion
    return Seen(
        reading=memory.reading,
        desired=None if motion is None or row.client else moves.desired(motion, now)[0],
        link=_rounds(now - memory.fresh),
        bad=memory.bad,
        client=_rounds(now - machine.followed.at) if row.client else 0,
        late=late,
        power=memory.power,
        strong=memory.strong,
        strained=memory.strained,
    )


def _rounds(silence: int) -> int:
    """Return a silence in whole rounds [ns]: rounds begin some µs early or late, and ten of them are 20 ms."""
    return (silence + limit.ROUND // 2) // limit.ROUND * limit.ROUND


def _warned(machine: Machine, checks: list[Check], seen: Seen, limits: Limits) -> Machine:
    """Return the machine with the warnings that hold, of those that may."""
    found = tuple((check.name, sentence) for check in checks if (sentence := check.find(limits, seen)))
    return machine._replace(warnings=found) if found or machine.warnings else machine
