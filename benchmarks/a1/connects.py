"""Count what becomes of connects to a twin in real time, on an idle computer or beside busy programs.

    python -m benchmarks.a1.connects [--connects 200] [--busy 4] [--nice 10] [--unprivileged] [--write]

A connect starts a guard, asks it to connect and to arm, and runs one short test. Guard, twin and walking program have
the niceness ``--nice``; ``--busy`` other processes compute without a pause at niceness 0. With ``--unprivileged`` no
process may take real-time priority, as for most users. A connect ends in one of these ways:

    walked       the test began, and its trace is not void
    refused      the self-test found the computer too slow, before anything moved
    void, NAME   the test began, and something other than the robot ended it
    not begun    the robot did not begin the test for another reason, which is printed

No connect may end with a worker that receives nothing while the robot stands ("deaf").
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from benchmarks.machine import describe
from s2r_a1.backend import A1Backend
from s2r_a1.guard.control import ControlError, RefusedError
from s2r_a1.guard.start import start
from s2r_spec.errors import NotBegunError

STORE = Path(__file__).parents[1] / "results" / "a1_connects.txt"


def busy() -> None:
    """Compute until the process is ended."""
    while True:
        sum(range(100_000))


def twin(port: int) -> subprocess.Popen[str]:
    """Start a twin in real time, and wait until it listens."""
    process = subprocess.Popen(
        [sys.executable, "-m", "s2r_a1.twin", "--port", str(port)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    process.stdout.readline()
    return process


def connect(backend: A1Backend, seed: int) -> str:
    """Return in one word what becomes of one connect."""
    guard, _ = start(backend.reached)
    try:
        try:
            guard.request("connect")
        except RefusedError as error:
            return "refused" if "too slow" in str(error) else f"not begun: {error}"
        try:
            guard.request("arm")
            trace = backend.rollout({"vd": 0.1}, seed)
        except (RefusedError, NotBegunError) as error:
            return f"not begun: {error}"
        return f"void, {trace.meta['void']}" if "void" in trace.meta else "walked"
    finally:
        try:
            guard.request("stop")
            while True:
                list(guard.take())
                time.sleep(0.02)
        except ControlError:
            guard.close()


def main() -> int:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--connects", type=int, default=200)
    parser.add_argument("--busy", type=int, default=0)
    parser.add_argument("--nice", type=int, default=0)
    parser.add_argument("--unprivileged", action="store_true")
    parser.add_argument("--write", action="store_true", help=f"add the answer to {STORE.name}")
    options = parser.parse_args()
    if options.unprivileged and "S2R_DROPPED" not in os.environ:
        command = [
            "setpriv",
            "--bounding-set",
            "-sys_nice",
            "--inh-caps",
            "-sys_nice",
            "--ambient-caps",
            "-all",
        ]
        os.execvpe(
            command[0],
            [*command, sys.executable, "-m", "benchmarks.a1.connects", *sys.argv[1:]],
            {**os.environ, "S2R_DROPPED": "1"},
        )
    others = [multiprocessing.Process(target=busy, daemon=True) for _ in range(options.busy)]
    for one in others:
        one.start()
    os.nice(options.nice)
    ways: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        os.environ["S2R_A1_RUN"] = folder
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        free.close()
        backend = A1Backend(
            f"host=127.0.0.1,port={port},velocity=onboard,operator=auto", duration=0.1, folder=f"{folder}/raw"
        )
        backend.prepare()
        robot = twin(port)
        try:
            for seed in range(options.connects):
                way = connect(backend, seed)
                ways[way] += 1
                print(f"{seed + 1}: {way}", flush=True)
        finally:
            robot.terminate()
    lines = [
        f"{options.connects} connects, {options.busy} busy processes, niceness {options.nice}, "
        f"{'no' if options.unprivileged else 'with'} real-time priority; {describe()}",
        *(f"  {count:4d}  {way}" for way, count in ways.most_common()),
    ]
    print("\n".join(lines))
    if options.write:
        with STORE.open("a") as store:
            store.write("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
