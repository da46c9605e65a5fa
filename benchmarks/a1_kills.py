"""Kill the search, its worker and the guard in the middle of walks: what the robot saw last, and how runs go on.

    python benchmarks/a1_kills.py [--times 20] [--keep FILE] [--write]

A user's commands against the twin in lock step, all in processes of their own: `s2r check` with operator=auto, its
worker, the guard. A cycle is one such command, to which a fault comes at a random round of each of three walks: SIGKILL
of its worker, of the guard, of itself. After the first two it goes on by itself, or ends with a sentence where the test
had not begun; then, as after the third, `--resume` goes on. Every fourth cycle a rollout is completed first.

After each kill is looked at: the packets that came to the twin; the guard, or whether its lock is free; and, as soon as
the next rollout is announced, the journal. A robot that fell over when its guard was killed cannot stand up: it is put
back, under a new guard, as an operator would. With ``--keep`` what was found is kept in a file, and an earlier run's
cycles are not run again.

In lock step no silence is timed, so that a dead program is known by the end of its connection alone, which takes the
system longer the more memory it held; in real time 20 ms of a worker's silence come first (`a1_faults.py`). A search
that is killed leaves the robot without an operator, which damps it.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from machine import describe

from s2r_a1.guard.place import Robot, hold, place
from s2r_a1.guard.start import attach
from s2r_a1.schedule import Schedule
from s2r_a1.twin import Twin, TwinSettings
from s2r_a1.wire import A1, WireError, unpack_orders
from s2r_sim.controller.gains import Gains
from s2r_sim.robot.signals import Command
from s2r_spec.rollouts.journal import FILE, Journal
from s2r_spec.rollouts.machine_journal import KILLED, Attempt
from tests.a1.rig import damping, limp
from tests.a1.robots import end_guard, served
from tests.processes import lives, until

RESULTS = Path(__file__).parent / "results" / "a1_kills.txt"
SPEC = """\
signal vx {m/s}
param  vd {m/s} in [-0.2, 0.3]
require walking: always[0.5 s, 1.5 s] (abs(vx - vd) <= 0.1 {m/s})
certify walking: delta = 1e-3, epsilon = 0.05, B = 0.5, R = 0.02, kernel = rbf(0.2 {m/s}), fall = -0.5
"""
TICKS = 750
"""A definition: of a test of 1.5 s."""
MOMENTS = 1500
"""A definition [rounds]: of a walk, in which kills fall: 600 to 800 of trotting in place, then the test."""
NEAR = 10
"""A tolerance [rounds]: between t = 0 as the worker knows it and as the twin does, by delay and threads."""
LEAST = 400
"""A tolerance [packets] that damp before any other comes; the guard damps for a second, 500 rounds, before a reset."""
PATIENCE = 180.0
TRIES = 4
COMPLETED = 4  # every so many cycles
VICTIMS = ("worker", "guard", "search")
WORDS = {"worker": "client", "search": "operator"}  # of the guard, once they are gone


class Watched(Twin):
    """A twin that keeps what came to it, and calls ``happens`` in a round of the walk that begins next.

    Attributes:
        came: (monotonic time [ns], datagram) of all that came.
    """

    def __init__(self, settings: TwinSettings) -> None:
        super().__init__(settings)
        self.came: list[tuple[int, bytes]] = []
        self._walked: int | None = None
        self._moment, self._happens = 0, lambda: None
        self._armed = False

    def put_back(self) -> None:
        """Lie as at first, without power before; only while no guard speaks to it."""
        super().__init__(self.settings)
        self._walked = None

    def at(self, moment: int, happens: Callable[[], None]) -> None:
        """Call this in a round of the next walk, from the twin's own thread."""
        self._moment, self._happens, self._armed = moment, happens, True

    def round(self, arrived: list[bytes]) -> list[bytes]:
        now = time.monotonic_ns()
        for data in arrived:
            self.came.append((now, data))
            self._see(data)
        if self._walked is not None:
            self._walked += 1
            if self._armed and self._walked == self._moment:
                self._armed = False
                self._happens()
        return super().round(arrived)

    def _see(self, data: bytes) -> None:
        """A walk begins with torques and no gain on any angle; it has ended when no leg swings and all are held."""
        try:
            orders = unpack_orders(data, A1)
        except WireError:
            return
        if self._walked is None and orders.tau.any() and not orders.kp.any():
            self._walked = 0
        elif orders.kp.all() or not (orders.kp.any() or orders.tau.any()):
            self._walked = None


