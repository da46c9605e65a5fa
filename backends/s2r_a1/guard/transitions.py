"""Transitions of the guard's state machine: by consents, by requests for a motion, and by an early end."""

from __future__ import annotations

from typing import NamedTuple

from s2r_a1 import remote
from s2r_a1.guard import checks, moves, states
from s2r_a1.guard.control import Role
from s2r_a1.guard.limits import Limits, Word
from s2r_a1.guard.states import Machine, State


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
    if states.RULES[machine.state].stands and not lying:
        who = "the program that moves the robot" if role == "client" else "the operator's program"
        return damp(machine, now, role, f"{who} has disconnected")
    return machine


class Conditions(NamedTuple):
    """Conditions of the link for arming a robot: whether the unit of its clock is known, or why not.

    A robot on ``loopback`` is a twin, which needs no remote control.
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
    checked = states.checked_quantities(machine, memory.now, 0)
    for check in (checks.MOTOR, checks.WARMTH, checks.BUTTON):
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
    return _begin_again(machine, State.OFF, State.LINKED, now)


def disconnect(machine: Machine, now: int) -> Machine:
    """Return the machine that sends nothing, after a connection that found no robot."""
    return _begin_again(machine, State.LINKED, State.OFF, now)


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
    return _begin_again(machine, State.DAMPING, State.LINKED, now)


def _begin_again(machine: Machine, before: State, after: State, now: int) -> Machine:
    """Return a machine without a memory in ``after``; unchanged unless it is in ``before``."""
    return Machine(after, now, memory=states.GuardMemory(now=now)) if machine.state is before else machine


def request(
    machine: Machine, do: str, role: Role | None, reason: str | None, limits: Limits
) -> tuple[Machine, str | None]:
    """Return the machine after a request for a motion, and a message if it is refused.

    Requests are the keys of :data:`BEGINNINGS`, and halt, lie and damp. A request for the present state changes nothing
    and is not refused.
    """
    now = machine.memory.now
    if do in states.BEGINNINGS:
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
    machine: Machine, lie: bool, word: Word | None, reason: str | None, *, at_once: bool = False
) -> Machine:
    """Return the machine that brings the robot to a stand, or to rest if it is to ``lie``; unchanged if it lies.

    ``word`` and ``reason`` are the cause of the stop; None if the client requested it. A stop ``at_once`` gives the
    client no time.
    """
    now = machine.memory.now
    if states.RULES[machine.state].client:
        end = State.RESTING if lie else State.STAND
        if machine.wanted and machine.wanted.state is State.RESTING:
            end = State.RESTING
        if word and not at_once:
            if machine.wanted:
                return machine._replace(wanted=machine.wanted._replace(state=end))
            return machine._replace(wanted=states.RequestedStop(end, now, word, reason))
        return halt(machine, end, word, reason)
    if not lie or machine.state not in (State.STANDING_UP, State.STAND):
        return machine
    if word:
        machine = machine._replace(word=word, reason=reason)
    if machine.state is State.STAND:  # it may still be settling
        return machine._replace(wanted=states.RequestedStop(State.RESTING, now, machine.word, machine.reason))
    return lie_down(machine, now)


def _begin(machine: Machine, do: str, limits: Limits) -> tuple[Machine, str | None]:
    """Return the machine after a client's request for a motion."""
    origins, state = states.BEGINNINGS[do]
    if machine.state is state or (states.RULES[state].then is machine.state and not machine.wanted):
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
    checked = states.checked_quantities(machine._replace(motion=None), now, 0)._replace(client=0)
    for check in (*states.RULES[state].checks, checks.WARMTH):
        if sentence := check.find(limits, checked):
            return machine, sentence
    begun = machine._replace(state=state, since=now, word=None, reason=None)
    if states.RULES[state].client:
        # The stand continues until the client's first commands.
        kept = machine.followed
        return begun._replace(followed=states.ClientCommands(None, now, 0, kept.clipped, kept.unusable)), None
    return begun._replace(motion=moves.standing_up(reading.q, now)), None


def halt(machine: Machine, end: State, word: Word | None, reason: str | None) -> Machine:
    """Return the machine in STAND, with a motion that catches the walk."""
    memory = machine.memory
    assert memory.reading is not None
    wanted = machine.wanted
    if wanted and word is None:
        word, reason = wanted.word, wanted.reason
    motion = machine.motion
    if machine.followed.orders is not None or motion is None:
        motion = moves.catch(memory.reading.q, memory.reading.tau, memory.now)
    ahead = states.RequestedStop(State.RESTING, memory.now, word, reason) if end is State.RESTING else None
    return machine._replace(
        state=State.STAND, since=memory.now, word=word, reason=reason, motion=motion, wanted=ahead
    )


def lie_down(machine: Machine, now: int) -> Machine:
    """Return the machine in LYING_DOWN, from the present reference angles."""
    assert machine.motion is not None
    q, _ = moves.desired_state(machine.motion, now)
    return machine._replace(state=State.LYING_DOWN, since=now, motion=moves.lying_down(q, now), wanted=None)
