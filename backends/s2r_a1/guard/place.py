"""Finds the files of a robot's guard: one lock and one control socket for each address of a robot.

They lie in ``$S2R_A1_RUN``, else ``$XDG_RUNTIME_DIR/s2r-a1``, else ``/tmp/s2r-a1-<uid>``, a folder of the user alone.
The lock is one of the kernel's (``flock``): it ends with the process that holds it, however that ends, so that a
stale lock cannot exist. A socket file without a lock is a remnant, which the next guard replaces.
"""

from __future__ import annotations

import fcntl
import os
import socket
import stat
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from s2r_spec.errors import BackendError, UsageError

LONGEST = 100
"""A definition: letters of a socket's path; the kernel takes 107, and cuts no longer one."""


Clock = Literal["real", "lockstep"]


@dataclass(frozen=True)
class Robot:
    """Which robot, and how its guard speaks with it.

    Attributes:
        host: of the robot's motion controller, or of a twin.
        port: its UDP port.
        layout: of its packets, "a1" or "go1".
        clock: "real", or "lockstep" with a twin on this machine.
        local: UDP port from which the guard speaks; 0 takes any.
        module: the vendor's Python module, through which the guard speaks; empty for the wire of its own.
    """

    host: str
    port: int = 8007
    layout: str = "a1"
    clock: Clock = "real"
    local: int = 0
    module: str = ""


@dataclass(frozen=True)
class Place:
    """The files of the guard of one robot.

    Attributes:
        lock: held by the guard while it lives.
        control: its socket, for requests.
        words: what it wrote to its standard error.
    """

    lock: Path
    control: Path
    words: Path


def folder() -> Path:
    """Return the folder of the guards' files, made if it is not there, readable by its user alone.

    Raises:
        UsageError: it belongs to somebody else, or cannot be made.
    """
    named = os.environ.get("S2R_A1_RUN")
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    path = (
        Path(named) if named else Path(runtime) / "s2r-a1" if runtime else Path(f"/tmp/s2r-a1-{os.getuid()}")
    )
    try:
        path.mkdir(mode=0o700, parents=named is not None, exist_ok=True)
        found = path.lstat()
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
            raise UsageError(f"{path} must be a folder of your own; name another one in S2R_A1_RUN")
        if found.st_mode & 0o077:
            path.chmod(0o700)
    except OSError as error:
        raise UsageError(
            f"{path} cannot be made: {error.strerror}; name another folder in S2R_A1_RUN"
        ) from None
    return path


def place(host: str, port: int) -> Place:
    """Return the files of the guard of the robot at this address; names are looked up first.

    Raises:
        UsageError: the folder cannot be used, or its path is too long for a socket.
        BackendError: the name of the host is unknown.
    """
    try:
        address = socket.gethostbyname(host)
    except (OSError, UnicodeError):
        raise BackendError(
            f"no host {host!r} is known; name the robot's address, as 192.168.123.10"
        ) from None
    stem = folder() / f"{address}_{port}"
    if len(str(stem)) + len(".sock") > LONGEST:
        raise UsageError(f"{stem.parent} is too long a path for a socket; name a shorter one in S2R_A1_RUN")
    return Place(*(stem.with_name(stem.name + end) for end in (".lock", ".sock", ".words")))


def hold(place: Place) -> int | None:
    """Take the lock of a robot, until the returned descriptor is closed; None where a guard has it."""
    held = os.open(place.lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(held)
        return None
    return held


def claim(place: Place) -> None:
    """Take the name of a robot on this machine, until this process ends.

    A lock's file can be deleted, and another shell may look in another folder; this name has no file (Linux only).
    Two guards of one robot would fight over its motors.

    Raises:
        BackendError: another guard has it.
    """
    if sys.platform != "linux":
        return
    name = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        name.bind(f"\0s2r-a1 {place.lock.stem}")
    except OSError:
        name.close()
        raise BackendError(
            f"another guard on this machine holds the robot at {place.lock.stem.replace('_', ':')}, by another user "
            "or with another S2R_A1_RUN; end it first"
        ) from None
    name.detach()
