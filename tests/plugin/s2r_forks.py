"""Backends that start processes, as real simulators do. What it does is in its name: ``forks:HABIT``.

``pool``, ``executor`` and ``spawn`` ask processes of :mod:`multiprocessing`, ``fork`` forks by hand, and they answer.
With ``-hang`` behind it they hang above 0.29 m/s, and their processes with them; ``stubborn-hang`` ignores SIGTERM and
holds the interpreter's lock; ``daemon`` leaves a process in a session of its own; ``twice`` comes back from its rollout
in two processes, ``copies`` in one that also raises; ``writes`` writes into every file that it finds open.
The process ids of all that hang are noted in the file that ``S2R_FORKS`` names.
"""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from s2r_toy import Toy

LONG = 1000.0


def note(*pids: int) -> None:
    """Add process ids to the file of the test, each with its group."""
    with Path(os.environ["S2R_FORKS"]).open("a") as file:
        file.writelines(f"{pid} {os.getpgid(pid)}\n" for pid in pids)


def work(seconds: float) -> float:
    """Do what a part of a simulation does in another process."""
    if seconds:
        note(os.getpid())
        time.sleep(seconds)
    return seconds


class Forks(Toy):
    def __init__(self, habit: str = "") -> None:
        super().__init__()
        self.habit, _, self.hangs = habit.partition("-")
        self.name = f"forks:{habit}"

    def with_duration(self, seconds: float) -> Forks:
        longer = type(self)(self.name.partition(":")[2])
        longer.duration = seconds
        return longer

    def rollout(self, params, seed):
        long = LONG if self.hangs and params["vd"] > 0.29 else 0.0
        if long:
            note(os.getpid())
        getattr(self, self.habit)(long)
        if long:
            time.sleep(long)
        return super().rollout(params, seed)

    def pool(self, long: float) -> None:
        with multiprocessing.get_context("fork").Pool(2) as pool:
            assert pool.map(work, [long, long]) == [0, 0]

    def executor(self, long: float) -> None:
        with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("fork")) as pool:
            assert list(pool.map(work, [long, long])) == [0, 0]

    def spawn(self, long: float) -> None:
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            assert list(pool.map(work, [long])) == [0]

    def fork(self, long: float) -> None:
        if (pid := os.fork()) == 0:
            work(long)
            sys.exit(7)
        if not long:
            assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 7

    def stubborn(self, long: float) -> None:
        code = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(flush=True); time.sleep(999)"
        if long:
            child = subprocess.Popen([sys.executable, "-S", "-c", code], stdout=subprocess.PIPE)
            child.stdout.readline()
            note(child.pid)
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            ctypes.PyDLL(None).sleep(int(long))

    def daemon(self, long: float) -> None:
        child = subprocess.Popen(["sleep", "999"], start_new_session=True)
        note(child.pid)

    def twice(self, long: float) -> None:
        if os.fork() == 0:
            time.sleep(0.05)  # so that it comes back while the next rollout runs

    def copies(self, long: float) -> None:
        if os.fork() == 0:
            raise ValueError("only the copy fails")

    def writes(self, long: float) -> None:
        for descriptor in range(3, 32):
            with contextlib.suppress(OSError):
                os.write(descriptor, b"a line of a log that went astray: " + bytes(40))
