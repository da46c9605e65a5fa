"""The ``manual`` backend: a person who runs each test and hands over its log.

    s2r gap SPEC --sim sim --real manual:FOLDER

What may follow the folder says how the logs are read, as for ``log:``: ``manual:night?time-unit=ms&map=vx=v.x``.
The dialogue is held by the process with the terminal (``attendance.py``). A worker's :meth:`ManualBackend.rollout`
only takes what was accepted there, and records it in the folder.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Self

import numpy as np

from s2r_spec.backend import VOID, Channel, Needs, Operator, Parameter
from s2r_spec.errors import NotBegunError, UsageError
from s2r_spec.rollouts.manual.attendance import FALL, Attendance
from s2r_spec.rollouts.manual.checks import alike
from s2r_spec.rollouts.manual.place import ORIGINALS, Place, Step, recorded, without_log
from s2r_spec.rollouts.manual.words import test_words
from s2r_spec.rollouts.reading import Reading
from s2r_spec.trace import Trace

COST = 120.0
"""Prior: what a test takes a person besides its own length [s], for planning; twice as much plans half as many."""
VOID_REASON = "the operator says that the test ran and that there is no log of it"


@dataclass(frozen=True)
class ManualBackend:
    """A person as the backend; channels and parameters are those of the specification.

    Args:
        folder: of the rollouts; after a ``?`` how logs are read.
        duration: that the specification looks ahead [s]; 0 where it looks at the whole rest of a trace.
        needs: of the specification; without it channels and parameters are those of the folder's last run.

    Raises:
        UsageError: there is no folder, or what follows it is not understood.
    """

    folder: str = ""
    duration: float = 0.0
    needs: Needs | None = field(default=None, compare=False, repr=False)

    exclusive = True
    hands_over = True
    deterministic = False

    def __post_init__(self) -> None:
        """See that the folder's name and its options can be used; nothing is made there."""
        if not self.folder:
            raise UsageError("the manual backend needs a folder for the rollouts: --real manual:FOLDER")
        place = self.place.root
        if place.exists() and not place.is_dir():
            raise UsageError(
                f"{place} is a file; manual:FOLDER needs a folder, which it makes if there is none"
            )

    @property
    def name(self) -> str:
        """What ``--real`` says."""
        return f"manual:{self.folder}"

    @property
    def reading(self) -> Reading:
        """How logs are read."""
        return Reading.of("manual", self.folder)

    @property
    def place(self) -> Place:
        """The folder."""
        return Place(self.reading.folder)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What the specification reads."""
        return self.needs.channels if self.needs is not None else self.place.declared()[0]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What the specification sweeps and fixes."""
        return self.needs.parameters if self.needs is not None else self.place.declared()[1]

    @property
    def cost(self) -> float:
        """Expected time of one test [s]."""
        return COST + self.duration

    @property
    def model_hash(self) -> str:
        """Hash of what is asked of the person and of how logs are read: of the machine nobody knows one."""
        asked = [(c.name, c.unit, c.width) for c in self.channels], [asdict(p) for p in self.parameters]
        record = json.dumps([asked, self.duration, self.reading.words])
        return hashlib.sha256(record.encode()).hexdigest()

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What every statement about these tests assumes."""
        return (
            f"a person ran the tests of {self.name}: each log is of the test that was asked for",
            f"every test of {self.name} that began has a log, or is recorded as a fall or as void; "
            f"no skipped test began",
        )

    def with_duration(self, seconds: float) -> Self:
        """Return the same backend for logs of this length."""
        return replace(self, duration=seconds)

    def for_spec(self, needs: Needs) -> Self:
        """Return the same backend with the channels and parameters of a specification."""
        return replace(self, needs=needs)

    def attendance(self, operator: Operator) -> Attendance:
        """Return the dialogue with the person."""
        if self.needs is None:
            raise UsageError(
                f"{self.name} needs a specification: s2r check, gap or certify ask for its tests"
            )
        return Attendance(self.place, self.reading, self.needs, self.duration, operator)

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Return the log that was accepted for this test, and record it in the folder.

        Raises:
            NotBegunError: none was accepted; the operator is asked again.
        """
        step = self.place.step()
        if step is None or step.state == "asked" or step.params != dict(params):
            raise NotBegunError(f"there is no log of {test_words(params, self.parameters)} yet")
        if step.state == "recorded":
            if step.seed == seed:
                return self.place.trace(step)
            self.place.close()
            raise NotBegunError(
                f"the log of {test_words(params, self.parameters)} is recorded as {step.id}, for an earlier rollout"
            )
        if step.void is not None:
            return Trace(
                np.zeros(1), {}, {}, {VOID: step.void, "reason": VOID_REASON, "params": dict(params)}
            )
        trace = self.place.record(step, self._trace(step), seed, self.channels, self.parameters)
        self.place.write(recorded(step, seed), {})
        return trace

    def _trace(self, step: Step) -> Trace:
        """Return the trace of an accepted step, with channels in the units of the specification."""
        about: dict[str, Any] = {"params": dict(step.params)}
        if step.log is None:
            trace = without_log(step.failure or FALL, self.channels)
            return Trace(trace.times, trace.channels, trace.units, dict(trace.meta) | about)
        about |= {"log": step.log} | ({} if step.failure is None else {"failure": step.failure})
        read = self.reading.held(self.reading.load(self.place.root / ORIGINALS / step.log).trace)
        return alike(Trace(read.times, read.channels, read.units, dict(read.meta) | about), self.channels)
