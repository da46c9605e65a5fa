"""Print what a packet each way costs beside a MuJoCo step of the A1.

    python benchmarks/a1_wire.py [--write]

A guard looks into every state and makes every command: it decodes one, with its checksum, and encodes the other. The
target is 0.15 ms for both on a machine where a step takes 16 µs; elsewhere it grows with the step.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from a1_gaps import step_of_the_a1
from machine import describe

from s2r_a1.wire import (
    A1,
    CLOSED_LOOP,
    GO1,
    Layout,
    Orders,
    Reading,
    checksum,
    pack,
    pack_reading,
    unpack,
    unpack_orders,
)

TARGET, STEP = 150.0, 16.0
"""Levels [µs]: encode, decode and checksums, where a step of the A1 takes the second."""
REPEATS = 5000


def median(call: Callable[[], object]) -> float:
    """Median time of a call [µs]."""
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter_ns()
        call()
        times.append(time.perf_counter_ns() - start)
    return float(np.median(times)) / 1e3


def costs(layout: Layout) -> dict[str, float]:
    """Return the median time of each operation [µs]."""
    rng = np.random.default_rng(0)
    orders = Orders(*rng.uniform(0, 20, (5, 12)))
    reading = Reading(
        np.array([1.0, 0, 0, 0]), np.zeros(3), np.array([0, 0, 9.81]), *rng.normal(size=(3, 12)), np.full(12, 30.0),
        np.full(12, CLOSED_LOOP), 1,
    )  # fmt: skip
    command, state = pack(orders, layout), pack_reading(reading, layout)
    return {
        "encode a command": median(lambda: pack(orders, layout)),
        "decode a state": median(lambda: unpack(state, layout)),
        "  checksum of a command, in it": median(lambda: checksum(command)),
        "  checksum of a state, in it": median(lambda: checksum(state)),
        "decode a command (guard, twin)": median(lambda: unpack_orders(command, layout)),
        "encode a state (twin)": median(lambda: pack_reading(reading, layout)),
    }


def report() -> str:
    machine = describe("numpy", "mujoco")
    step = step_of_the_a1()
    lines = [
        f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}, {machine['date']}",
        f"a MuJoCo step of the A1: {step:.1f} µs",
    ]
    for layout in (A1, GO1):
        found = costs(layout)
        both = found["encode a command"] + found["decode a state"]
        lines += [f"{layout.name} [µs]", *(f"  {name:32} {cost:6.1f}" for name, cost in found.items())]
        lines += [
            f"  a command and a state            {both:6.1f}: {both / step:.1f} steps; the target is "
            f"{TARGET / STEP:.1f} steps, {'met' if both / step <= TARGET / STEP else 'missed'}"
        ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write", action="store_true", help="write benchmarks/results/a1_wire.txt")
    options = parser.parse_args()
    text = report()
    print(text)
    if options.write:
        path = Path(__file__).parent / "results" / "a1_wire.txt"
        path.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
