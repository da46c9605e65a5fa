"""One round of the guard's state machine: what arrived, what the limits say of it, and what is sent.

Pure: :func:`step` maps a :class:`Machine` and the inputs of a round to the next machine and the commands to send.
"""

from __future__ import annotations

import numpy as np

from s2r_a1 import remote
from s2r_a1.guard import checks, moves, states
from s2r_a1.guard.limits import SECOND, Limits
from s2r_a1.guard.states import Machine, State
from s2r_a1.guard.transitions import damp, halt, lie_down, stop
from s2r_a1.wire import MOTORS, MotorPacket, Reading

_NEVER = np.zeros(MOTORS, dtype=np.int64)


def judge_arrival(limits: Limits, reading: Reading | None, fault: str | None) -> states.Arrival:
    """Judge the reading of a round; without one, the ``fault`` of the link says why."""
    if reading is None:
        return states.Arrival(bad=fault == "number")
    if checks.is_calm(limits, reading):
        return states.Arrival(reading, calm=True)
    return states.Arrival(bad=True) if checks.impossibility(limits, reading) else states.Arrival(reading)


def merge(before: states.Arrival, after: states.Arrival) -> states.Arrival:
    """Combine two reads of a round: the newest valid reading, or whether an impossible one arrived."""
    if after.reading is not None:
        return after
    return before if before.reading is not None else after._replace(bad=before.bad or after.bad)


def step(machine: Machine, inputs: states.Inputs, limits: Limits) -> states.RoundResult:
    """Return the next machine and the commands of a round."""
    row = states.RULES[machine.state]
    now, late = inputs.now, inputs.now - machine.memory.now
    memory = _remember(machine, inputs, limits)
    followed = _obey(machine, inputs, limits) if row.client else machine.followed
    machine = machine._replace(memory=memory, followed=followed)
    if row.checks:
        checked = states.checked_quantities(machine, now, late)
        new, calm = inputs.arrival.reading is not None, inputs.arrival.calm
        for check in row.checks:
            if (check.measures and not new) or (check.covered and calm):
                continue
            if sentence := check.find(limits, checked):
                machine = damp(machine, now, check.word, sentence)
                break
        else:
            if new:
                warned = (check for check in row.warnings if not (check.covered and calm))
                found = ((check.name, check.find(limits, checked)) for check in warned)
                warnings = tuple((name, sentence) for name, sentence in found if sentence)
                machine = machine._replace(warnings=warnings)
            machine = _watch_remote(_proceed(machine, row, now), now)
    return states.RoundResult(machine, states.RULES[machine.state].orders(machine, now, limits))


def _proceed(machine: Machine, row: states.StateRules, now: int) -> Machine:
    """Return the machine after the end of a motion, or of a client's time to stop."""
    wanted = machine.wanted
    if row.client:
        if wanted and now - wanted.since >= states.RAMP:
            return halt(machine, wanted.state, wanted.word, wanted.reason)
        return machine
    if machine.motion is None or not moves.done(machine.motion, now):
        return machine
    if row.then is not None:
        stays = machine.motion if states.RULES[row.then].stands else None
        return machine._replace(state=row.then, since=now, motion=stays)
    return lie_down(machine, now) if wanted else machine


def _watch_remote(machine: Machine, now: int) -> Machine:
    """Without a remote nobody can stop the robot, so the robot lies down."""
    reading = machine.memory.reading
    if machine.remote is None or reading is None:
        return machine
    if remote.is_on(reading.remote):
        return machine._replace(remote=now)
    lost = remote.loss(now - machine.remote)
    if not lost or machine.wanted or not states.RULES[machine.state].stands:
        return machine
    return stop(machine, True, "operator", lost)


def _remember(machine: Machine, inputs: states.Inputs, limits: Limits) -> states.GuardMemory:
    memory, (reading, bad, calm), now = machine.memory, inputs.arrival, inputs.now
    if reading is None:
        return memory._replace(now=now, bad=memory.bad + bad)
    strong = strained = _NEVER
    if not calm:
        tau = np.abs(reading.tau)
        strong = np.where(tau > limits.torque, memory.strong + 1, 0)
        strained = np.where(tau > limits.strain, memory.strained + 1, 0)
    pose, still = memory.pose, memory.still
    # Only arming, from LINKED, needs to know whether the robot is still.
    if machine.state is State.LINKED and (
        pose is None or np.abs(reading.q - pose).max() > limits.still * limits.still_time / SECOND
    ):
        pose, still = reading.q, now
    power = checks.power_count(limits, memory.power, checks.power(reading))
    return states.GuardMemory(now, reading, now, 0, power, strong, strained, pose, still)


def _obey(machine: Machine, inputs: states.Inputs, limits: Limits) -> states.ClientCommands:
    followed = machine.followed
    dropped = inputs.dropped
    if isinstance(inputs.orders, MotorPacket) and checks.is_allowed(limits, inputs.orders):
        return states.ClientCommands(
            inputs.orders, inputs.now, 0, followed.clipped, followed.unusable + dropped
        )
    if inputs.orders is not None:
        usable = checks.clip(limits, states.decode(inputs.orders))
        if usable:
            within, beyond = usable
            return states.ClientCommands(
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
