"""Print the load of a guard while a robot walks in real time, as a share of a core, beside a MuJoCo step of the A1.

    python -m benchmarks.a1.load [--seconds 10]

Linux's scheduler counts the guard's time on a processor. Aim: 15 % of a core where a step of MuJoCo takes 16 µs.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.a1.gaps import step_of_the_a1
from tests.a1.realtime import Walking


def spent(pid: int) -> float:
    """Return the processor time of a process and its threads [s], which the scheduler counts in ns."""
    threads = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((thread / "schedstat").read_text().split()[0]) for thread in threads) / 1e9


def main() -> int:
    """Print the load."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    seconds = parser.parse_args().seconds
    with tempfile.TemporaryDirectory() as folder:
        os.environ["S2R_A1_RUN"] = folder
        with Walking() as robot:
            robot.walk()
            pid = robot.status()["pid"]
            before, began = spent(pid), time.monotonic()
            time.sleep(seconds)
            load = (spent(pid) - before) / (time.monotonic() - began)
            state = robot.status()["state"]
    print(
        f"{state}: the guard takes {load:.1%} of a core; a MuJoCo step of the A1 takes {step_of_the_a1():.0f} µs"
    )
    return 0 if state == "WALK" else 1


if __name__ == "__main__":
    sys.exit(main())
