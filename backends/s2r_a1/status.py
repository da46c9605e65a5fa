"""Show a robot before it is armed: ``python -m s2r_a1.status [--host HOST --robot NAME]``.

The robot stays limp: the view goes through the guard, whose packets have no gains and no torques. The operator turns
each joint by hand, and reads which joint moves, where to, and how its angles compare with its range. So a joint with a
wrong sign, a wrong place or a wrong zero is found before a motor has a torque.
"""

from __future__ import annotations

import argparse
import os
import sys
import termios
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from textwrap import wrap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_a1.attendance import WORD_CONNECT, question_to_connect
from s2r_a1.guard.checks import JOINTS
from s2r_a1.guard.control import Connection
from s2r_a1.guard.limits import LIMITS
from s2r_a1.guard.place import PORT, find_guard, is_held, place
from s2r_a1.guard.start import start
from s2r_a1.options import read_options
from s2r_spec.errors import S2RError, UsageError

FloatArray = NDArray[np.float64]

PERIOD = 0.2
"""A budget [s]: time between two looks."""
MOVED = 0.05
"""A level [rad]: motion within ``RECENT`` that counts; a joint at rest has 1 mrad of noise."""
RECENT = 1.0
"""A budget [s]: time over which a joint's motion is shown."""
LIMP = ("OFF", "LINKED", "DAMPING")
"""A definition: states in which the robot starts no motion before an operator's next consent."""
BAR = 15
"""A definition: characters of a joint's range."""
FEET = ("FR", "FL", "RR", "RL")
MOTIONS = {
    "hip": ("the foot goes to the robot's left", "the foot goes to the robot's right"),
    "thigh": ("the knee goes back", "the knee goes forward"),
    "calf": ("the leg stretches", "the leg folds"),
}
"""A definition: the motion of a positive and of a negative change of a joint's angle, by the axes of the A1's URDF."""


@dataclass
class SeenAngles:
    """Angles of the joints so far.

    Attributes:
        low: (12,) smallest angles [rad].
        high: (12,) largest angles [rad].
        recent: (time [s], (12,) angles [rad]) within the last second.
    """

    low: FloatArray = field(default_factory=lambda: np.full(12, np.inf))
    high: FloatArray = field(default_factory=lambda: np.full(12, -np.inf))
    recent: deque[tuple[float, FloatArray]] = field(default_factory=deque)

    def take(self, now: float, q: FloatArray) -> None:
        """Take (12,) angles [rad] at a time [s]."""
        self.low, self.high = np.minimum(self.low, q), np.maximum(self.high, q)
        self.recent.append((now, q))
        while now - self.recent[0][0] > RECENT:
            self.recent.popleft()

    def motion(self) -> str:
        """Return which joint moves most, and where to, in words; "" if none moves."""
        if not self.recent:
            return ""
        change = self.recent[-1][1] - self.recent[0][1]
        joint = int(np.argmax(np.abs(change)))
        if abs(change[joint]) < MOVED:
            return ""
        part = JOINTS[joint].split()[1]
        return f"{JOINTS[joint]} moves by {change[joint]:+.2f} rad: {MOTIONS[part][int(change[joint] < 0)]}"


def view(status: Mapping[str, Any], seen: SeenAngles) -> list[str]:
    """Return the lines of a view, of at most 80 characters, from a guard's status; adds its angles to ``seen``."""
    kind = "the twin" if status["twin"] else f"the robot {status['robot']}"
    state, why = status["state"], status["reason"]
    lines = [f"{kind} at {status['host']}:{status['port']}: {state}"]
    lines += wrap(f"why: {why}", 80) if why else []
    reading = status["reading"]
    if reading is None:
        return [*lines, "no state has arrived"]
    q, dq = (np.array(reading[name]) for name in ("q", "dq"))
    seen.take(time.monotonic(), q)
    roll, pitch = reading["roll"], reading["pitch"]
    charge = "see lights" if status["battery"] is None else f"{status['battery']} %"
    force = " ".join(f"{foot} {force:.0f}" for foot, force in zip(FEET, reading["foot_force"], strict=True))
    lines += [
        f"roll {roll:+.3f} rad   pitch {pitch:+.3f} rad   gyro " + _signed(reading["gyro"]) + " rad/s",
        f"feet (raw) {force}  battery: {charge}  remote: {'on' if status['remote_seen'] else 'off'}",
        "",
        f"{'joint':<9} {'angle':>6} {'its range [rad]':^{BAR + 14}} {'seen so far':^15} {'rad/s':>6} {'°C':>4}",
    ]
    for joint, (low, high) in enumerate(zip(*LIMITS.span, strict=True)):
        beyond = " " if low <= q[joint] <= high else "!"
        lines.append(
            f"{JOINTS[joint]:<9} {q[joint]:+6.2f}{beyond}{low:+6.2f} {_bar(q[joint], low, high)} {high:+6.2f} "
            f"{seen.low[joint]:+6.2f} … {seen.high[joint]:+5.2f} {dq[joint]:+6.2f} {reading['temperature'][joint]:4.0f}"
        )
    if state not in LIMP:
        return [*lines, "", "Keep away: the robot may move at any time."]
    return [*lines, "", seen.motion() or "Turn one joint by hand: this line names the joint and its motion."]


