"""Print what the guard of a robot takes of a core at 500 Hz, while a program walks the robot in real time.

    python benchmarks/a1_load.py [--seconds 20] [--write]

Robot, guard and program are processes of their own, with UDP between them; the program sends orders with torques for
every state, as a walk does. Target: 15 % of a core where a MuJoCo step of the A1 takes 16 µs; that step is printed.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

from a1_gaps import step_of_the_a1, time_of
from machine import describe

from tests.a1.realtime import Walking

TARGET, STEP = 15.0, 16.0
"""Per cent of a core, and the step [µs] of the machine that it is meant for."""

TRIES = 5
"""A machine that is busy may end a walk before it was measured."""


def load(robot: Walking, seconds: float) -> tuple[float, float, float, str]:
    """Return the guard's share of a core [%], its rounds a second, the part of them that were late, and its state."""
    status = robot.status()
    began, used = time.monotonic(), time_of(status["pid"])
    time.sleep(seconds)
    after = robot.status()
    spent, passed = time_of(status["pid"]) - used, time.monotonic() - began
    rounds = after["rounds"] - status["rounds"]
    late = (after["late"] - status["late"]) / max(rounds, 1)
    return 100.0 * spent / passed, rounds / passed, late, after["state"]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--write", action="store_true", help="write benchmarks/results/a1_load.txt")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["S2R_A1_RUN"] = folder
        with Walking() as robot:
            for _ in range(TRIES):
                robot.walk()
                share, rate, late, state = load(robot, options.seconds)
                if state == "WALK":
                    break
    step = step_of_the_a1()
    lines = [
        str(describe("mujoco")),
        f"guard in {state} for {options.seconds:g} s: {share:.1f} % of a core at {rate:.0f} rounds a second, "
        f"{100 * late:.1f} % of them late",
        f"a MuJoCo step of the A1 takes {step:.1f} µs here; "
        f"on a machine where it takes {STEP:g} µs that is {share * STEP / step:.1f} %, target {TARGET:g} %",
    ]
    print("\n".join(lines))
    if options.write:
        path = Path(__file__).parent / "results" / "a1_load.txt"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
