"""The guard's state machine, in pure functions: it decides the robot's commands, and when the robot must be damped.

Data of a round: the newest reading, a client's commands, requests. State: a :class:`Machine`, a value. :func:`step`
maps machine and inputs of a round to the next machine and the commands to send. :func:`request` handles requests.

    OFF → (connect) LINKED → (arm) ARMED → (stand) STANDING_UP → STAND → (walk) WALK → (halt) STAND
    STAND → (lie) LYING_DOWN → RESTING → (stand) STANDING_UP …
    STAND → (excite, excite_held) EXCITE, EXCITE_HELD → (halt) STAND: a protocol, on the ground or held in a rig
    from ARMED on, by any limit of the state: DAMPING → (reset) LINKED

OFF sends nothing. LINKED and ARMED send no gains and no torques. DAMPING is latched: only an operator's ``reset`` ends
it, and then the robot must be armed again. Each state has a row in :data:`RULES`. A new motion of a client needs a
member of :class:`State`, a row, and its request in :data:`BEGINNINGS`.

Times are whole nanoseconds of the guard's clock, which counts rounds in lock step.
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
from s2r_a1.guard.limits import CheckedQuantities, IntArray, LimitCheck, Limits, Word
from s2r_a1.guard.moves import PoseMotion
from s2r_a1.wire import MOTORS, MotorPacket, Orders, Reading

FloatArray = NDArray[np.float64]

RAMP = 1500 * limit.MS
"""A budget [ns]: time for a client to stop on request; then the guard halts."""
SINKING = 1000 * limit.MS
"""A budget [ns]: shortest time of damping, so that a reset does not drop the robot."""


class State(StrEnum):
    """The states of the guard."""

    OFF = "OFF"
    LINKED = "LINKED"
    ARMED = "ARMED"
    STANDING_UP = "STANDING_UP"
    STAND = "STAND"
    WALK = "WALK"
    EXCITE = "EXCITE"
    EXCITE_HELD = "EXCITE_HELD"
    LYING_DOWN = "LYING_DOWN"
    RESTING = "RESTING"
    DAMPING = "DAMPING"


class GuardMemory(NamedTuple):
    """The memory of past rounds.

    Attributes:
        now: time of the last round.
        reading: newest valid reading.
        fresh: time of its arrival.
        bad: number of impossible readings in a row.
        power: the vendor's count of power.
        strong: (12,) number of readings in a row above the torque limit.
        strained: (12,) number of readings in a row above the torque of a warning.
        pose: (12,) angles [rad] from which no joint has moved.
        still: time since which no joint has moved.
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


class ClientCommands(NamedTuple):
    """The commands of a client.

    Attributes:
        orders: newest valid commands, within the limits; None before the first.
        at: time of their arrival; before the first, the beginning of the client's motion.
        dropped: packets since then that were not valid.
        clipped: numbers in all its commands that were beyond a limit.
        unusable: packets that were not valid, in total.
        excused: whether its silence was restarted since the newest commands, because the robot's states were late.
    """

    orders: Orders | MotorPacket | None = None
    at: int = 0
    dropped: int = 0
    clipped: int = 0
    unusable: int = 0
    excused: bool = False


class RequestedStop(NamedTuple):
    """A requested stop while a client moves the robot: STAND, or RESTING after STAND."""

    state: State
    since: int
    word: Word | None
    reason: str | None


class Machine(NamedTuple):
    """The complete state of a guard, a value.

    Attributes:
        state: state of the state machine.
        since: time of its beginning.
        word: cause of the robot's stop, else None.
        reason: the same as a sentence.
        motion: the guard's own motion, or its last one before a client's.
        wanted: requested stop.
        warnings: active warnings, (name of the check, sentence).
        remote: time at which a remote control was last on; None if none was on when the robot was armed.
    """

    state: State = State.OFF
    since: int = 0
    word: Word | None = None
    reason: str | None = None
    motion: PoseMotion | None = None
    wanted: RequestedStop | None = None
    memory: GuardMemory = GuardMemory()
    followed: ClientCommands = ClientCommands()
    warnings: tuple[tuple[str, str], ...] = ()
    remote: int | None = None