def _bar(value: float, low: float, high: float) -> str:
    place = round((value - low) / (high - low) * (BAR - 1))
    bar = ["·"] * BAR
    bar[min(max(place, 0), BAR - 1)] = "█"
    return "".join(bar)


def _signed(numbers: Sequence[float]) -> str:
    return " ".join(f"{number:+.2f}" for number in numbers)


def main(arguments: list[str] | None = None) -> int:
    """Show a robot until Ctrl-C, and return the exit code; an error is one sentence on standard error."""
    parser = argparse.ArgumentParser(
        prog="python -m s2r_a1.status", description="Show the state of a limp robot, through its guard."
    )
    parser.add_argument("--host", help="the robot's address; not needed if only one guard runs")
    parser.add_argument("--port", type=int, default=PORT, help=f"the robot's UDP port ({PORT})")
    parser.add_argument("--robot", default="", help="the robot's name; a twin needs none")
    parser.add_argument("--once", action="store_true", help="print one view, and end")
    options = parser.parse_args(arguments)
    try:
        _show(options)
    except S2RError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        pass
    return 0


def _show(options: argparse.Namespace) -> None:
    """Show the robot; the view is no operator of the guard, so it does not hold up the end of a run."""
    with closing(watch(options.host, options.port, options.robot)) as guard:
        seen = SeenAngles()
        if options.once:
            print("\n".join(view(guard.request("status"), seen)))
            return
        from rich.live import Live
        from rich.text import Text

        with Live(auto_refresh=False, screen=sys.stdout.isatty()) as live:
            for lines in _looks(guard, seen):
                live.update(Text("\n".join(lines)), refresh=True)


def watch(host: str | None, port: int = PORT, robot: str = "") -> Connection:
    """Return a connection to a robot's guard; without one, start and connect it with the operator's consent.

    Without a ``host`` it is the only guard that runs. The connection has no role, so nobody attends the robot by it.

    Raises:
        UsageError: the guard is another robot's, or no operator can give a consent.
    """
    if host:
        words = [f"host={host}", f"port={port}", "velocity=onboard"]
        words += [f"robot={robot}"] if robot else []
        if not is_held(place(host, port)):
            with closing(start(read_options(",".join(words)))[0]):
                return watch(host, port, robot)
    path = find_guard(host, port)
    guard = Connection(path)
    status = guard.request("status")
    if robot not in ("", status["robot"]):
        guard.close()
        raise UsageError(f"the guard has the robot {status['robot'] or 'without a name'}, not {robot}")
    if status["state"] == "OFF":
        with closing(Connection(path)) as operator:
            operator.request("hello", role="operator", pid=os.getpid())
            _consent(question_to_connect("the twin" if status["twin"] else f"the robot {status['robot']}"))
            operator.request("connect")
    return guard


def _consent(question: str) -> None:
    """Return once the operator has typed the word for connecting; raise KeyboardInterrupt for ``q``."""
    if not sys.stdin.isatty():
        raise UsageError("connecting needs an operator's consent: run this command in a terminal")
    termios.tcflush(sys.stdin, termios.TCIFLUSH)  # letters that were typed ahead are no consent
    print(question)
    while (answer := input(f"Type {WORD_CONNECT} to go on, q to stop: ").strip()) != WORD_CONNECT:
        if answer == "q":
            raise KeyboardInterrupt
        print(f"You typed {answer!r}, so s2r did nothing.")


def _looks(guard: Any, seen: SeenAngles) -> Iterator[list[str]]:
    while True:
        yield view(guard.request("status"), seen)
        time.sleep(PERIOD)


if __name__ == "__main__":
    sys.exit(main())
