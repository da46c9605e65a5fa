"""Walk the twin ten times in lock step beside two busy loops a core: are all walks bit for bit the same?

    OMP_NUM_THREADS=1 python benchmarks/a1_busy.py [--walks 10] [--write]

Each walk is of the same test and seed, over sockets: a twin with noise, its guard and the program that walks, each in
a new process. Compared are every sample of the trace, and every packet that came to the twin or left it from the first
consent on, until the robot lies; what comes then depends on when its guard is ended. A walk without the busy loops is
the first one.

The program that walks is forked from one that has compiled its controller. A walk takes ten thousand turns between
processes, and each may wait for a busy loop: about a minute.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from machine import describe

from s2r_a1 import rawlog
from s2r_a1.backend import A1Backend
from s2r_a1.datagrams import TO_ROBOT
from s2r_a1.rollout import pilot
from s2r_spec.backend import Coming
from s2r_spec.trace import Trace
from tests.a1.rig import damping
from tests.a1.robots import Silent, in_a_process

RESULTS = Path(__file__).parent / "results" / "a1_busy.txt"
LOOPS = 2
"""A definition: busy loops a core."""
TEST, SEED, SECONDS = {"vd": 0.2}, 3, 0.5
PATIENCE = 600.0
"""A budget [s]: of one walk. Twice as much waits longer for a machine that is busier yet."""

PROCESSES = multiprocessing.get_context("fork")

Packets = tuple[list[int], list[int], tuple[bytes, ...]]
"""Rounds, directions and bytes of a recording."""


@contextmanager
def busy(loops: int) -> Iterator[None]:
    """Run so many processes that do nothing else than take time."""
    found = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(loops)]
    try:
        yield
    finally:
        for one in found:
            one.kill()
            one.wait()


def walks(line: Connection, port: int, folder: str) -> None:
    """Walk the test, and send its trace; what is asked of a worker, and of who attends to it."""
    text = f"host=127.0.0.1,port={port},velocity=onboard,operator=auto,clock=lockstep"
    backend = A1Backend(text).with_duration(SECONDS).keeping(folder)
    attended = backend.attendance(Silent())
    attended.begin(Coming(1))
    attended.before(TEST)
    trace = backend.rollout(TEST, SEED)
    attended.after(trace)
    attended.end()
    line.send(trace)


def walked(folder: Path) -> tuple[Trace, Packets]:
    """Return the trace of a walk of a new twin, and the packets that the twin recorded."""
    folder.mkdir()
    with in_a_process("--place", "lab", "--record", folder / "twin") as port:
        mine, theirs = PROCESSES.Pipe(duplex=False)
        process = PROCESSES.Process(target=walks, args=(theirs, port, str(folder)))
        process.start()
        theirs.close()
        try:
            if not mine.poll(PATIENCE):
                raise SystemExit(f"the walk took longer than {PATIENCE:g} s; try it on a quieter machine")
            trace = mine.recv()
            process.join(PATIENCE)
        finally:
            process.kill()
            process.join()
            mine.close()
    return trace, packets(folder / "twin")


def packets(path: Path) -> Packets:
    """Return what a twin recorded until it was damped, lying; the time in it is the round."""
    log = rawlog.read(path)
    both = zip(log.directions.tolist(), log.packets, strict=True)
    end = next(n for n, (way, data) in enumerate(both) if way == TO_ROBOT and data and damping(data))
    return log.times.tolist()[:end], log.directions.tolist()[:end], log.packets[:end]


def unlike(one: Trace, other: Trace) -> list[str]:
    """Return the names of what differs between two traces, in any bit."""
    found = [] if one.times.tobytes() == other.times.tobytes() else ["t"]
    names = sorted(one.channels.keys() | other.channels.keys())
    return found + [
        name
        for name in names
        if name not in one.channels
        or name not in other.channels
        or np.asarray(one[name]).tobytes() != np.asarray(other[name]).tobytes()
    ]


def compared(count: int) -> list[str]:
    """Return what is printed."""
    loops = LOOPS * (os.cpu_count() or 1)
    lines = [f"lock step, place lab, vd = {TEST['vd']} m/s, seed {SEED}, {SECONDS} s of test"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["S2R_A1_RUN"] = name
        pilot()
        trace, twins = walked(folder / "0")
        lines.append(
            f"  without load: {len(trace)} samples of {len(trace.channels)} channels, {len(twins[2])} packets"
        )
        print(lines[-1], file=sys.stderr, flush=True)
        same = 0
        with busy(loops):
            for number in range(1, count + 1):
                begun = time.monotonic()
                found = walked(folder / str(number))
                wrong = unlike(found[0], trace)
                wrong += ["packets"] if found[1] != twins else []
                same += not wrong
                took = time.monotonic() - begun
                lines.append(
                    f"  walk {number}: {', '.join(wrong) + ' differ' if wrong else 'the same'}; {took:.0f} s"
                )
                print(lines[-1], file=sys.stderr, flush=True)
    lines.append(
        f"  beside {loops} busy loops on {os.cpu_count()} cores: {same} of {count} walks bit for bit the same"
    )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--walks", type=int, default=10)
    parser.add_argument("--write", action="store_true", help=f"to {RESULTS.name}")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that no process is left behind
    lines = [str(describe("mujoco")), *compared(options.walks)]
    print("\n".join(lines))
    if options.write:
        RESULTS.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