class Arrival(NamedTuple):
    """The states that arrived in a round, as :func:`judge_arrival` judges them.

    Attributes:
        reading: newest valid reading; None if there is none.
        bad: whether an impossible reading arrived, and no valid one.
        calm: whether the reading is far from every limit.
    """

    reading: Reading | None = None
    bad: bool = False
    calm: bool = False


class Inputs(NamedTuple):
    """The inputs of a round.

    Attributes:
        now: time of the round.
        arrival: arrived states of the robot.
        orders: the client's commands; None if none could be decoded.
        dropped: number of the client's packets that could not be decoded.
    """

    now: int
    arrival: Arrival = Arrival()
    orders: Orders | MotorPacket | None = None
    dropped: int = 0


class RoundResult(NamedTuple):
    """The result of a round; orders are None if nothing may be sent."""

    machine: Machine
    orders: Orders | MotorPacket | None


class StateRules(NamedTuple):
    """The rules of a state.

    Attributes:
        checks: limits, in order of precedence of their words; each leads to DAMPING.
        orders: returns the commands to send.
        then: state after the end of the guard's own motion.
        client: whether a client's commands move the robot.
        stands: whether the robot is damped when its client leaves.
        moves: whether the robot may move without a client, so that rounds go on.
        warnings: checks that only warn.
    """

    checks: tuple[LimitCheck, ...]
    orders: Callable[[Machine, int, Limits], Orders | MotorPacket | None]
    then: State | None = None
    client: bool = False
    stands: bool = False
    moves: bool = False
    warnings: tuple[LimitCheck, ...] = ()


def _no_orders(machine: Machine, now: int, limits: Limits) -> None:
    return None


def _limp(machine: Machine, now: int, limits: Limits) -> Orders:
    return moves.LIMP


def _damping_orders(machine: Machine, now: int, limits: Limits) -> Orders:
    return moves.DAMPED


def _own_orders(machine: Machine, now: int, limits: Limits) -> Orders:
    assert machine.motion is not None
    return moves.orders(machine.motion, now)


def _client_orders(machine: Machine, now: int, limits: Limits) -> Orders | MotorPacket:
    """Return the client's commands; without their torques if they or the robot's states are old."""
    orders, at, dropped = machine.followed[:3]
    if orders is None:
        return _own_orders(machine, now, limits)
    if max(now - at, now - machine.memory.fresh) >= limits.bridged or dropped >= limits.dropped:
        return _decode(orders)._replace(tau=moves.ZERO)
    return orders


def _decode(orders: Orders | MotorPacket) -> Orders:
    return orders.orders() if isinstance(orders, MotorPacket) else orders


# The guard's own pause comes first, because the robot's own rule for silence has acted during it. A fall comes before
# a broken link in the same round.
_ROBOT = (limit.HELD_UP, limit.TILT, limit.MOTOR, limit.HEAT, limit.TORQUE, limit.POWER)
_VOID = (limit.LINK, limit.NUMBERS, limit.BUTTON)
_LIES = (limit.MOTOR, limit.ABSENT, limit.NUMBERS, limit.BUTTON)
_WARNINGS = (limit.WARMTH, limit.STRAIN)

