"""A worker and all that it starts, as one group of processes: watched, and ended whole.

A worker leads a process group of its own, so that what it forks and spawns is in it, and Ctrl-C at the terminal
reaches s2r alone. It stays in the session of s2r: Linux shares out processor time by session, and workers in many
would take more than their share. Beside the worker waits a guard, a shell of a megabyte: when s2r is gone, whatever
killed it, the guard ends the group, even if the worker is stopped or holds the interpreter's lock. What leaves the
group by itself (a daemon) is not hunted: :meth:`Group.left` finds it, where the system has ``/proc``.

Where there are no process groups (Windows) only the worker itself is ended.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from time import monotonic, sleep
from uuid import uuid4

GRACE = 1.0
"""Budget: what a group that was asked to end (SIGTERM) may take before it is killed [s]. Twice as much delays
Ctrl-C and ``--timeout`` by as much where a process ignores SIGTERM."""
MARK = "S2R_WORKER"
"""Definition: the environment variable by which a process is known to come from a worker."""

_PROCESSES = Path("/proc")
_OFTEN = 0.02  # how often a group is looked at while it ends [s]
_LONGEST = 80  # characters of a command line that are shown
_GUARD = 'read -r word || { sleep 1; kill -KILL -"$0"; }'


@dataclass(frozen=True)
class Process:
    """A process of this machine: its number, and how it was started."""

    pid: int
    command: str


class Group:
    """One process with pipes to its standard input and output, and all that it starts.

    Args:
        command: of the process.
        environment: of it; the mark of the group is added.
    """

    def __init__(self, command: Sequence[str], environment: Mapping[str, str]) -> None:
        self._mark = uuid4().hex
        self.process: subprocess.Popen[bytes] = subprocess.Popen(
            command,
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**environment, MARK: self._mark},
            process_group=None if sys.platform == "win32" else 0,
        )
        self._guard = _guard(self.process.pid)
        self._ending, self._ended = Lock(), False

    def end(self) -> bool:
        """End all processes of the group: ask (SIGTERM), wait for GRACE, kill.

        Returns:
            Whether it was still to be done.
        """
        with self._ending:
            if self._ended:  # then its number may be another group's by now
                return False
            self._end()
            self._ended = True
            return True

    def _end(self) -> None:
        if sys.platform == "win32":
            self.process.kill()
            self.process.wait()
            return
        # A process that is stopped sees no SIGTERM before it goes on.
        for signals in ((signal.SIGTERM, signal.SIGCONT), (signal.SIGKILL,)):
            for number in signals:
                with suppress(ProcessLookupError, PermissionError):
                    os.killpg(self.process.pid, number)
            if self._ends():
                return

    def _ends(self) -> bool:
        """Return whether the group ends within GRACE."""
        end = monotonic() + GRACE
        while True:
            # The first also takes note of the worker's end: it would stay in the group as a zombie.
            if self.process.poll() is not None and not _lives(self.process.pid):
                return True
            if monotonic() > end:
                return False
            sleep(_OFTEN)

    def left(self) -> list[Process]:
        """Return the processes that come from this worker, left its group, and still run."""
        mark = f"{MARK}={self._mark}".encode()
        return [
            Process(pid, _command(pid))
            for pid, group in _running()
            if group != self.process.pid and mark in _bytes(pid, "environ").split(b"\0")
        ]

    def release(self) -> None:
        """Dismiss the guard, and close the pipes of a group that has ended."""
        if self._guard is not None and self._guard.stdin is not None:
            with suppress(OSError, ValueError):  # it was killed, or is dismissed already
                self._guard.stdin.write(b"\n")
        self.disown()
        if self._guard is not None:
            with suppress(subprocess.TimeoutExpired):
                self._guard.wait(GRACE)

    def disown(self) -> None:
        """Close the pipes, here: of a copy of this process that was forked, or of a group that has ended."""
        pipes = [self.process.stdin, self.process.stdout, self._guard.stdin if self._guard else None]
        for pipe in filter(None, pipes):
            with suppress(OSError):
                pipe.close()


def _guard(group: int) -> subprocess.Popen[bytes] | None:
    """Start what kills a group when this process is gone; None where there is no shell."""
    if sys.platform == "win32":
        return None
    try:
        return subprocess.Popen(
            ["/bin/sh", "-c", _GUARD, str(group)],
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={"PATH": os.defpath},
            start_new_session=True,
        )
    except OSError:  # then the worker itself is all that sees to it
        return None


def _lives(group: int) -> bool:
    """Return whether a process of the group still runs; a zombie does not, and may stay for long."""
    if sys.platform == "win32":
        return False
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return not _PROCESSES.joinpath("self", "stat").exists() or any(of == group for _, of in _running())


def _running() -> Iterator[tuple[int, int]]:
    """Yield (process, its group) of all processes that are no zombies; nothing where there is no ``/proc``."""
    with suppress(OSError):
        for name in filter(str.isdigit, os.listdir(_PROCESSES)):
            # 4711 (any name) S parent group …
            words = _bytes(int(name), "stat").rpartition(b")")[2].split()
            if len(words) > 2 and words[0] not in b"ZX":
                yield int(name), int(words[2])


def _command(pid: int) -> str:
    """Return how a process was started, in one line without control characters."""
    words = _bytes(pid, "cmdline").decode(errors="replace").split("\0")
    line = "".join(letter if letter.isprintable() else "?" for letter in " ".join(words).strip())
    return line if len(line) <= _LONGEST else line[: _LONGEST - 1] + "…"


def _bytes(pid: int, what: str) -> bytes:
    """Return what the system says of a process; nothing of one that is gone, or is somebody else's."""
    try:
        return (_PROCESSES / str(pid) / what).read_bytes()
    except OSError:
        return b""