@dataclass(frozen=True)
class Kill:
    """What followed a kill.

    Attributes:
        victim: who was killed.
        begun: whether t = 0 had passed.
        moved: packets that moved the robot after it.
        damped: time to the first packet that damps [ms]; None for a guard, after which there is none.
        seen: whether the robot saw what it should: only damping, or after a guard's end nothing, until a new consent.
        unlocked: whether the guard's lock was free, or held by a guard that lives.
        guard: whether the guard was damping for the victim's end, or had laid the robot down after the test.
        kept: whether all earlier lines of the journal are there byte for byte.
        void: whether the rollout is void, or, where t = 0 had not passed, void or no rollout.
        recorded: the word of the void rollout, or "no rollout".
        same: whether the next that was asked for has the same key, parameters and seed.
        resumed: whether that was asked by --resume.
    """

    victim: str
    begun: bool
    moved: int
    damped: float | None
    seen: bool
    unlocked: bool
    guard: bool
    kept: bool
    void: bool
    recorded: str
    same: bool
    resumed: bool


class Lab:
    """A twin, and the commands of a user."""

    def __init__(self, folder: Path, twin: Watched, port: int) -> None:
        self.folder, self.twin, self.robot = folder, twin, Robot("127.0.0.1", port, clock="lockstep")
        self.run = folder / "r" / "walking"
        (folder / "spec.stl").write_text(SPEC, encoding="utf-8")
        backend = f"a1:host=127.0.0.1,port={port},velocity=onboard,operator=auto,clock=lockstep"
        self._words = [
            sys.executable,
            "-m",
            "s2r_spec",
            "check",
            "spec.stl",
            "-b",
            backend,
            "--budget",
            "200",
        ]
        self.search: subprocess.Popen[bytes] | None = None

    def go_on(self) -> bool:
        """See that a command runs, and return whether one had to be started."""
        if self.search and self.search.poll() is None:
            return False
        words = ["--resume" if Journal.begun(self.run) else "--run", "r"]
        with open(self.folder / "words", "ab") as file:
            self.search = subprocess.Popen(
                [*self._words, *words],
                cwd=self.folder,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                start_new_session=True,
            )
        return True

    def end(self) -> None:
        if self.search:
            self.search.kill()
            self.search.wait()

    def status(self) -> dict[str, Any] | None:
        """Return the status of the living guard; None where none lives."""
        attached = attach(self.robot)
        if attached is None:
            return None
        attached[0].close()
        return attached[1]

    def lines(self) -> bytes:
        """Return the whole lines of the journal."""
        data = (self.run / FILE).read_bytes() if Journal.begun(self.run) else b""
        return data[: data.rfind(b"\n") + 1]

    def announced(self) -> list[Attempt]:
        """Return all rollouts that were announced."""
        lines = [json.loads(line) for line in self.lines().splitlines()]
        return [
            Attempt(**{name: line[name] for name in Attempt.__annotations__ if name in line})
            for line in lines
            if line.get("kind") == "begun"
        ]

    def rollouts(self) -> int:
        """Return how many rollouts have an outcome."""
        return len(Journal.read(self.run)) if Journal.begun(self.run) else 0

    def ended(self) -> bool:
        """Return whether the command has ended."""
        return self.search is None or self.search.poll() is not None

    def put_back(self) -> None:
        """Do what an operator does with a robot that fell over."""
        end_guard(self.robot.port)
        self.twin.put_back()

    def complete(self) -> None:
        """Wait until one more rollout has an outcome."""
        before = self.rollouts()
        self.go_on()
        until(lambda: self.ended() or self.rollouts() > before, PATIENCE)
        if self.ended():
            raise SystemExit(f"the command ended by itself:\n{(self.folder / 'words').read_text()}")

    def kill(self, victim: str, moment: int) -> Kill:
        """Kill one of the three in the next walk, and see what follows."""
        self.go_on()
        found: dict[str, Any] = {}

        def happens() -> None:
            status = self.status()  # a guard answers also while it waits for the robot
            assert status is not None
            assert self.search is not None
            pids = {"worker": status["client"], "guard": status["pid"], "search": self.search.pid}
            found.update(state=status["state"], worker=status["client"], pid=pids[victim])
            found.update(lines=self.lines(), announced=self.announced(), at=len(self.twin.came))
            found.update(now=time.monotonic_ns())
            os.kill(pids[victim], signal.SIGKILL)
            found["killed"] = True

        self.twin.at(moment, happens)
        for _ in range(TRIES):
            until(lambda: "killed" in found or self.ended(), PATIENCE)
            if "killed" in found:
                break
            self.put_back()
            self.go_on()
        else:
            raise SystemExit(f"no run goes on:\n{(self.folder / 'words').read_text()}")
        until(lambda: self.ended() if victim == "search" else not lives(found["pid"]), PATIENCE)
        attempt, count = found["announced"][-1], len(found["announced"])
        passed = moment - Schedule.of(Command(attempt.params["vd"]), attempt.seed, TICKS, Gains()).trot
        unlocked, state, word = self._guard_after(victim, found["worker"])
        resumed = self._ask_again(count)
        asked = self.announced()[count]
        came = self.twin.came[found["at"] :]
        return Kill(
            victim=victim,
            begun=passed > 0,
            unlocked=unlocked,
            guard=victim == "guard" or word == WORDS[victim] or (victim == "search" and state == "RESTING"),
            kept=self.lines().startswith(found["lines"]),
            same=(asked.key, asked.params, asked.seed) == (attempt.key, attempt.params, attempt.seed),
            resumed=resumed,
            **_packets(victim, came, found["now"], state),
            **self._recorded(victim, attempt, passed),
        )

    def _guard_after(self, victim: str, worker: int) -> tuple[bool, str, str | None]:
        """Return whether the lock is free or held by a guard that lives, and the guard's state and word at rest."""
        if victim == "guard":
            until(self._free_or_guarded, PATIENCE)
            return True, "", None
        found: dict[str, Any] = {}

        def rests() -> bool:
            found.update(self.status() or {"state": "", "word": None})
            return found["state"] not in ("STANDING_UP", "STAND", "WALK", "LYING_DOWN")

        until(lambda: not lives(worker), PATIENCE)
        until(rests, PATIENCE)
        return bool(found["state"]), found["state"], found["word"]

    def _free_or_guarded(self) -> bool:
        """Return whether nobody holds the lock, or a guard that lives, which a quick search has begun."""
        lock = hold(place(self.robot.host, self.robot.port))
        if lock is not None:
            os.close(lock)
        return lock is not None or self.status() is not None

    def _ask_again(self, before: int) -> bool:
        """Wait until one more rollout is announced than before; return whether that needed --resume."""
        resumed = False
        for _ in range(TRIES):
            until(lambda: self.ended() or len(self.announced()) > before, PATIENCE)
            if len(self.announced()) > before:
                return resumed
            if resumed:  # it does not stand up
                self.put_back()
            resumed = self.go_on()
        raise SystemExit(f"no run goes on:\n{(self.folder / 'words').read_text()}")

    def _recorded(self, victim: str, attempt: Attempt, passed: int) -> dict[str, Any]:
        """Return what the journal has of the rollout that was broken."""
        word = next((void.word for void in Journal.read(self.run).voids if void.rollout == attempt), None)
        expected = "link" if victim == "guard" else KILLED
        if victim == "search":  # it knew no t = 0
            good = word == expected
        elif abs(passed) <= NEAR:
            good = word in (expected, None)
        else:
            good = word == (expected if passed > 0 else None)
        return {"void": good, "recorded": word or "no rollout"}


