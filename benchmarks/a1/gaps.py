"""Print how far apart packets arrive at a robot: three empty processes on loopback, at 500 Hz.

    python -m benchmarks.a1.gaps [--seconds 60] [--write]

A robot sends a state every 2 ms and takes commands; a guard passes both on and looks into them; a worker answers each
state. None does anything else. Once they are alone, once one simulation of the A1 runs beside them. Gaps between
commands decide how long a silence may be before it is a fault, and which process may run beside a walking robot.
"""

from __future__ import annotations

import argparse
import gc
import multiprocessing
import socket
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from s2r_a1.wire import A1, CLOSED_LOOP, Orders, Reading, pack, pack_reading, unpack, unpack_orders

PERIOD = 0.002
EDGES = [0.0, 1.0, 1.5, 2.5, 3.0, 4.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0, np.inf]
LOOPBACK = "127.0.0.1"


def opened() -> socket.socket:
    """A socket on a free port of loopback."""
    socket_ = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    socket_.bind((LOOPBACK, 0))
    return socket_


def quiet() -> None:
    gc.collect()
    gc.freeze()
    gc.disable()


def robot(port: int, seconds: float, answer: Connection) -> None:
    """Send a state every 2 ms; tell when commands arrived and how late the own clock was."""
    link = opened()
    link.connect((LOOPBACK, port))
    link.setblocking(False)
    zero = np.zeros(12)
    state = Reading(
        np.array([1.0, 0, 0, 0]), np.zeros(3), np.array([0, 0, 9.81]), zero, zero, zero, zero,
        np.full(12, CLOSED_LOOP), 0,
    )  # fmt: skip
    arrivals, own = [], []
    quiet()
    start = time.perf_counter()
    for tick in range(round(seconds / PERIOD)):
        due = start + tick * PERIOD
        while (left := due - time.perf_counter()) > 0:
            time.sleep(left)
            receive(link, arrivals)
        own.append(time.perf_counter() - due)
        link.send(pack_reading(state._replace(tick=tick), A1))
        receive(link, arrivals)
    answer.send((np.array(arrivals), np.array(own)))


def receive(link: socket.socket, arrivals: list[float]) -> None:
    try:
        while True:
            unpack_orders(link.recv(2048), A1)
            arrivals.append(time.perf_counter())
    except (BlockingIOError, ConnectionRefusedError):
        return


def guard(outer: socket.socket, inner: socket.socket, worker: int) -> None:
    """Pass states to the worker and its commands to the robot, after a look into each."""
    import select

    quiet()
    address = None
    while True:
        for ready in select.select([outer, inner], [], [], 1.0)[0]:
            if ready is outer:
                data, address = outer.recvfrom(2048)
                unpack(data, A1)
                inner.sendto(data, (LOOPBACK, worker))
            elif address is not None:
                data = inner.recv(2048)
                unpack_orders(data, A1)
                outer.sendto(data, address)


def worker(inner: socket.socket, port: int) -> None:
    """Answer every state with a command."""
    zero = np.zeros(12)
    quiet()
    while True:
        unpack(inner.recv(2048), A1)
        inner.sendto(pack(Orders(zero, zero, zero, zero, zero), A1), (LOOPBACK, port))


def simulation() -> None:
    from s2r_spec.backend import load_backend

    backend = load_backend("sim")
    seed = 0
    while True:
        backend.rollout({"vd": 0.3}, seed=seed)
        seed += 1


def run(seconds: float, beside: bool) -> str:
    context = multiprocessing.get_context("fork")
    outer, inner, client = opened(), opened(), opened()
    ours, theirs = context.Pipe()
    port = outer.getsockname()[1]
    helpers = [
        context.Process(target=guard, args=(outer, inner, client.getsockname()[1]), daemon=True),
        context.Process(target=worker, args=(client, inner.getsockname()[1]), daemon=True),
    ]
    if beside:
        helpers.append(context.Process(target=simulation, daemon=True))
    for process in helpers:
        process.start()
    if beside:
        time.sleep(20.0)  # until it is compiled and warm
    machine = context.Process(target=robot, args=(port, seconds, theirs), daemon=True)
    machine.start()
    arrivals, own = ours.recv()
    times = [time_of(process.pid) for process in helpers[:2]]
    for process in helpers:
        process.terminate()
        process.join()
    machine.join()
    gaps = np.diff(arrivals) * 1e3
    lines = [
        f"{'one simulation beside' if beside else 'alone'}: {len(arrivals)} of {len(own)} commands arrived "
        f"in {seconds:g} s; "
        f"guard {times[0] / seconds * 100:.0f} %, worker {times[1] / seconds * 100:.0f} % of a core",
        f"  the robot's own clock is late by [ms]: median {np.median(own) * 1e3:.3f}, "
        f"p99 {np.quantile(own, 0.99) * 1e3:.3f}, max {own.max() * 1e3:.2f}",
        f"  gap between commands [ms]: median {np.median(gaps):.2f}, p99 {np.quantile(gaps, 0.99):.2f}, "
        f"p99.9 {np.quantile(gaps, 0.999):.2f}, max {gaps.max():.2f}",
    ]
    counts, _ = np.histogram(gaps, EDGES)
    lines += [
        f"  {low:5g} to {high:5g} ms: {count:6d}"
        for low, high, count in zip(EDGES[:-1], EDGES[1:], counts, strict=True)
        if count
    ]
    return "\n".join(lines)


def time_of(pid: int | None) -> float:
    """Processor time that a process has used [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


def step_of_the_a1() -> float:
    """Median time of a MuJoCo step of the A1 [µs]."""
    import mujoco

    from s2r_sim.plant import mujoco_model
    from s2r_sim.plant.physics import Physics
    from s2r_sim.robot.constants import A1 as ROBOT

    model = mujoco_model.build(ROBOT, Physics())
    data = mujoco.MjData(model)
    times = []
    for _ in range(2000):
        start = time.perf_counter()
        mujoco.mj_step(model, data)
        times.append(time.perf_counter() - start)
    return float(np.median(times)) * 1e6


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--write", action="store_true", help="write benchmarks/results/a1_gaps.txt")
    options = parser.parse_args()
    text = "\n".join(
        [
            f"{multiprocessing.cpu_count()} cores, a MuJoCo step of the A1 takes {step_of_the_a1():.0f} µs, "
            f"Python {sys.version.split()[0]}",
            run(options.seconds, beside=False),
            run(options.seconds, beside=True),
        ]
    )
    print(text)
    if options.write:
        path = Path(__file__).parents[1] / "results" / "a1_gaps.txt"
        path.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
