"""Time limits of a call in a worker process: processor time for work, wall time for a call that hangs.

A busy computer makes a rollout take longer, but hardly more processor time. So a simulated rollout may use its limit in
processor time, and ten times as much on the wall clock. A rollout of a machine, and the opening of a backend, are
limited on the wall clock alone.
"""

from __future__ import annotations

import math
import os
import re
import subprocess
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

HANG = 10.0
"""Budget: wall-clock limit of a rollout, as a multiple of its limit in processor time (dimensionless)."""
_PROCESSES = Path("/proc")
_PS_TIME = re.compile(r"(?:(\d+)-)?(?:(\d+):)?(\d+):(\d+(?:\.\d+)?)")  # days, hours, minutes, seconds


@dataclass(frozen=True)
class Limit:
    """A time limit, from the moment at which the worker sets it.

    Attributes:
        wall: longest time on the wall clock [s].
        cpu: most processor time of the worker and the children it waited for [s]. It ends no call earlier than this
            time on the wall clock, so several threads have as long as one.
        opening: whether the call still opens its backend.
    """

    wall: float = math.inf
    cpu: float = math.inf
    opening: bool = False

    @classmethod
    def of_simulation(cls, seconds: float) -> Limit:
        """Return the limit of a simulated rollout from its limit in processor time [s]."""
        return cls(HANG * seconds, seconds)

    @property
    def first(self) -> float:
        """Time until a look at the call can first find that it exceeded the limit [s]."""
        return min(self.wall, self.cpu)


class TimeLimitError(Exception):
    """A call exceeded its time limit after ``elapsed`` on the wall clock [s], and its process was ended.

    ``cpu`` says whether the limit in processor time was exceeded; else it was the one on the wall clock.
    """

    def __init__(self, limit: Limit, elapsed: float, cpu: bool = False) -> None:
        super().__init__(limit, elapsed, cpu)
        self.limit, self.elapsed, self.cpu = limit, elapsed, cpu

    @property
    def words(self) -> str:
        """The exceeded limit, as in "60 s of CPU time"."""
        return f"{self.limit.cpu:g} s of CPU time" if self.cpu else f"{self.limit.wall:g} s of wall time"


def own_cpu_time() -> float:
    """Return the processor time of this process so far, in the sense of :func:`cpu_time` [s]."""
    times = os.times()
    own = times.user + times.system
    return own + times.children_user + times.children_system if _counts_children() else own


def cpu_time(pid: int) -> float | None:
    """Return the processor time of another process so far [s]; None if it is unknown.

    On Linux this includes children that have ended and that it waited for.
    """
    with suppress(OSError, ValueError, IndexError, subprocess.SubprocessError):
        if _counts_children():
            words = (_PROCESSES / str(pid) / "stat").read_bytes().rpartition(b")")[2].split()
            return sum(map(int, words[11:15])) / os.sysconf("SC_CLK_TCK")
        command = ["ps", "-o", "time=", "-p", str(pid)]
        text = subprocess.run(command, capture_output=True, text=True, check=True, timeout=HANG).stdout
        if match := _PS_TIME.fullmatch(text.strip()):
            days, hours, minutes, seconds = (float(group or 0) for group in match.groups())
            return 86400 * days + 3600 * hours + 60 * minutes + seconds
    return None


def _counts_children() -> bool:
    return (_PROCESSES / "self" / "stat").exists()