RULES: dict[State, StateRules] = {
    State.OFF: StateRules((), _no_orders),
    State.LINKED: StateRules((), _limp),
    State.ARMED: StateRules(_LIES, _limp),
    State.STANDING_UP: StateRules(
        (*_ROBOT, limit.DEVIATION, *_VOID),
        _own_orders,
        State.STAND,
        stands=True,
        moves=True,
        warnings=_WARNINGS,
    ),
    State.STAND: StateRules(
        (*_ROBOT, limit.HEIGHT, limit.JOINT, limit.DEVIATION, *_VOID),
        _own_orders,
        stands=True,
        warnings=_WARNINGS,
    ),
    State.WALK: StateRules(
        (*_ROBOT, limit.HEIGHT, limit.JOINT, *_VOID, limit.CLIENT),
        _client_orders,
        client=True,
        stands=True,
        warnings=_WARNINGS,
    ),
    State.EXCITE: StateRules(
        (*_ROBOT, limit.HEIGHT, limit.JOINT, *_VOID, limit.CLIENT),
        _client_orders,
        client=True,
        stands=True,
        warnings=_WARNINGS,
    ),
    # In a rig the legs' geometry says nothing about the height, and legs without torque swing to their stops. A base
    # that tilts has come loose. Angles of the client's commands stay within the joints' range.
    State.EXCITE_HELD: StateRules(
        (*_ROBOT, *_VOID, limit.CLIENT), _client_orders, client=True, stands=True, warnings=_WARNINGS
    ),
    State.LYING_DOWN: StateRules(
        (*_ROBOT, limit.DEVIATION, *_VOID), _own_orders, State.RESTING, moves=True, warnings=_WARNINGS
    ),
    State.RESTING: StateRules(_LIES, _damping_orders),
    State.DAMPING: StateRules((), _damping_orders),
}
"""A definition: the table of states."""

BEGINNINGS: dict[str, tuple[frozenset[State], State]] = {
    "stand": (frozenset({State.ARMED, State.RESTING}), State.STANDING_UP),
    "walk": (frozenset({State.STAND}), State.WALK),
    "excite": (frozenset({State.STAND}), State.EXCITE),
    "excite_held": (frozenset({State.STAND}), State.EXCITE_HELD),
}
"""A definition: request of a client → the states in which it is allowed, and the state that it leads to."""


def judge_arrival(limits: Limits, reading: Reading | None, fault: str | None) -> Arrival:
    """Judge the reading of a round.

    Args:
        limits: limits of possible readings.
        reading: reading of the link; None if there is none.
        fault: fault of the link if there is no reading.
    """
    if reading is None:
        return Arrival(bad=fault == "number")
    if limit.is_calm(limits, reading):
        return Arrival(reading, calm=True)
    return Arrival(bad=True) if limit.impossibility(limits, reading) else Arrival(reading)


def step(machine: Machine, inputs: Inputs, limits: Limits) -> RoundResult:
    """Return the next machine and the commands of a round."""
    row = RULES[machine.state]
    now, late = inputs.now, inputs.now - machine.memory.now
    memory = _remember(machine, inputs, limits)
    followed = _obey(machine, inputs, limits) if row.client else machine.followed
    machine = machine._replace(memory=memory, followed=followed)
    if row.checks:
        checked = _checked_quantities(machine, now, late)
        new, calm = inputs.arrival.reading is not None, inputs.arrival.calm
        for check in row.checks:
            if (check.measures and not new) or (check.covered and calm):
                continue
            if sentence := check.find(limits, checked):
                machine = damp(machine, now, check.word, sentence)
                break
        else:
            if new:
                checks = [check for check in row.warnings if not (check.covered and calm)]
                machine = _warn(machine, checks, checked, limits)
            machine = _watch_remote(_proceed(machine, row, now), now)
    return RoundResult(machine, RULES[machine.state].orders(machine, now, limits))


def damp(machine: Machine, now: int, word: Word, reason: str) -> Machine:
    """Return the machine in DAMPING; unchanged in a state that may send no gains."""
    if machine.state in (State.OFF, State.LINKED, State.DAMPING):
        return machine
    return machine._replace(
        state=State.DAMPING, since=now, word=word, reason=reason, motion=None, wanted=None, warnings=()
    )


