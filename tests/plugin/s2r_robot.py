"""A machine as another package would offer it: the toy, of which there is one, with an operator.

What it does is in its name, words with a comma between them: ``robot:auto`` asks nobody; ``link=3`` loses the link in
the third rollout that anybody runs of it, ``die=3`` kills the process that runs it, ``hang=3`` waits there until it is
interrupted (with ``S2R_ROBOT_DEAF`` until it is killed), ``raise=3`` raises, ``shy=3`` does not begin, ``fell=3``
falls, ``both=3`` falls and loses the link, ``slow=3`` takes 1.2 s to stand up; ``link=3+4`` does so twice. ``refuse``
does not let the first rollout begin.
All that happens to it is a line of the file that ``S2R_ROBOT`` names.
"""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from s2r_toy import Toy

from s2r_spec.errors import NotBegunError
from s2r_spec.protocols import Protocol, named
from s2r_spec.trace import Trace

NOD = Protocol("nod", "The robot nods.", "ground", 1.0, 2.0, "it may hit its chin")
HABITS = ("link", "die", "hang", "raise", "shy", "fell", "both", "slow")


def happened(*words: object) -> int:
    """Note what happened, and return how often something of this kind has."""
    file = Path(os.environ["S2R_ROBOT"])
    with file.open("a") as log:
        log.write(" ".join(map(str, words)) + "\n")
    return sum(line.split()[0] == words[0] for line in file.read_text().splitlines())


@dataclass
class Attendance:
    name: str
    operator: object
    unattended: bool
    refuses: bool

    def begin(self, coming) -> None:
        happened("begin", coming.rollouts)
        if not self.unattended:
            self.operator.type_word("The robot must hang or lie.", "hangs")

    def before(self, params) -> None:
        if happened("before", params["vd"]) == 1 and self.refuses:
            raise NotBegunError("a motor is hot")
        if not self.unattended:
            self.operator.choose(f"Next: vd = {params['vd']:.3f}.", {"": "begin"})
            self.answers = {"battery": "full"}

    def before_protocol(self, protocol, params) -> None:
        happened("before", protocol.name)
        if not self.unattended:
            self.operator.choose(f"{protocol.words} Risk: {protocol.risk}.", {"": "begin"})

    def after(self, trace) -> None:
        happened("after", None if trace is None else len(trace.times))

    def interrupt(self, urgent) -> None:
        happened("interrupt", "urgent" if urgent else "soft")

    def end(self) -> None:
        happened("end")


class Robot(Toy):
    exclusive = True
    deterministic = False
    cost = 20.0
    assumptions = ("the robot's clock is right",)
    raw = None
    begins = None

    def __init__(self, habit: str = "") -> None:
        super().__init__()
        self.name = f"robot:{habit}" if habit else "robot"
        self.words = dict(word.partition("=")[::2] for word in habit.split(",") if word)

    def _like(self) -> Robot:
        other = type(self)(self.name.partition(":")[2])
        other.duration, other.raw, other.begins = self.duration, self.raw, self.begins
        return other

    def with_duration(self, seconds: float) -> Robot:
        other = self._like()
        other.duration = seconds
        return other

    def keeping(self, folder: str) -> Robot:
        other = self._like()
        other.raw = Path(folder)
        return other

    def saying(self, begins) -> Robot:
        other = self._like()
        other.begins = begins
        return other

    def attendance(self, operator) -> Attendance:
        return Attendance(self.name, operator, "auto" in self.words, "refuse" in self.words)

    def prepare(self) -> None:
        happened("prepare")

    def protocols(self):
        return (NOD,)

    def run(self, protocol, params, seed):
        values = named(self.protocols(), protocol, self.name).values(params)
        happened("run", protocol, seed)
        return Trace([0.0, 1.0], {"y": [0.0, 1.0]}, {}, {"protocol": protocol, "params": values})

    def rollout(self, params, seed):
        number = happened("rollout", params["vd"], seed, os.getpid())
        now = {word for word in HABITS if str(number) in self.words.get(word, "").split("+")}
        if "shy" in now:
            raise NotBegunError("a leg is stuck")
        if "raise" in now:
            raise ValueError("the gyroscope is upside down")
        if "die" in now:
            os.kill(os.getpid(), signal.SIGKILL)
        if "slow" in now:
            time.sleep(1.2)
        if self.begins is not None:
            self.begins()
        trace = super().rollout(params, seed)
        meta = {}
        if "hang" in now:
            log = Path(os.environ["S2R_ROBOT"])
            until = time.monotonic() + 300
            deaf = "S2R_ROBOT_DEAF" in os.environ
            while (deaf or "interrupt soft" not in log.read_text()) and time.monotonic() < until:
                time.sleep(0.01)
            meta = {"void": "operator", "reason": "Ctrl-C"}
        if now & {"link", "both"}:
            meta |= {"void": "link", "reason": "no state for 20 ms"}
        if now & {"fell", "both"}:
            meta |= {"failure": "fall"}
        if self.raw is not None:
            (self.raw / f"{number}.bytes").write_text(str(seed))
        return type(trace)(trace.times, trace.channels, trace.units, {**trace.meta, **meta})


class Plain(Toy):
    """A machine that says nothing of who attends to it."""

    exclusive = True
    deterministic = False
