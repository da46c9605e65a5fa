"""Starts the guard of a robot in a process of its own, or attaches to the one that lives.

The guard gets a session of its own, so that a Ctrl-C at the terminal does not reach it, and outlives who started it.
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from typing import Any

from s2r_a1.guard.control import Connection, ControlError, RefusedError, Role
from s2r_a1.guard.place import Place, Robot, hold, place
from s2r_spec.errors import BackendError, UsageError

__all__ = ["Robot", "attach", "start"]

PATIENCE = 20.0
"""A budget [s]: how long a guard may take to begin; it needs about 0.3 s on a quiet machine."""


def attach(robot: Robot, role: Role | None = None, **hello: Any) -> tuple[Connection, dict[str, Any]] | None:
    """Return a connection to the living guard of a robot, and its answer to hello; None where no guard lives.

    Args:
        robot: whose guard.
        role: to say hello as; None asks for the status instead.
        hello: more of the hello: ``port``, the client's UDP port.

    Raises:
        UsageError: the guard speaks another layout or through another module, or keeps another clock.
        RefusedError: it refused the hello: there is another client.
    """
    found = place(robot.host, robot.port)
    try:
        connection = Connection(found.control)
    except ControlError:
        return None
    try:
        if role:
            answer = connection.request("hello", role=role, pid=os.getpid(), **hello)
        else:
            answer = connection.request("status")
        for name in ("layout", "clock", "module", *(("local",) if robot.local else ())):
            if answer[name] != getattr(robot, name):
                raise UsageError(
                    f"the guard of {robot.host}:{robot.port} has {name}={answer[name]}, not "
                    f"{name}={getattr(robot, name)}; end it by: python -m s2r_a1.guard stop --host {robot.host} "
                    f"--port {robot.port}"
                )
    except (UsageError, RefusedError):
        connection.close()
        raise
    except ControlError:  # it ended in this moment
        connection.close()
        return None
    return connection, answer


def start(robot: Robot, idle: float = 60.0) -> tuple[Connection, dict[str, Any]]:
    """Return an operator's connection to the guard of a robot, started if none lives, and its answer to hello.

    Starting sends nothing to the robot; that takes the request ``connect``.

    Args:
        robot: whose guard.
        idle: seconds that a guard lives with nobody attached while the robot lies.

    Raises:
        UsageError: a living guard speaks another layout or through another module, or keeps another clock.
        BackendError: it cannot begin; the sentence is its own.
    """
    end = time.monotonic() + PATIENCE
    sentence: str | None = None
    while time.monotonic() < end:
        if attached := attach(robot, "operator"):
            return attached
        found = place(robot.host, robot.port)
        if not _held(found):
            sentence = _begin(robot, found, idle)
            if sentence is not None:
                raise BackendError(sentence)
        else:
            time.sleep(0.02)  # one is beginning, or ending
    raise BackendError(
        f"the guard of {robot.host}:{robot.port} does not answer; see {place(robot.host, robot.port).words}"
    )


def _held(found: Place) -> bool:
    """Return whether a guard holds the robot's lock."""
    lock = hold(found)
    if lock is None:
        return True
    os.close(lock)
    return False


def _begin(robot: Robot, found: Place, idle: float) -> str | None:
    """Start a guard, and wait until it listens or ends; return its sentence if it could not begin.

    Another guard that was quicker is none: the caller attaches to that one.
    """
    ready, theirs = os.pipe()
    command = [
        sys.executable, "-m", "s2r_a1.guard", "run", "--host", robot.host, "--port", str(robot.port),
        "--layout", robot.layout, "--clock", robot.clock, "--local", str(robot.local),
        "--module", robot.module, "--idle", str(idle), "--ready", str(theirs),
    ]  # fmt: skip
    try:
        with open(found.words, "wb") as words:
            # It forks, and its first process ends at once: so the guard is nobody's child, and leaves no zombie.
            subprocess.run(
                command,
                # Its sums are of twelve numbers; threads for them would only wake at a bad time.
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
    return None if answer == "held" else f"the guard ended before it listened; see {found.words}"


def _read(ready: int, seconds: float) -> str:
    """Return what a new guard says of itself: "ready", "held", "error: …", or "" if it ended without a word."""
    end = time.monotonic() + seconds
    said = b""
    while not said.endswith(b"\n"):
        left = end - time.monotonic()
        if left <= 0 or not select.select([ready], [], [], left)[0]:
            break
        data = os.read(ready, 4096)
        if not data:
            break
        said += data
    return said.decode(errors="replace").strip()
