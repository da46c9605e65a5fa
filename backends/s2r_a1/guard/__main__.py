"""The guard's commands: ``python -m s2r_a1.guard status|lie|damp|stop [--host HOST] [--port PORT]``.

They send requests to a running guard over its control socket, and never reach a robot directly. ``run`` is for
:mod:`s2r_a1.guard.start`, which starts a guard, and not for people.

Signals to the process of ``run``: SIGINT and SIGHUP do nothing; SIGTERM makes a standing robot lie down, and then ends
the guard. SIGKILL cannot be caught: commands stop, and the robot's firmware decides.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import json
import os
import resource
import signal
import sys
import time
from dataclasses import fields
from typing import Any

from s2r_a1.guard.control import Connection, ControlError, Listener
from s2r_a1.guard.place import PORT, RobotAddress, claim, find_guard, hold, place
from s2r_spec.errors import BackendError, S2RError

PRIORITY = 20
"""A level: real-time priority (1 to 99), if the system allows it; above all processes without one."""
SWITCH = 0.0005
"""A budget [s]: longest delay by another thread of the guard; Python's own value is 5 ms, more than two rounds."""
LOCKED = 3
"""A definition: MCL_CURRENT | MCL_FUTURE of Linux's ``mlockall``."""
ENDING = 15.0
"""A budget [s]: time that ``stop`` waits for the guard's end; a stop from a walk takes 6 s."""


def main(arguments: list[str] | None = None) -> int:
    """Run a command and return its exit code; an error is one sentence on standard error."""
    parser = argparse.ArgumentParser(
        prog="python -m s2r_a1.guard", description="Send a request to the guard of a robot."
    )
    commands = parser.add_subparsers(dest="do", required=True)
    for name, text in _COMMANDS.items():
        command = commands.add_parser(name, help=text, description=text)
        command.add_argument("--host", help="the robot's address; not needed if only one guard runs")
        command.add_argument("--port", type=int, default=PORT, help=f"the robot's UDP port ({PORT})")
        if name == "status":
            command.add_argument("--json", action="store_true", help="print one JSON object")
    _add_run(commands.add_parser("run", description="Start a guard; s2r does this itself."))
    options = parser.parse_args(arguments)
    try:
        return _run(options) if options.do == "run" else _send(options)
    except S2RError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code


_COMMANDS = {
    "status": "Print the state of the guard, and the reason for it.",
    "lie": "Make the robot stop and stand, and then lie down.",
    "damp": "Damp the robot at once; only a reset ends the damping.",
    "stop": "Make the robot lie down if it stands, and end the guard.",
}


def _send(options: argparse.Namespace) -> int:
    connection = Connection(find_guard(options.host, options.port))
    try:
        reply = connection.request(options.do)
        if options.do == "status":
            print(json.dumps(reply) if options.json else _lines_of(reply))
        elif options.do == "stop":
            _await_end(connection)
            print("stop: the guard has ended; no packets go to the robot")
        else:
            print(f"{options.do}: the robot is in {reply['state']}")
    finally:
        connection.close()
    return 0


def _await_end(connection: Connection) -> None:
    """Wait until the guard ends; raise BackendError if it does not end in time."""
    end = time.monotonic() + ENDING
    while time.monotonic() < end:
        try:
            for _ in connection.take():
                pass
        except ControlError:
            return
        time.sleep(0.02)
    raise BackendError("the guard has not ended yet; check it with: python -m s2r_a1.guard status")


def _lines_of(status: dict[str, Any]) -> str:
    kind = "a twin" if status["twin"] else f"the robot {status['robot']}"
    since = f" since {status['since']:.1f} s" if status["since"] is not None else ""
    lines = [
        f"{status['state']}{since}: {kind} at {status['host']}:{status['port']}, {status['clock']} clock"
    ]
    if status["reason"]:
        lines.append(f"  why: {status['reason']} ({status['word']})")
    if status["temperatures"]:
        lines.append(f"  warmest motor: {max(status['temperatures']):.0f} °C")
    if status["state"] == "LINKED":
        remote = "on" if status["remote_seen"] else "off"
        lines.append(f"  tick in {status['tick_unit'] or 'an unknown unit'}, remote {remote}")
        lines.append(f"  not ready to arm: {status['unready']}" if status["unready"] else "  ready to arm")
    if status["battery"] is not None:
        lines.append(f"  battery: {status['battery']} %")
    if status["client"]:
        lines.append(f"  moved by process {status['client']}")
    if status["recording"]:
        lines.append(f"  recording to {status['recording']}")
    lines += [f"  warning: {sentence}" for sentence in status["warnings"]]
    counted = ", ".join(f"{name} {count}" for name, count in status["counters"].items() if count)
    if status["clock"] == "real":
        granted = [name for name in ("priority", "memory") if not status[name]]
        lines.append(
            f"  not granted to the guard: {', '.join(granted)}"
            if granted
            else "  priority and memory are granted"
        )
    lines.append(f"  {status['rounds']} rounds, {status['late']} late; packets: {counted or 'none'}")
    return "\n".join(lines)


def _add_run(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--host", required=True)
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--layout", choices=("a1", "go1"), default="a1")
    parser.add_argument("--clock", choices=("real", "lockstep"), default="real")
    parser.add_argument("--local", type=int, default=0)
    parser.add_argument("--module", default="")
    parser.add_argument("--robot", default="")
    parser.add_argument("--idle", type=float, default=60.0)
    parser.add_argument("--ready", type=int, required=True)


def _run(arguments: argparse.Namespace) -> int:
    """Start a guard in a process of its own, which reports through the descriptor ``ready`` that it listens."""
    if os.fork():
        os._exit(0)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with os.fdopen(arguments.ready, "w") as ready:
        try:
            guard = _begin(arguments)
        except S2RError as error:
            ready.write(f"error: {error}\n")
            return error.exit_code
        if guard is None:
            ready.write("held\n")
            return 4
        ready.write("ready\n")
    guard.run()
    return 0


def _begin(arguments: argparse.Namespace) -> Any:
    """Return a guard that holds the robot's lock and listens; None if another guard does."""
    from s2r_a1.guard.answers import answer
    from s2r_a1.guard.loop import Guard

    files = place(arguments.host, arguments.port)
    if hold(files) is None:  # the lock lasts until this process ends
        return None
    claim(files)
    robot = RobotAddress(**{field.name: getattr(arguments, field.name) for field in fields(RobotAddress)})
    guard = Guard(robot, Listener(files.control), answer, arguments.idle)

    def terminated(number: int, frame: Any) -> None:
        guard.terminated = True

    signal.signal(signal.SIGTERM, terminated)
    sys.setswitchinterval(SWITCH)
    if arguments.clock == "real":
        # Most users lack these permissions; without them the guard has more late rounds, and counts them.
        with contextlib.suppress(OSError):
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, policy, os.sched_param(PRIORITY))
            guard.priority = True
        guard.memory = _lock_memory()
    return guard


def _lock_memory() -> bool:
    """Keep all memory of this process in RAM; return whether the system allows it.

    With a limit, a later allocation would fail, so memory is locked only without one.
    """
    unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    if not (sys.platform == "linux" and (unlimited or os.geteuid() == 0)):
        return False
    return bool(ctypes.CDLL(None).mlockall(LOCKED) == 0)


if __name__ == "__main__":
    sys.exit(main())
