"""The ``manual`` backend: a person runs each test and gives s2r its log.

    s2r gap SPEC --sim sim --real manual:FOLDER

Options for reading the logs may follow the folder, as for ``log:``: ``manual:night?time-unit=ms&map=vx=v.x``. The
process with the terminal holds the dialogue (``attendance.py``). A worker's :meth:`ManualBackend.rollout` only records
the accepted log in the folder.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Self

import numpy as np

from s2r_spec.backend import VOID, Channel, Needs, Operator, Parameter
from s2r_spec.base.errors import NotBegunError, UsageError
from s2r_spec.machine.manual.attendance import FALL, Attendance
from s2r_spec.machine.manual.checks import in_common_form
from s2r_spec.machine.manual.folder import ORIGINALS, PendingTest, TestFolder, placeholder
from s2r_spec.machine.manual.words import test_words
from s2r_spec.recordings.log_options import LogOptions
from s2r_spec.recordings.reading_rule import READING
from s2r_spec.trace import Trace

COST = 120.0
"""Prior: a person's time for one test, without the test itself [s]; only plans use it."""
VOID_REASON = "the operator says that the test ran and left no log"


@dataclass(frozen=True)
class ManualBackend:
    """A person as the backend, with the channels and parameters of the specification.

    Args:
        folder: folder of the rollouts; options for reading logs may follow a ``?``.
        duration: horizon of the specification [s]; 0 if it reads a trace to its end.
        needs: channels and parameters of the specification; None to take them from the folder's last run.

    Raises:
        UsageError: the folder is missing, or an option is unknown.
    """

    folder: str = ""
    duration: float = 0.0
    needs: Needs | None = field(default=None, compare=False, repr=False)

    exclusive = True
    hands_over = True
    deterministic = False
    reading = READING

    def __post_init__(self) -> None:
        if not self.folder:
            raise UsageError("the manual backend needs a folder for the rollouts: write --real manual:FOLDER")
        root = self.tests.root
        if root.exists() and not root.is_dir():
            raise UsageError(f"{root} is a file; name a folder in manual:FOLDER, and s2r makes it if needed")

    @property
    def name(self) -> str:
        """Name as in ``--real``."""
        return f"manual:{self.folder}"

    @property
    def options(self) -> LogOptions:
        """Options for reading logs."""
        return LogOptions.parse("manual", self.folder)

    @property
    def tests(self) -> TestFolder:
        """The folder of tests."""
        return TestFolder(self.options.folder)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels that the specification reads."""
        return self.needs.channels if self.needs is not None else self.tests.declared()[0]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters that the specification sweeps or fixes."""
        return self.needs.parameters if self.needs is not None else self.tests.declared()[1]

    @property
    def cost(self) -> float:
        """Expected time of one test [s]."""
        return COST + self.duration

    @property
    def model_hash(self) -> str:
        """Hash of channels, parameters, options and reading rule; the machine itself has no known hash."""
        interface = [(c.name, c.unit, c.width) for c in self.channels], [asdict(p) for p in self.parameters]
        record = json.dumps([interface, self.duration, self.options.text, self.reading])
        return hashlib.sha256(record.encode()).hexdigest()

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Assumptions of every statement about these tests."""
        return (
            f"a person ran the tests of {self.name}: each log is from the requested test",
            f"every test of {self.name} that began has a log, or is recorded as a fall or as void; "
            f"no skipped test began",
        )

    def with_duration(self, seconds: float) -> Self:
        """Return this backend with logs of this length."""
        return replace(self, duration=seconds)

    def for_spec(self, needs: Needs) -> Self:
        """Return this backend with the channels and parameters of a specification."""
        return replace(self, needs=needs)

    def attendance(self, operator: Operator) -> Attendance:
        """Return the dialogue with the person."""
        if self.needs is None:
            raise UsageError(
                f"{self.name} needs a specification: run s2r check, gap or certify, which request its tests"
            )
        return Attendance(self.tests, self.options, self.needs, self.duration, operator)

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Return the accepted log of this test, and record it in the folder; raise a NotBegunError if there is none."""
        test = self.tests.pending()
        if test is None or test.state == "asked" or test.params != dict(params):
            raise NotBegunError(f"there is no log of {test_words(params, self.parameters)} yet")
        if test.state == "recorded":
            if test.seed == seed:
                return self.tests.trace(test)
            self.tests.close()
            raise NotBegunError(
                f"the log of {test_words(params, self.parameters)} is recorded as {test.id}, for an earlier rollout"
            )
        if test.void is not None:
            return Trace(
                np.zeros(1), {}, {}, {VOID: test.void, "reason": VOID_REASON, "params": dict(params)}
            )
        trace = self.tests.record(test, self._trace(test), seed, self.channels, self.parameters)
        self.tests.write(replace(test, state="recorded", seed=seed), {})
        return trace

    def _trace(self, test: PendingTest) -> Trace:
        meta: dict[str, Any] = {"params": dict(test.params)}
        if test.log is None:
            trace = placeholder(test.failure or FALL, self.channels)
            return replace(trace, meta=dict(trace.meta) | meta)
        meta |= {"log": test.log} | ({} if test.failure is None else {"failure": test.failure})
        trace = self.options.fill_gaps(self.options.load(self.tests.root / ORIGINALS / test.log).trace)
        return in_common_form(replace(trace, meta=dict(trace.meta) | meta), self.channels)
