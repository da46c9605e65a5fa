"""Count what becomes of connects to a twin in real time, on an idle computer or beside busy programs.

    python -m benchmarks.a1.connects [--connects 200] [--busy 4] [--nice 10] [--unprivileged] [--write]

A connect starts a guard, asks it to connect and to arm, and runs one short test. The twin stands for a robot with a
computer of its own: it has real-time priority, if the system allows it. Guard and walking program have the niceness
``--nice``, and with ``--unprivileged`` no real-time priority, as for most users; ``--busy`` other processes compute
without a pause at niceness 0. A connect ends in one of these ways:

    walked       the test began, and its trace is not void
    refused      the computer was found too slow, before the test
    void, NAME   the test began, and something other than the robot ended it
    not begun    the robot did not begin the test for another reason, which is printed

No connect may end with a worker that receives nothing while the robot stands ("deaf").
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

from benchmarks.a1.gaps import step_of_the_a1
from benchmarks.machine import processor
from s2r_a1.backend import A1Backend
from s2r_a1.guard.control import ControlError, RefusedError
from s2r_a1.guard.start import start
from s2r_spec.errors import NotBegunError

UNPRIVILEGED = ("setpriv", "--bounding-set", "-sys_nice", "--inh-caps", "-sys_nice", "--ambient-caps", "-all")
STORE = Path(__file__).parents[1] / "results" / "a1_connects.txt"


def busy() -> None:
    """Compute until the process is ended."""
    while True:
        sum(range(100_000))


def first() -> None:
    """Take real-time priority, if the system allows it."""
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30))


def twin() -> tuple[subprocess.Popen[str], int]:
    """Start a twin in real time; return it, and its port once it listens."""
    process = subprocess.Popen(
        [sys.executable, "-m", "s2r_a1.twin", "--port", "0"],
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=first,
    )
    assert process.stdout is not None
    port = re.search(r":(\d+),", process.stdout.readline())
    assert port is not None
    return process, int(port[1])


def connect(backend: A1Backend, seed: int) -> str:
    """Return what becomes of one connect."""
    guard, _ = start(backend.reached)
    try:
        guard.request("connect")
        guard.request("arm")
        trace = backend.rollout({"vd": 0.1}, seed)
    except (RefusedError, NotBegunError) as error:
        slow = "too slow" in str(error) or "too busy" in str(error)
        return "refused" if slow else f"not begun: {error}"
    else:
        return f"void, {trace.meta['void']}" if "void" in trace.meta else "walked"
    finally:
        try:
            guard.request("stop")
            while True:
                list(guard.take())
                time.sleep(0.02)
        except ControlError:
            guard.close()


def run(connects: int, port: int) -> int:
    """Connect again and again, and print what became of each connect."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["S2R_A1_RUN"] = folder
        backend = A1Backend(
            f"host=127.0.0.1,port={port},velocity=onboard,operator=auto", duration=0.1, folder=f"{folder}/raw"
        )
        backend.prepare()
        for seed in range(connects):
            print(connect(backend, seed), flush=True)
    return 0


def main() -> int:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--connects", type=int, default=200)
    parser.add_argument("--busy", type=int, default=0)
    parser.add_argument("--nice", type=int, default=0)
    parser.add_argument("--unprivileged", action="store_true")
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--write", action="store_true", help=f"add the answer to {STORE.name}")
    options = parser.parse_args()
    if options.port:
        return run(options.connects, options.port)
    robot, port = twin()
    others = [multiprocessing.Process(target=busy, daemon=True) for _ in range(options.busy)]
    for one in others:
        one.start()
    command = [
        sys.executable,
        "-m",
        "benchmarks.a1.connects",
        f"--connects={options.connects}",
        f"--port={port}",
    ]
    if options.unprivileged:
        command = [*UNPRIVILEGED, *command]
    ways: Counter[str] = Counter()
    with subprocess.Popen(
        ["nice", "-n", str(options.nice), *command], stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        for line in child.stdout:
            print(line, end="", flush=True)
            ways[line.strip()] += 1
    robot.terminate()
    lines = [
        f"{options.connects} connects, {options.busy} busy processes, niceness {options.nice}, "
        f"{'no' if options.unprivileged else 'with'} real-time priority; {processor()}, {os.cpu_count()} cores, "
        f"a MuJoCo step of the A1 takes {step_of_the_a1():.0f} µs",
        *(f"  {count:4d}  {way}" for way, count in ways.most_common()),
    ]
    print("\n".join(lines))
    if options.write:
        with STORE.open("a") as store:
            store.write("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
