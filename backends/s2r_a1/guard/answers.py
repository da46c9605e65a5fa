"""Answer the requests to a guard; :mod:`s2r_a1.guard.control` lists them."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from s2r_a1 import remote
from s2r_a1.guard import transitions
from s2r_a1.guard.control import ROLES, Party, RefusedError, Request
from s2r_a1.guard.limits import SECOND
from s2r_a1.guard.loop import Guard
from s2r_a1.guard.serving import Deferred
from s2r_a1.guard.states import BEGINNINGS, RULES, SINKING, State

Reply = dict[str, Any] | Deferred

PATIENCE = 750
"""A budget [rounds]: time for the robot to fulfil the conditions of a request: 1.5 s, with 0.5 s for measuring the
robot's clock."""
LONGEST = 300
"""A budget: characters of a reason."""
JUDGED = frozenset({"a1"})
"""A definition: layouts of robots with limits in :mod:`s2r_a1.guard.limits`; other robots are never armed."""
_UNJUDGED = "the guard can read a {} but not move it, because it has the limits of an A1 only"


def answer(guard: Guard, party: Party, request: Request) -> Reply:
    """Return the reply to a request, now or later; raise RefusedError, or LinkError if the robot is out of reach."""
    if party.role not in ROLES[request.do]:
        needed = " or ".join(sorted(role for role in ROLES[request.do] if role))
        raise RefusedError(f"{request.do} needs the role {needed}; send hello with that role first")
    own = _ANSWERS.get(request.do)
    return own(guard, party, request.fields) if own else _motion(guard, party, request)


def _motion(guard: Guard, party: Party, request: Request) -> Reply:
    if request.do in BEGINNINGS:
        if guard.client is None or guard.client.party is not party:
            raise RefusedError("this program is no longer the client of the robot; connect again")
        if party.spent:
            raise RefusedError("this program was the client when the robot was damped; connect again")
        if guard.ending:
            raise RefusedError("the guard is about to end; start a new one")
        # Consent comes from the present operator, so a client of an earlier run must not move the robot.
        if not guard.attended:
            raise RefusedError("no operator is attached; attach one first, as s2r check, gap and certify do")
    reason = request.fields.get("reason")
    reason = " ".join(reason.split())[:LONGEST] if isinstance(reason, str) else None
    machine, refusal = transitions.request(guard.machine, request.do, party.role, reason, guard.limits)
    if refusal:
        raise RefusedError(refusal)
    if machine.state is not guard.machine.state and RULES[machine.state].client:
        guard.forget_orders()
    guard.become(machine)
    return {}


def _hello(guard: Guard, party: Party, fields: dict[str, Any]) -> Reply:
    role, pid, port = fields.get("role"), fields.get("pid"), fields.get("port")
    if role not in ("client", "operator"):
        raise RefusedError('hello needs "role": "client" or "operator"')
    if party.role:
        raise RefusedError(f"this connection already has the role {party.role}; open another one")
    pid = pid if isinstance(pid, int) else None
    if role == "operator":
        party.role, party.pid = role, pid
        return status(guard)
    if not isinstance(port, int) or not 0 < port < 65536:
        raise RefusedError('a client\'s hello needs "port", its UDP port from 1 to 65535')

    def poll() -> dict[str, Any] | None:
        if guard.link is None:
            raise RefusedError("the robot is not connected; an operator must connect it first")
        client = guard.client
        if client and client.party.open and not client.party.spent:
            raise RefusedError(f"another program moves the robot (process {client.party.pid}); end it first")
        if client and client.party.open:
            guard.release()  # after damping it cannot move the robot; it may be a stopped process
        elif client:
            guard.leave(client.party)
        if guard.lockstep and guard.moving():
            return None  # otherwise its first state would depend on the computer's load
        own = guard.attach(party, port)
        party.role, party.pid = role, pid
        return {**status(guard), "port": own}

    return poll() or Deferred(party, poll, rounds=True)


def _connect(guard: Guard, party: Party, fields: dict[str, Any]) -> Reply:
    if guard.machine.state not in (State.OFF, State.LINKED):
        return status(guard)
    guard.connect()
    until = guard.rounds + PATIENCE

    def poll() -> dict[str, Any] | None:
        conditions, reading = guard.conditions(), guard.machine.memory.reading
        if reading is not None and conditions.unit:
            return status(guard)
        if guard.rounds < until:
            return None
        sentence = _silent(guard) if reading is None or conditions.refusal is None else _clockless(guard)
        guard.disconnect()
        raise RefusedError(sentence)

    return Deferred(party, poll, rounds=True)


def _arm(guard: Guard, party: Party, fields: dict[str, Any]) -> Reply:
    if guard.machine.state is State.OFF:
        raise RefusedError("the robot is not connected; connect it first")
    if guard.machine.state is State.DAMPING:
        raise RefusedError(f"the robot is damped ({guard.machine.reason}); reset it first")
    if guard.robot.layout not in JUDGED:
        raise RefusedError(_UNJUDGED.format(guard.layout.name))
    memory = guard.machine.memory
    silent_now = memory.now - memory.fresh >= guard.limits.silence
    if guard.machine.state is State.LINKED and guard.link and silent_now:
        guard.link.forget()  # the clock of a robot that was switched off and on starts again
    until = guard.rounds + PATIENCE

    def poll() -> dict[str, Any] | None:
        if guard.machine.state is State.LINKED:
            sentence = unready(guard)
            if sentence and guard.rounds < until:
                return None
            if sentence:
                raise RefusedError(sentence)
            guard.become(transitions.arm(guard.machine, guard.now))
        return {}

    return Deferred(party, poll, rounds=True)