def _packets(victim: str, came: list[tuple[int, bytes]], now: int, state: str) -> dict[str, Any]:
    """Return what the twin received after a kill: until it damps, and then, up to the next consent.

    After a normal end, in RESTING, the next run may have it stand up without a new one.
    """
    packets = [(at, data) for at, data in came if data]
    if victim == "guard":
        # What comes next is of another guard, which begins with both consents.
        return {"moved": 0, "damped": None, "seen": all(limp(data) for _, data in packets[:LEAST])}
    first = next((n for n, (_, data) in enumerate(packets) if damping(data)), None)
    if first is None:
        return {"moved": len(packets), "damped": None, "seen": False}
    after = [data for _, data in packets[first:]]
    last = next((n for n, data in enumerate(after) if not damping(data)), len(after))
    seen = last >= LEAST and (last == len(after) or state == "RESTING" or limp(after[last]))
    return {"moved": first, "damped": (packets[first][0] - now) / 1e6, "seen": seen}


def table(kills: list[Kill]) -> list[str]:
    """Return what is printed."""
    lines = [
        f"  {'SIGKILL of':10s} {'kills':>5s} {'t ≥ 0':>5s} {'damped':>6s} {'lock':>5s} {'guard':>5s} {'kept':>5s} "
        f"{'void':>5s} {'same':>5s} {'by --resume':>11s}  {'packets':>7s}  {'median':>7s} {'worst ms':>8s}  recorded as"
    ]
    for victim in VICTIMS:
        of = [kill for kill in kills if kill.victim == victim]
        if not of:
            continue
        counts = [sum(getattr(kill, name) for kill in of) for name in COUNTED]
        times = [kill.damped for kill in of if kill.damped is not None]
        words = {word: sum(kill.recorded == word for kill in of) for word in sorted({k.recorded for k in of})}
        latency = f"{np.median(times):7.1f} {max(times):8.1f}" if times else f"{'–':>7s} {'–':>8s}"
        lines.append(
            f"  {victim:10s} {len(of):5d} {counts[0]:5d} {counts[1]:6d} "
            + " ".join(f"{count:5d}" for count in counts[2:7])
            + f" {counts[7]:11d}  {max(kill.moved for kill in of):7d}  {latency}  "
            + ", ".join(f"{word} {count}" for word, count in words.items())
        )
    return [*lines, LEGEND]


