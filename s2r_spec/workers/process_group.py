"""A worker and its descendants as one process group, which ends as a whole.

A worker leads a process group of its own. Its descendants belong to the group, and Ctrl-C at the terminal reaches s2r
alone. The group stays in the session of s2r, because Linux shares processor time by session. A watchdog, a shell of a
megabyte, waits beside the worker. It ends the group when s2r is gone for any reason, even if the worker is stopped or
holds the interpreter's lock. A descendant that leaves the group, as a daemon does, is not ended;
:meth:`ProcessGroup.escaped` finds it on systems with ``/proc``.

On Windows, which has no process groups, only the worker itself is ended.
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
"""Budget: time between a group's SIGTERM and its SIGKILL [s]."""
MARK = "S2R_WORKER"
"""Definition: the environment variable that marks the descendants of a worker."""

_PROCESSES = Path("/proc")
_POLL = 0.02  # interval between two looks at a group that ends [s]
_LONGEST = 80  # characters of a command line in a message
_WATCHDOG = 'read -r word || { sleep 1; kill -KILL -"$0"; }'


@dataclass(frozen=True)
class Process:
    """A process of this computer: its id and its command line."""

    pid: int
    command: str


class ProcessGroup:
    """A process with pipes to its standard input and output, and all its descendants.

    The group adds its mark to the environment.
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
        self._watchdog = _watchdog(self.process.pid)
        self._ending, self._ended = Lock(), False

    def end(self) -> bool:
        """End all processes of the group: SIGTERM, wait for GRACE, SIGKILL.

        Returns:
            False if an earlier call has ended the group.
        """
        with self._ending:
            if self._ended:  # another group may have its id by now
                return False
            self._end()
            self._ended = True
            return True

    def _end(self) -> None:
        if sys.platform == "win32":
            self.process.kill()
            self.process.wait()
            return
        # A stopped process handles SIGTERM only after SIGCONT.
        for signals in ((signal.SIGTERM, signal.SIGCONT), (signal.SIGKILL,)):
            for number in signals:
                with suppress(ProcessLookupError, PermissionError):
                    os.killpg(self.process.pid, number)
            if self._ends():
                return

    def _ends(self) -> bool:
        end = monotonic() + GRACE
        while True:
            # poll() also reaps the worker, which would stay in the group as a zombie.
            if self.process.poll() is not None and not _lives(self.process.pid):
                return True
            if monotonic() > end:
                return False
            sleep(_POLL)

    def escaped(self) -> list[Process]:
        """Return the descendants of this worker that left its group and still run."""
        mark = f"{MARK}={self._mark}".encode()
        return [
            Process(pid, _command(pid))
            for pid, group in _running_processes()
            if group != self.process.pid and mark in _bytes(pid, "environ").split(b"\0")
        ]

    def release(self) -> None:
        """Stop the watchdog, and close the pipes of a group that has ended."""
        if self._watchdog is not None and self._watchdog.stdin is not None:
            with suppress(OSError, ValueError):  # it was killed, or was stopped before
                self._watchdog.stdin.write(b"\n")
        self.disown()
        if self._watchdog is not None:
            with suppress(subprocess.TimeoutExpired):
                self._watchdog.wait(GRACE)

    def disown(self) -> None:
        """Close this process's ends of the pipes, in a fork or after the end of the group."""
        pipes = [self.process.stdin, self.process.stdout, self._watchdog.stdin if self._watchdog else None]
        for pipe in filter(None, pipes):
            with suppress(OSError):
                pipe.close()


def _watchdog(group: int) -> subprocess.Popen[bytes] | None:
    """Start the shell that kills a group when this process is gone; None on systems without a shell."""
    if sys.platform == "win32":
        return None
    try:
        return subprocess.Popen(
            ["/bin/sh", "-c", _WATCHDOG, str(group)],
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={"PATH": os.defpath},
            start_new_session=True,
        )
    except OSError:  # only the worker itself can then notice the end of s2r
        return None


def _lives(group: int) -> bool:
    """Return whether a process of the group still runs; a zombie does not."""
    if sys.platform == "win32":
        return False
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return not _PROCESSES.joinpath("self", "stat").exists() or any(
        of == group for _, of in _running_processes()
    )


def _running_processes() -> Iterator[tuple[int, int]]:
    """Yield (process, its group) of all processes except zombies; nothing on systems without ``/proc``."""
    with suppress(OSError):
        for name in filter(str.isdigit, os.listdir(_PROCESSES)):
            # 4711 (any name) S parent group …
            words = _bytes(int(name), "stat").rpartition(b")")[2].split()
            if len(words) > 2 and words[0] not in b"ZX":
                yield int(name), int(words[2])


def _command(pid: int) -> str:
    """Return the command line of a process, shortened and without control characters."""
    words = _bytes(pid, "cmdline").decode(errors="replace").split("\0")
    line = "".join(letter if letter.isprintable() else "?" for letter in " ".join(words).strip())
    return line if len(line) <= _LONGEST else line[: _LONGEST - 1] + "…"


def _bytes(pid: int, entry: str) -> bytes:
    """Return an entry of ``/proc`` for a process; empty if the process is gone or belongs to another user."""
    try:
        return (_PROCESSES / str(pid) / entry).read_bytes()
    except OSError:
        return b""