def _reset(guard: Guard, party: Party, fields: dict[str, Any]) -> Reply:
    if guard.machine.state is not State.DAMPING:
        raise RefusedError(f"the robot is in {guard.machine.state}, not damped; reset only a damped robot")

    def poll() -> dict[str, Any] | None:
        if guard.machine.state is not State.DAMPING:  # another operator has reset it
            return {}
        if guard.now - guard.machine.since < SINKING:
            return None
        guard.reset()
        return {}

    return Deferred(party, poll, rounds=True)


def _record(guard: Guard, party: Party, fields: dict[str, Any]) -> Reply:
    path, header = fields.get("path"), fields.get("header", {})
    if not isinstance(path, str) or not Path(path).is_absolute():
        raise RefusedError('record needs "path", an absolute path')
    if not isinstance(header, dict):
        raise RefusedError('record needs "header", an object')
    robot = guard.robot
    own = {
        "host": robot.host,
        "port": robot.port,
        "twin": guard.loopback,
        "layout": robot.layout,
        "clock": robot.clock,
        "tick_unit": guard.link.unit if guard.link else None,
        "limits": asdict(guard.limits),
    }
    try:
        os.fsencode(path)
        if "\0" in path:
            raise ValueError
        log = guard.record(path, {**header, **own})
    except (ValueError, RecursionError):
        raise RefusedError(
            "the path or the header of the recording cannot be written: use plain characters and less nesting"
        ) from None

    def poll() -> dict[str, Any] | None:
        if not log.ready:
            return None
        if log.failure:
            guard.finish_recording()
            raise RefusedError(log.failure)
        return {"path": path}

    return Deferred(party, poll, rounds=False)


def _stop_recording(guard: Guard, party: Party, fields: dict[str, Any]) -> Reply:
    log = guard.finish_recording()
    if log is None:
        raise RefusedError("there is no recording to stop; request record first")

    def poll() -> dict[str, Any] | None:
        if not log.done:
            return None
        if log.failure:
            raise RefusedError(log.failure)
        return {"path": str(log.path), "packets": log.packets, "bytes": log.bytes}

    return Deferred(party, poll, rounds=False)


def _leave(guard: Guard, party: Party, fields: dict[str, Any]) -> Reply:
    machine = guard.machine
    if RULES[machine.state].client:
        raise RefusedError(f"the robot is in {machine.state}; halt it first")
    guard.release()
    return {}


def _stop(guard: Guard, party: Party, fields: dict[str, Any]) -> Reply:
    guard.stop("the guard was asked to end")
    return {}


def status(guard: Guard) -> dict[str, Any]:
    """Return the complete status of a guard."""
    machine, reading = guard.machine, guard.machine.memory.reading
    counters = asdict(guard.link.counters) if guard.link else {}
    followed = machine.followed
    return {
        "pid": os.getpid(),
        "reason": machine.reason,
        "word": machine.word,
        "since": (guard.now - machine.since) / SECOND if machine.state is not State.OFF else None,
        "host": guard.robot.host,
        "port": guard.robot.port,
        "twin": guard.loopback,
        "layout": guard.robot.layout,
        "module": guard.robot.module,
        "local": guard.robot.local,
        "clock": guard.robot.clock,
        "tick_unit": guard.link.unit if guard.link else None,
        "unready": unready(guard) if machine.state is State.LINKED else None,
        "rounds": guard.rounds,
        "late": guard.late,
        "counters": counters,
        "clipped": followed.clipped,
        "dropped": followed.unusable,
        "temperatures": None if reading is None else reading.temperature.tolist(),
        "battery": _battery(guard),
        "remote_seen": reading is not None and remote.is_on(reading.remote),
        "client": guard.client.party.pid if guard.client else None,
        "operators": [p.pid for p in guard.listener.parties if p.role == "operator" and p.open],
        "recording": str(guard.log.path) if guard.log else None,
        "warnings": [sentence for _, sentence in machine.warnings],
        "event": guard.event,
    }


def unready(guard: Guard) -> str | None:
    """Return why a robot must not be armed now, or None."""
    if guard.robot.layout not in JUDGED:
        return _UNJUDGED.format(guard.layout.name)
    return transitions.unready(guard.machine, guard.conditions(), guard.limits)


def _battery(guard: Guard) -> int | None:
    """Return the charge that a Go1 reports [%]; None for an A1, which reports none."""
    if guard.robot.layout != "go1" or guard.robot.module or not guard.packet:  # a module reports none
        return None
    return int(np.frombuffer(guard.packet, guard.layout.state)["battery"][0, 3])


def _silent(guard: Guard) -> str:
    where = f"{guard.robot.host}:{guard.robot.port}"
    if guard.link and guard.link.counters.corrupt:
        return f"{where} answers, but sends no packets of the {guard.layout.name}; check its layout and its address"
    if guard.loopback:
        clock = " --clock lockstep" if guard.lockstep else ""
        return (
            f"no twin of the {guard.layout.name} answers at {where}; "
            f"start one with: python -m s2r_a1.twin --port {guard.robot.port}{clock}"
        )
    return f"no {guard.layout.name} answers at {where}; check that it is on, its address, and the cable"


def _clockless(guard: Guard) -> str:
    assert guard.link is not None
    refusal = guard.link.refusal or ""
    if not guard.loopback:
        return refusal
    problem, _, _ = refusal.partition(";")
    return f"{problem}; if this machine is too busy for a twin in real time, use clock=lockstep for guard and twin"


_ANSWERS: dict[str, Callable[[Guard, Party, dict[str, Any]], Reply]] = {
    "hello": _hello,
    "status": lambda guard, party, fields: status(guard),
    "connect": _connect,
    "arm": _arm,
    "reset": _reset,
    "record": _record,
    "stop_recording": _stop_recording,
    "leave": _leave,
    "stop": _stop,
}
