"""Start the guard of a robot in a process of its own, or attach to a running one.

The guard has its own session, so Ctrl-C at the terminal does not reach it. It outlives the process that started it.
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from typing import Any

from s2r_a1.guard.control import Connection, ControlError, RefusedError, Role
from s2r_a1.guard.place import GuardFiles, RobotAddress, hold, place
from s2r_spec.errors import BackendError, UsageError

__all__ = ["RobotAddress", "attach", "start"]

PATIENCE = 20.0
"""A budget [s]: time for a guard to start; it needs about 0.3 s on an idle machine."""


def attach(
    robot: RobotAddress, role: Role | None = None, **hello: Any
) -> tuple[Connection, dict[str, Any]] | None:
    """Return a connection to the running guard of a robot, and its reply to hello; None if no guard runs.

    Args:
        robot: the robot.
        role: role for the hello; None to request the status instead.
        hello: further fields of the hello: ``port``, the client's UDP port.

    Raises:
        UsageError: the guard has another layout, module, clock or robot.
        RefusedError: the guard refused the hello, because it has another client.
    """
    files = place(robot.host, robot.port)
    try:
        connection = Connection(files.control)
    except ControlError:
        return None
    try:
        if role:
            answer = connection.request("hello", role=role, pid=os.getpid(), **hello)
        else:
            answer = connection.request("status")
        if answer["name"] != robot.name:
            raise UsageError(
                f"the guard of {robot.host}:{robot.port} was started for {_named(answer['name'])}, "
                f"not for {_named(robot.name)}; end it with: python -m s2r_a1.guard stop --host "
                f"{robot.host} --port {robot.port}"
            )
        for name in ("layout", "clock", "module", *(("local",) if robot.local else ())):
            if answer[name] != getattr(robot, name):
                raise UsageError(
                    f"the guard of {robot.host}:{robot.port} has {name}={answer[name]}, not "
                    f"{name}={getattr(robot, name)}; end it with: python -m s2r_a1.guard stop --host {robot.host} "
                    f"--port {robot.port}"
                )
    except (UsageError, RefusedError):
        connection.close()
        raise
    except ControlError:  # the guard ended at this moment
        connection.close()
        return None
    return connection, answer


def _named(name: str) -> str:
    return f"the robot {name}" if name else "a twin without a name"


def start(robot: RobotAddress, idle: float = 60.0) -> tuple[Connection, dict[str, Any]]:
    """Return an operator's connection to the guard of a robot, and its reply to hello; start a guard if none runs.

    A start sends nothing to the robot; only the request ``connect`` does.

    Args:
        robot: the robot.
        idle: time that a guard runs without connections while the robot lies [s].

    Raises:
        UsageError: a running guard has another layout, module or clock.
        BackendError: the guard cannot start; the message is its own.
    """
    end = time.monotonic() + PATIENCE
    failure: str | None = None
    while time.monotonic() < end:
        if attached := attach(robot, "operator"):
            return attached
        files = place(robot.host, robot.port)
        if not _is_locked(files):
            failure = _begin(robot, files, idle)
            if failure is not None:
                raise BackendError(failure)
        else:
            time.sleep(0.02)  # a guard is starting or ending
    raise BackendError(
        f"the guard of {robot.host}:{robot.port} does not answer; see {place(robot.host, robot.port).words}"
    )


def _is_locked(files: GuardFiles) -> bool:
    """Return whether a guard holds the robot's lock."""
    lock = hold(files)
    if lock is None:
        return True
    os.close(lock)
    return False


def _begin(robot: RobotAddress, files: GuardFiles, idle: float) -> str | None:
    """Start a guard, and wait until it listens or ends; return its message if it could not start.

    If another guard started at the same time, return None; the caller attaches to that one.
    """
    ready, theirs = os.pipe()
    command = [
        sys.executable, "-m", "s2r_a1.guard", "run", "--host", robot.host, "--port", str(robot.port),
        "--layout", robot.layout, "--clock", robot.clock, "--local", str(robot.local),
        "--module", robot.module, "--name", robot.name, "--idle", str(idle), "--ready", str(theirs),
    ]  # fmt: skip
    try:
        with open(files.words, "wb") as words:
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
        os.close(theirs)
        theirs = -1
        answer = _read(ready, PATIENCE)
    finally:
        os.close(ready)
        if theirs >= 0:
            os.close(theirs)
    if answer == "ready":
        return None
    if answer.startswith("error: "):
        return answer.removeprefix("error: ")
    return None if answer == "held" else f"the guard ended during its start; see {files.words}"


def _read(ready: int, seconds: float) -> str:
    """Return the message of a new guard: "ready", "held", "error: …", or "" if it ended without one."""
    end = time.monotonic() + seconds
    message = b""
    while not message.endswith(b"\n"):
        left = end - time.monotonic()
        if left <= 0 or not select.select([ready], [], [], left)[0]:
            break
        data = os.read(ready, 4096)
        if not data:
            break
        message += data
    return message.decode(errors="replace").strip()