COUNTED = ("begun", "seen", "unlocked", "guard", "kept", "void", "same", "resumed")
LEGEND = """\
  damped: the robot saw only damping packets from then on, or after a guard's end none, until a new consent;
  lock: free, or of a living guard; guard: in DAMPING by its client's or operator's end, or RESTING after the test's;
  kept: all earlier lines of the journal, byte for byte; void: the broken rollout is, or there is none before t = 0;
  same: the next test asked has the same key, parameters and seed; packets: most that moved the robot after a kill;
  ms: to the first damping packet, in lock step on this machine"""


def killed(times: int, keep: Path | None) -> list[Kill]:
    """Return what followed every kill; those that ``keep`` has are not done again."""
    found = (
        [Kill(**json.loads(line)) for line in keep.read_text().splitlines()] if keep and keep.exists() else []
    )
    begun = len(found) // len(VICTIMS)
    found = found[: begun * len(VICTIMS)]
    twin = Watched(TwinSettings(place="nominal", noise=False))
    with tempfile.TemporaryDirectory() as folder, served(twin) as port:
        os.environ["S2R_A1_RUN"] = folder
        lab = Lab(Path(folder), twin, port)
        try:
            for cycle in range(begun, times):
                moments = np.random.default_rng(cycle).integers(1, MOMENTS, len(VICTIMS))
                if cycle % COMPLETED == 0:
                    lab.complete()
                for victim, moment in zip(VICTIMS, moments, strict=True):
                    kill = lab.kill(victim, int(moment))
                    found.append(kill)
                    print(kill, file=sys.stderr, flush=True)
                if keep:
                    keep.write_text("".join(json.dumps(asdict(kill)) + "\n" for kill in found))
        finally:
            lab.end()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument(
        "--keep", type=Path, metavar="FILE", help="file of the results so far; the run continues from them"
    )
    parser.add_argument("--write", action="store_true", help=f"to {RESULTS.name}")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that no process is left behind
    begun = time.monotonic()
    kills = killed(options.times, options.keep)
    lines = [str(describe("mujoco")), *table(kills), f"  took {time.monotonic() - begun:.0f} s"]
    print("\n".join(lines))
    if options.write:
        RESULTS.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
