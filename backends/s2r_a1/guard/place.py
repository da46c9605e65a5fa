"""The files of a robot's guard: one lock and one control socket for each address of a robot.

They are in ``$S2R_A1_RUN``, else ``$XDG_RUNTIME_DIR/s2r-a1``, else ``/tmp/s2r-a1-<uid>``, a private folder of the user.
The kernel holds the lock (``flock``) and releases it at any end of the process, so a stale lock cannot exist. A socket
file without a lock is left over, and the next guard replaces it.
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
"""A definition: characters of a socket's path; the kernel accepts 107, and refuses a longer path."""
PORT = 8007
"""A definition: the UDP port of an A1's motion controller."""

Clock = Literal["real", "lockstep"]


@dataclass(frozen=True)
class RobotAddress:
    """A robot, and its guard's connection to it.

    Attributes:
        host: address of the robot's motion controller, or of a twin.
        port: UDP port at that address.
        layout: layout of its packets, "a1" or "go1".
        clock: "real", or "lockstep" with a twin on this computer.
        local: UDP port of the guard; 0 for any.
        module: the vendor's Python module for the connection; "" for the built-in wire protocol.
        robot: name of the robot; "" for a twin without one.
    """

    host: str
    port: int = PORT
    layout: str = "a1"
    clock: Clock = "real"
    local: int = 0
    module: str = ""
    robot: str = ""


@dataclass(frozen=True)
class GuardFiles:
    """The files of the guard of one robot: its lock, its socket for requests, and its standard error."""

    lock: Path
    control: Path
    words: Path


def folder() -> Path:
    """Return the user's private folder for the guards' files, or make it; raise UsageError if it cannot be used."""
    named = os.environ.get("S2R_A1_RUN")
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    path = (
        Path(named) if named else Path(runtime) / "s2r-a1" if runtime else Path(f"/tmp/s2r-a1-{os.getuid()}")
    )
    try:
        path.mkdir(mode=0o700, parents=named is not None, exist_ok=True)
        status = path.lstat()
        if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid():
            raise UsageError(f"{path} must be a folder that you own; name another one in S2R_A1_RUN")
        if status.st_mode & 0o077:
            path.chmod(0o700)
    except OSError as error:
        raise UsageError(
            f"{path} cannot be made: {error.strerror}; name another folder in S2R_A1_RUN"
        ) from None
    return path


def place(host: str, port: int) -> GuardFiles:
    """Return the files of the guard of the robot at this address; a host name is looked up.

    Raises:
        UsageError: the folder cannot be used, or its path is too long for a socket.
        BackendError: the host name is unknown.
    """
    try:
        address = socket.gethostbyname(host)
    except (OSError, UnicodeError):
        raise BackendError(
            f"the host {host!r} is unknown; write the robot's address, such as 192.168.123.10"
        ) from None
    stem = folder() / f"{address}_{port}"
    if len(str(stem)) + len(".sock") > LONGEST:
        raise UsageError(f"the path {stem.parent} is too long for a socket; name a shorter one in S2R_A1_RUN")
    return GuardFiles(*(stem.with_name(stem.name + end) for end in (".lock", ".sock", ".words")))


def hold(place: GuardFiles) -> int | None:
    """Take the lock of a robot until the returned descriptor is closed; None if a guard holds it."""
    held = os.open(place.lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(held)
        return None
    return held


def is_held(place: GuardFiles) -> bool:
    """Return whether a guard holds the lock of a robot."""
    lock = hold(place)
    if lock is not None:
        os.close(lock)
    return lock is None


def find_guard(host: str | None = None, port: int = PORT) -> Path:
    """Return the control socket of a robot's guard, or without a ``host`` of the only running one.

    Raises:
        BackendError: no guard runs.
        UsageError: several guards run, and no ``host`` is given.
    """
    if host:
        files = place(host, port)
        if not is_held(files):
            other = f",port={port}" if port != PORT else ""
            raise BackendError(
                f"no guard of {host}:{port} is running; start one with a run on a1:host={host}{other}"
            )
        return files.control
    running = [path for path in sorted(folder().glob("*.sock")) if _runs(path.stem)]
    if not running:
        raise BackendError("no guard is running; start one with a run on a1:host=…")
    if len(running) > 1:
        names = ", ".join(path.stem.replace("_", ":") for path in running)
        raise UsageError(f"{len(running)} guards are running, for {names}; name one with --host and --port")
    return running[0]


def _runs(stem: str) -> bool:
    host, _, port = stem.rpartition("_")
    return is_held(place(host, int(port)))


def claim(place: GuardFiles) -> None:
    """Claim a robot for this process on this computer, by an abstract socket name (Linux only).

    A lock file can be deleted, and another shell may use another folder; an abstract name has no file. Two guards of
    one robot would both command its motors.

    Raises:
        BackendError: another guard has claimed the robot.
    """
    if sys.platform != "linux":
        return
    name = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        name.bind(f"\0s2r-a1 {place.lock.stem}")
    except OSError:
        name.close()
        raise BackendError(
            f"another guard on this computer uses the robot at {place.lock.stem.replace('_', ':')}, by another user "
            "or with another S2R_A1_RUN; end it first"
        ) from None
    name.detach()