def leave(machine: Machine, now: int, role: Role = "client") -> Machine:
    """Return the machine after its client or its last operator has disconnected.

    A standing robot that is not about to lie down is damped, because nobody controls it or can stop it.
    """
    lying = machine.state is State.STAND and machine.wanted and machine.wanted.state is State.RESTING
    if RULES[machine.state].stands and not lying:
        who = "the program that moves the robot" if role == "client" else "the operator's program"
        return damp(machine, now, role, f"{who} has disconnected")
    return machine


class Conditions(NamedTuple):
    """Conditions of the link for arming a robot.

    Attributes:
        unit: whether the unit of the robot's clock is known.
        refusal: a message if the clock has no known unit.
        loopback: whether the robot is a twin on this computer, which needs no remote control.
    """

    unit: bool
    refusal: str | None
    loopback: bool


def unready(machine: Machine, conditions: Conditions, limits: Limits) -> str | None:
    """Return the reason why a robot must not be armed, or None."""
    memory = machine.memory
    reading = memory.reading
    if reading is None or memory.now - memory.fresh >= limits.silence:
        return "the robot sends no states; check that it is on, its address, and the cable"
    if memory.bad:
        return "the robot's states have impossible numbers; switch it off and on"
    if conditions.refusal:
        return conditions.refusal
    if not conditions.unit:
        return "the guard is still measuring the robot's clock; try again in a second"
    checked = _checked_quantities(machine, memory.now, 0)
    for check in (limit.MOTOR, limit.WARMTH, limit.BUTTON):
        if sentence := check.find(limits, checked):
            return sentence
    if memory.pose is None or memory.now - memory.still < limits.still_time:
        return (
            f"joints move by more than {limits.still:g} rad/s; "
            "end the factory's controller, and let the robot hang or lie"
        )
    if not (conditions.loopback or remote.is_on(reading.remote)):
        return "no remote control is on; switch it on, and keep it at hand"
    return None


def connect(machine: Machine, now: int) -> Machine:
    """Return the machine after the operator's first consent: packets without gains may be sent."""
    if machine.state is not State.OFF:
        return machine
    return Machine(State.LINKED, now, memory=GuardMemory(now=now))


def disconnect(machine: Machine, now: int) -> Machine:
    """Return the machine that sends nothing, after a connection that found no robot."""
    return Machine(State.OFF, now, memory=GuardMemory(now=now)) if machine.state is State.LINKED else machine


def arm(machine: Machine, now: int) -> Machine:
    """Return the machine after the operator's second consent; the caller has checked :func:`unready`."""
    if machine.state is not State.LINKED:
        return machine
    reading = machine.memory.reading
    there = reading is not None and remote.is_on(reading.remote)
    return machine._replace(
        state=State.ARMED, since=now, word=None, reason=None, remote=now if there else None
    )


def reset(machine: Machine, now: int) -> Machine:
    """Return the machine after the operator's statement that a damped robot lies; it must be armed again."""
    if machine.state is not State.DAMPING:
        return machine
    return Machine(State.LINKED, now, memory=GuardMemory(now=now))


def request(
    machine: Machine, do: str, role: Role | None, reason: str | None, limits: Limits
) -> tuple[Machine, str | None]:
    """Return the machine after a request for a motion, and a message if it is refused.

    Requests are the keys of :data:`BEGINNINGS`, and halt, lie and damp. A request for the present state changes nothing
    and is not refused.
    """
    now = machine.memory.now
    if do in BEGINNINGS:
        return _begin(machine, do, limits)
    word: Word | None = None if role == "client" else "operator"
    who = "the program that moves the robot" if role == "client" else "the operator"
    if do == "damp":
        sentence = reason or f"{who} asked for it"
        return damp(machine, now, word or "client", sentence), None
    if machine.state is State.DAMPING:
        return machine, f"the robot is damped ({machine.reason}); only an operator's reset ends that"
    return stop(machine, do == "lie", word, word and (reason or f"{who} asked the robot to {do}")), None


