"""The states of the guard: what each may send, which limits end it, and where it leads.

The state of a guard is a value, a :class:`Machine`. :mod:`s2r_a1.guard.step` maps it and the inputs of a round to the
next one and the commands to send; :mod:`s2r_a1.guard.transitions` handles requests.

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
from functools import partial
from typing import NamedTuple

import numpy as np

from s2r_a1.guard import checks, moves
from s2r_a1.guard.checks import CheckedQuantities, LimitCheck
from s2r_a1.guard.limits import MS, ROUND, Limits, Word
from s2r_a1.guard.moves import PoseMotion
from s2r_a1.wire import MOTORS, FloatArray, IntArray, MotorPacket, Orders, Reading

RAMP = 1500 * MS
"""A budget [ns]: time for a client to stop on request; then the guard halts."""
SINKING = 1000 * MS
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
    """The states that arrived in a round, as :func:`s2r_a1.guard.step.judge_arrival` judges them.

    Attributes:
        reading: newest valid reading; None if there is none.
        bad: whether an impossible reading arrived, and no valid one.
        calm: whether the reading is far from every limit.
    """

    reading: Reading | None = None
    bad: bool = False
    calm: bool = False


class Inputs(NamedTuple):
    """The inputs of a round: its time, the robot's states, and the client's commands.

    ``orders`` is None if none could be decoded; ``dropped`` counts packets that could not be.
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


def _limp(machine: Machine, now: int, limits: Limits) -> Orders:
    return moves.LIMP


def _damped(machine: Machine, now: int, limits: Limits) -> Orders:
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
        return decode(orders)._replace(tau=moves.ZERO)
    return orders


def decode(orders: Orders | MotorPacket) -> Orders:
    """Return commands as numbers in the units of :class:`Orders`."""
    return orders.orders() if isinstance(orders, MotorPacket) else orders


# The guard's own pause comes first, because the robot's own rule for silence has acted during it. A fall comes before
# a broken link in the same round.
_ROBOT = (checks.HELD_UP, checks.TILT, checks.MOTOR, checks.HEAT, checks.TORQUE, checks.POWER)
_VOID = (checks.LINK, checks.NUMBERS, checks.BUTTON)
_LIES = (checks.MOTOR, checks.ABSENT, checks.NUMBERS, checks.BUTTON)
_moving = partial(StateRules, warnings=(checks.WARMTH, checks.STRAIN))
_led = partial(_moving, orders=_client_orders, client=True, stands=True)
_led_on_the_ground = _led((*_ROBOT, checks.HEIGHT, checks.JOINT, *_VOID, checks.CLIENT))

RULES: dict[State, StateRules] = {
    State.OFF: StateRules((), lambda machine, now, limits: None),
    State.LINKED: StateRules((), _limp),
    State.ARMED: StateRules(_LIES, _limp),
    State.STANDING_UP: _moving(
        (*_ROBOT, checks.DEVIATION, *_VOID), _own_orders, State.STAND, stands=True, moves=True
    ),
    State.STAND: _moving(
        (*_ROBOT, checks.HEIGHT, checks.JOINT, checks.DEVIATION, *_VOID), _own_orders, stands=True
    ),
    State.WALK: _led_on_the_ground,
    State.EXCITE: _led_on_the_ground,
    # In a rig the legs' geometry says nothing about the height, and legs without torque swing to their stops. A base
    # that tilts has come loose. Angles of the client's commands stay within the joints' range.
    State.EXCITE_HELD: _led((*_ROBOT, *_VOID, checks.CLIENT)),
    State.LYING_DOWN: _moving((*_ROBOT, checks.DEVIATION, *_VOID), _own_orders, State.RESTING, moves=True),
    State.RESTING: StateRules(_LIES, _damped),
    State.DAMPING: StateRules((), _damped),
}
"""A definition: the table of states."""

BEGINNINGS: dict[str, tuple[frozenset[State], State]] = {
    "stand": (frozenset({State.ARMED, State.RESTING}), State.STANDING_UP),
    "walk": (frozenset({State.STAND}), State.WALK),
    "excite": (frozenset({State.STAND}), State.EXCITE),
    "excite_held": (frozenset({State.STAND}), State.EXCITE_HELD),
}
"""A definition: request of a client → the states in which it is allowed, and the state that it leads to."""


def checked_quantities(machine: Machine, now: int, late: int) -> CheckedQuantities:
    """Return the quantities that the checks judge, in a round that began ``late`` [ns] after the last one."""
    memory, row, motion = machine.memory, RULES[machine.state], machine.motion
    assert memory.reading is not None
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
    return (silence + ROUND // 2) // ROUND * ROUND
