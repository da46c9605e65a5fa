"""Print how long a robot moves on after something went wrong: from the condition to the first packet that damps it.

    python -m benchmarks.a1.faults [--steps | --row TEXT] [--times 20] [--write]

Lock step (alone with ``--steps``): every row of the fault table (tests/a1/faults.py), at 20 moments each, counted in
the robot's rounds of 2 ms. Real time: the rows where the clock on the wall matters, and SIGKILL of client and guard and
SIGSTOP of the client for 50 ms and 5 s, at 20 random moments each. Every row has a time of its own before its condition
is met, as the 20 ms of a silence; what is printed comes on top. Target: 4 ms median, 20 ms worst, on two quiet cores.

A process that is killed first gives its memory back, and then closes its connections: that takes the system 20 ms for
the 200 MB of a client. So the condition of that row is whichever comes first, the end of its connections or 20 ms of
silence; the former is printed beside it. What reaches the twin waits for its next round, 1 ms on average.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.machine import describe
from s2r_a1.guard.place import hold, place
from s2r_a1.guard.states import State
from tests.a1.faults import DAMPED, Fault
from tests.a1.realtime import Walking, first_damped, moves_after
from tests.a1.rig import Rig, apart, damping
from tests.processes import lives, until

ROUND = 2.0  # ms
TRIES = 3
"""A machine that is busy ends walks by itself; so many times as many are tried."""
SETTLED = 0.3
"""Seconds after a fault that are looked at for packets that move the robot."""


class Row:
    """What was measured of a row: latencies [ms], and what came after the first damping packet."""

    def __init__(self, name: str, own: float, word: str) -> None:
        self.name, self.own, self.word = name, own, word
        self.note = ""
        self.latencies: list[float] = []
        self.moved = self.without = 0
        self.others: dict[str, int] = {}

    def add(self, latency: float | None, moved: int, word: str | None) -> None:
        """Add what was measured; where something else ended the walk before, it is only counted."""
        self.moved += moved
        if word != self.word:
            self.early(word)
        elif latency is None:
            self.without += 1
        else:
            self.latencies.append(latency)

    def early(self, word: str | None) -> None:
        """Count a walk that ended before the fault began, or by another condition."""
        self.others[str(word)] = self.others.get(str(word), 0) + 1

    def __str__(self) -> str:
        found = np.array(self.latencies or [np.nan])
        notes = [self.note] if self.note else []
        notes += [f"{self.moved} packets moved it after that"] if self.moved else []
        notes += [f"{self.without} times none"] if self.without else []
        notes += [f"{count} × ended by {word} before" for word, count in self.others.items()]
        return (
            f"  {self.name:48s} {self.own:6.0f}  {np.median(found):7.2f} {found.max():7.2f}  {self.word:9s}"
            f"{'; '.join(notes)}"
        )


HEAD = f"  {'row':48s} {'own ms':>6s}  {'median':>7s} {'worst':>7s}  word"


def in_steps(times: int) -> list[str]:
    """Measure every row in lock step, in a walk, each at ``times`` moments."""
    rig = Rig()
    for state in rig.bring(None):
        if state is State.WALK:
            break
    rows = {
        fault.name: Row(fault.name, own(fault), fault.word) for fault in DAMPED if State.WALK in fault.states
    }
    moments = np.random.default_rng(0).integers(1, 20, times)
    for moment in moments:
        rig.turn(int(moment))
        for fault in DAMPED:
            if fault.name in rows:
                rows[fault.name].add(*apart(lambda fault=fault: stepped(rig, fault)))
    rig.close()
    return [f"lock step, {times} moments a row [ms]", HEAD, *map(str, rows.values())]


def own(fault: Fault) -> float:
    """Return the time of a fault before its condition is met [ms]: of its first round, none has passed."""
    return ROUND * (fault.rounds if fault.rounds == 10 else fault.rounds - 1)


def stepped(rig: Rig, fault: Fault) -> tuple[float | None, int, str | None]:
    begun = rig.twin.rounds
    fault.begins(rig)
    rig.turn(fault.rounds + 30)
    packets = [(at, data) for at, data in rig.received if at >= begun]
    damped = next((at for at, data in packets if damping(data)), None)
    if damped is None:
        return None, 0, rig.guard.machine.word
    # The condition is met by the state of round begun + rounds − 1, which the robot sends at the end of that round.
    latency = ROUND * (damped - (begun + fault.rounds - 1))
    return latency, sum(not damping(data) for at, data in packets if at > damped), rig.guard.machine.word


def in_real_time(times: int, chosen: str) -> list[str]:
    """Measure what needs the clock on the wall."""
    random = np.random.default_rng(1)
    lines = [f"real time, {times} random moments a row [ms]", HEAD]
    with Walking() as robot:
        for name, ms, word, happens in REAL:
            if chosen not in name:
                continue
            row = Row(name, ms, word)
            closed: list[float] = []
            for _ in range(TRIES * times):
                if len(row.latencies) == times:
                    break
                robot.walk()
                time.sleep(random.uniform(0.0, 0.1))
                robot.taken()
                begun = happens(robot)
                time.sleep(SETTLED)
                stamps, received = robot.taken()
                if begun < 0:  # a round's number
                    begun = stamps[-begun]
                own_time = ms
                if happens is killed:
                    closed.append((robot.client_closed - begun) / 1e6)
                    own_time = min(ms, closed[-1])
                damped = first_damped(received, 0)
                if damped and damped < begun:
                    row.early(robot.status()["word"])
                    continue
                latency = None if damped is None else (damped - begun) / 1e6 - own_time
                row.add(latency, moves_after(received, damped) if damped else 0, robot.status()["word"])
            if closed:
                row.note = f"the system closed its connections after {np.median(closed):.0f} ms (median)"
            lines.append(str(row))
            print(row, file=sys.stderr, flush=True)
        if chosen in "SIGKILL of the guard":
            lines += guards(robot, times, random)
    return lines


def injected(*texts: str) -> Callable[[Walking], int]:
    """Return what gives a fault; its round, as a negative number, is what the first faulty state was sent in."""
    return lambda robot: -robot.inject(*texts)


def killed(robot: Walking) -> int:
    now = time.monotonic_ns()
    os.kill(robot.client.pid, signal.SIGKILL)
    robot.until_client_closed()
    return now


def stopped(seconds: float) -> Callable[[Walking], int]:
    """Return what stops the client, lets it wake, and sees that nothing it asks for is done."""

    def happens(robot: Walking) -> int:
        now = time.monotonic_ns()
        os.kill(robot.client.pid, signal.SIGSTOP)
        time.sleep(seconds)
        os.kill(robot.client.pid, signal.SIGCONT)
        refused = robot.client_reply.recv()
        assert len(refused) == 3, refused
        assert robot.status()["state"] == "DAMPING"
        return now

    return happens


def asked(do: str) -> Callable[[Walking], int]:
    def happens(robot: Walking) -> int:
        now = time.monotonic_ns()
        robot.operator.request(do)
        return now

    return happens


REAL = (
    ("silence of the robot", 20.0, "link", injected("silence")),
    ("tick stands still", 20.0, "link", injected("stuck_tick")),
    ("motor error 4", 0.0, "motor", injected("error=4:4")),
    ("tilt of 0.6 rad", 0.0, "fall", injected("tilt=0.6")),
    ("R2", 0.0, "operator", injected("button=R2")),
    ("second Ctrl-C", 0.0, "operator", asked("damp")),
    ("SIGKILL of the client", 20.0, "client", killed),
    ("SIGKILL of the search", 0.0, "operator", Walking.kill_search),
    ("SIGSTOP of the client for 50 ms", 20.0, "client", stopped(0.05)),
    ("SIGSTOP of the client for 5 s", 20.0, "client", stopped(5.0)),
)


def guards(robot: Walking, times: int, random: np.random.Generator) -> list[str]:
    """Kill the guard: the robot gets nothing more, and its own rule holds; no lock is left."""
    most = held = 0
    for _ in range(times):
        robot.walk()
        time.sleep(random.uniform(0.0, 0.1))
        pid = robot.status()["pid"]
        robot.kill_guard()
        until(lambda pid=pid: not lives(pid))
        robot.taken()
        time.sleep(SETTLED)
        _, received = robot.taken()
        most = max(most, len(received))
        lock = hold(place(robot.robot.host, robot.robot.port))
        if lock is None:
            held += 1
        else:
            os.close(lock)
    return [
        f"  SIGKILL of the guard, {times} times: at most {most} packets after it, {held} locks left; "
        "the twin's firmware damps after 30 ms"
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", action="store_true", help="only lock step")
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument(
        "--row", default="", metavar="TEXT", help="only rows with this in their name, in real time"
    )
    parser.add_argument("--write", action="store_true", help="write benchmarks/results/a1_faults.txt")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["S2R_A1_RUN"] = folder
        lines = [str(describe("mujoco"))]
        if not options.row:
            lines += in_steps(options.times)
        if not options.steps:
            lines += in_real_time(options.times, options.row)
    print("\n".join(lines))
    if options.write:
        path = Path(__file__).parents[1] / "results" / "a1_faults.txt"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