def stop(
    machine: Machine, lie: bool, word: Word | None, reason: str | None, *, now_: bool = False
) -> Machine:
    """Return the machine that brings the robot to a stand, or to rest.

    Args:
        machine: the machine in any state; nothing changes if the robot lies.
        lie: whether the robot then lies down.
        word: cause of the stop; None if the client requested it.
        reason: the same as a sentence.
        now_: whether to stop at once, without time for the client.
    """
    now = machine.memory.now
    if RULES[machine.state].client:
        end = State.RESTING if lie else State.STAND
        if machine.wanted and machine.wanted.state is State.RESTING:
            end = State.RESTING
        if word and not now_:
            if machine.wanted:
                return machine._replace(wanted=machine.wanted._replace(state=end))
            return machine._replace(wanted=RequestedStop(end, now, word, reason))
        return _halt(machine, end, word, reason)
    if not lie or machine.state not in (State.STANDING_UP, State.STAND):
        return machine
    if word:
        machine = machine._replace(word=word, reason=reason)
    if machine.state is State.STAND:  # it may still be settling
        return machine._replace(wanted=RequestedStop(State.RESTING, now, machine.word, machine.reason))
    return _lie_down(machine, now)


def _begin(machine: Machine, do: str, limits: Limits) -> tuple[Machine, str | None]:
    """Return the machine after a client's request for a motion."""
    origins, state = BEGINNINGS[do]
    if machine.state is state or (RULES[state].then is machine.state and not machine.wanted):
        return machine, None
    if machine.state not in origins or machine.wanted:
        return machine, (
            f"the robot is in {machine.state}; {do} begins in {' or '.join(sorted(origins))}"
            + (" and not while it is to lie down" if machine.wanted else "")
        )
    memory, now = machine.memory, machine.memory.now
    reading = memory.reading
    if reading is None or now - memory.fresh >= limits.bridged:
        return machine, "the robot sends no new state; wait, or check the cable"
    if machine.remote is not None and (lost := remote.loss(now - machine.remote)):
        return machine, lost
    checked = _checked_quantities(machine._replace(motion=None), now, 0)._replace(client=0)
    for check in (*RULES[state].checks, limit.WARMTH):
        if sentence := check.find(limits, checked):
            return machine, sentence
    begun = machine._replace(state=state, since=now, word=None, reason=None)
    if RULES[state].client:
        # The stand continues until the client's first commands.
        kept = machine.followed
        return begun._replace(followed=ClientCommands(None, now, 0, kept.clipped, kept.unusable)), None
    return begun._replace(motion=moves.standing_up(reading.q, now)), None


def _halt(machine: Machine, end: State, word: Word | None, reason: str | None) -> Machine:
    """Return the machine in STAND, with a motion that catches the walk."""
    memory = machine.memory
    assert memory.reading is not None
    wanted = machine.wanted
    if wanted and word is None:
        word, reason = wanted.word, wanted.reason
    motion = machine.motion
    if machine.followed.orders is not None or motion is None:
        motion = moves.catch(memory.reading.q, memory.reading.tau, memory.now)
    ahead = RequestedStop(State.RESTING, memory.now, word, reason) if end is State.RESTING else None
    return machine._replace(
        state=State.STAND, since=memory.now, word=word, reason=reason, motion=motion, wanted=ahead
    )


def _lie_down(machine: Machine, now: int) -> Machine:
    """Return the machine in LYING_DOWN, from the present reference angles."""
    assert machine.motion is not None
    q, _ = moves.desired_state(machine.motion, now)
    return machine._replace(state=State.LYING_DOWN, since=now, motion=moves.lying_down(q, now), wanted=None)


