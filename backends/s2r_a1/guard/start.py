"""Start the guard of a robot in a process of its own, or attach to a running one.

The guard has its own session, so Ctrl-C at the terminal does not reach it. It outlives the process that started it.
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from contextlib import ExitStack, closing
from typing import Any

from s2r_a1.guard.control import Connection, ControlError, Role
from s2r_a1.guard.place import GuardFiles, RobotAddress, is_held, place
from s2r_spec.errors import BackendError, UsageError

PATIENCE = 20.0
"""A budget [s]: time for a guard to start; it needs about 0.3 s on an idle machine."""


def attach(
    robot: RobotAddress, role: Role | None = None, **hello: Any
) -> tuple[Connection, dict[str, Any]] | None:
    """Return a connection to the running guard of a robot, and its reply to hello; None if no guard runs.

    Without a ``role`` for the hello the status is requested instead. A client's hello has its UDP ``port``.

    Raises:
        UsageError: the guard has another layout, module or clock.
        RefusedError: the guard refused the hello, because it has another client.
    """
    with ExitStack() as opened:
        try:
            connection = opened.enter_context(closing(Connection(place(robot.host, robot.port).control)))
            if role:
                answer = connection.request("hello", role=role, pid=os.getpid(), **hello)
            else:
                answer = connection.request("status")
        except ControlError:  # no guard listens, or it ended at this moment
            return None
        for name in ("layout", "clock", "module", *(("local",) if robot.local else ())):
            if answer[name] != getattr(robot, name):
                raise UsageError(
                    f"the guard of {robot.host}:{robot.port} has {name}={answer[name]}, not "
                    f"{name}={getattr(robot, name)}; end it with: python -m s2r_a1.guard stop --host {robot.host} "
                    f"--port {robot.port}"
                )
        opened.pop_all()
    return connection, answer


def start(robot: RobotAddress, idle: float = 60.0) -> tuple[Connection, dict[str, Any]]:
    """Return an operator's connection to the guard of a robot, and its reply to hello; start a guard if none runs.

    A start sends nothing to the robot; only the request ``connect`` does. A guard ends after ``idle`` [s] without
    connections while the robot lies.

    Raises:
        UsageError: a running guard has another layout, module or clock.
        BackendError: the guard cannot start; the message is its own.
    """
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if attached := attach(robot, "operator"):
            return attached
        files = place(robot.host, robot.port)
        if is_held(files):
            time.sleep(0.02)  # a guard is starting or ending
        else:
            _begin(robot, files, idle)
    raise BackendError(
        f"the guard of {robot.host}:{robot.port} does not answer; see {place(robot.host, robot.port).words}"
    )


def _begin(robot: RobotAddress, files: GuardFiles, idle: float) -> None:
    """Start a guard, and wait until it listens, or ends because another one started at the same time.

    Raises:
        BackendError: it cannot start; the message is its own.
    """
    ready, theirs = os.pipe()
    command = [
        sys.executable, "-m", "s2r_a1.guard", "run", "--host", robot.host, "--port", str(robot.port),
        "--layout", robot.layout, "--clock", robot.clock, "--local", str(robot.local),
        "--module", robot.module, "--idle", str(idle), "--ready", str(theirs),
    ]  # fmt: skip
    with open(ready, "rb", buffering=0):
        with open(theirs, "wb"), open(files.words, "wb") as words:
            # The first process forks and ends at once, so the guard has no parent here and leaves no zombie.
            subprocess.run(
                command,
                # Its arrays have twelve numbers; threads would only delay its rounds.
                env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=words,
                pass_fds=(theirs,),
                start_new_session=True,
                check=False,
            )
        # "ready", "held", "error: …", or "" if it ended without a word; such a short line arrives in one piece.
        came = select.select([ready], [], [], PATIENCE)[0]
        answer = os.read(ready, 4096).decode(errors="replace").strip() if came else ""
    if answer.startswith("error: "):
        raise BackendError(answer.removeprefix("error: "))
    if answer not in ("ready", "held"):
        raise BackendError(f"the guard ended during its start; see {files.words}")