def _proceed(machine: Machine, row: StateRules, now: int) -> Machine:
    """Return the machine after the end of a motion, or of a client's time to stop."""
    wanted = machine.wanted
    if row.client:
        if wanted and now - wanted.since >= RAMP:
            return _halt(machine, wanted.state, wanted.word, wanted.reason)
        return machine
    if machine.motion is None or not moves.done(machine.motion, now):
        return machine
    if row.then is not None:
        stays = machine.motion if RULES[row.then].stands else None
        return machine._replace(state=row.then, since=now, motion=stays)
    return _lie_down(machine, now) if wanted else machine


def _watch_remote(machine: Machine, now: int) -> Machine:
    """Return the machine after a check of the remote: without it nobody can stop the robot, so the robot lies down."""
    reading = machine.memory.reading
    if machine.remote is None or reading is None:
        return machine
    if remote.is_on(reading.remote):
        return machine._replace(remote=now)
    lost = remote.loss(now - machine.remote)
    if not lost or machine.wanted or not RULES[machine.state].stands:
        return machine
    return stop(machine, True, "operator", lost)


def _remember(machine: Machine, inputs: Inputs, limits: Limits) -> GuardMemory:
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
    # Only arming, from LINKED, needs to know whether the robot is still.
    if machine.state is State.LINKED and (
        pose is None or np.abs(reading.q - pose).max() > limits.still * limits.still_time / limit.SECOND
    ):
        pose, still = reading.q, now
    return GuardMemory(
        now=now,
        reading=reading,
        fresh=now,
        bad=0,
        power=limit.power_count(limits, memory.power, watts),
        strong=strong,
        strained=strained,
        pose=pose,
        still=still,
    )


_NEVER = np.zeros(MOTORS, dtype=np.int64)


def _obey(machine: Machine, inputs: Inputs, limits: Limits) -> ClientCommands:
    """Return the client's commands after a round."""
    followed = machine.followed
    dropped = inputs.dropped
    if isinstance(inputs.orders, MotorPacket) and limit.is_allowed(limits, inputs.orders):
        return ClientCommands(inputs.orders, inputs.now, 0, followed.clipped, followed.unusable + dropped)
    if inputs.orders is not None:
        usable = limit.clip(limits, _decode(inputs.orders))
        if usable:
            within, beyond = usable
            return ClientCommands(
                within, inputs.now, 0, followed.clipped + beyond, followed.unusable + dropped
            )
        dropped += 1
    if dropped:
        followed = followed._replace(dropped=followed.dropped + dropped, unusable=followed.unusable + dropped)
    bridged = inputs.arrival.reading is not None and inputs.now - machine.memory.fresh >= limits.bridged
    if bridged and not followed.excused:
        # The client had no state to answer, so its silence restarts, but only once.
        followed = followed._replace(at=inputs.now, excused=True)
    return followed


def _checked_quantities(machine: Machine, now: int, late: int) -> CheckedQuantities:
    """Return the quantities that the checks judge."""
    memory = machine.memory
    assert memory.reading is not None
    row = RULES[machine.state]
    motion = machine.motion
    return CheckedQuantities(
        reading=memory.reading,
        desired=None if motion is None or row.client else moves.desired_state(motion, now)[0],
        link=_rounds(now - memory.fresh),
        bad=memory.bad,
        client=_rounds(now - machine.followed.at) if row.client else 0,
        late=late,
        power=memory.power,
        strong=memory.strong,
        strained=memory.strained,
    )


def _rounds(silence: int) -> int:
    """Return a silence rounded to whole rounds [ns], because rounds begin some µs early or late."""
    return (silence + limit.ROUND // 2) // limit.ROUND * limit.ROUND


def _warn(machine: Machine, checks: list[LimitCheck], checked: CheckedQuantities, limits: Limits) -> Machine:
    """Return the machine with the active warnings of these checks."""
    warnings = tuple((check.name, sentence) for check in checks if (sentence := check.find(limits, checked)))
    return machine._replace(warnings=warnings) if warnings or machine.warnings else machine
