"""What the real rollouts lack for a diagnosis: channels, tests, rollouts that ended whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import HasResiduals
from s2r_spec.diagnose.falls import Falls, always_early
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.errors import TraceError
from s2r_spec.space import key_of
from s2r_spec.trace import SHOWN, Trace

FloatArray = NDArray[np.float64]
Rollout = tuple[dict[str, float], Trace]

CUT = "cut at"
"""In the metadata of a recording of which only the begin is used: until when [s]."""
READ_AT = "read at samples apart"
"""In the metadata of a recording between whose samples the spec's times fall: how far apart they are now [s]."""


@dataclass(frozen=True)
class Used:
    """The real rollouts of a diagnosis.

    Attributes:
        rollouts: all tests of the specification.
        train: number of those from which sizes are estimated.
        held_out: number of those that are held out.
        least: different tests, and rollouts, from which on some are held out.
    """

    rollouts: Sequence[Rollout]
    train: int
    held_out: int
    least: tuple[int, int]

    @property
    def count(self) -> int:
        """Number of rollouts in use; the others ended early."""
        return self.train + self.held_out


def notes(
    bench: Bench,
    used: Used,
    idle: Sequence[str] = (),
    why: Falls | None = None,
    odd: Sequence[Finding] = (),
    alone: Sequence[Mapping[str, float]] = (),
) -> tuple[str, ...]:
    """Return what these rollouts lack for a diagnosis, a sentence each.

    Args:
        bench: the simulator with the channels that they should have.
        used: the rollouts.
        idle: effects that change nothing in any experiment.
        why: what may have ended some of them early.
        odd: suspected mistakes of the recordings.
        alone: tests at which the simulator ends early, and the machine does not.
    """
    found = [each.text for each in odd]
    rollouts, count = used.rollouts, len(used.rollouts)
    if idle:
        found.append(
            f"in these experiments, {', '.join(idle)} {'changes' if len(idle) == 1 else 'change'} nothing in the "
            f"simulator, so no data can show {'it' if len(idle) == 1 else 'them'}"
        )
    if not rollouts:
        return (*found, "no test of the specification was run, so the gap in ρ was not measured")
    fell = [trace.failure for _, trace in rollouts if trace.failure is not None]
    if fell:
        kinds = ", ".join(sorted({str(failure) for failure in fell}))
        early = f"{len(fell)} of {count} real rollouts ended early ({kinds}{_again(rollouts)})"
        if used.count < count:
            found.append(f"{early}, and {'is' if len(fell) == 1 else 'are'} left out")
        else:
            found.append(f"{early}. The cause also rests on their samples before the end, which say little")
        if why is not None:
            found[-1] += f". {why}"
    if alone:
        tests = {key_of(test) for test, _ in rollouts}
        where = " and ".join(
            ", ".join(f"{k} = {v:.4g}" for k, v in test.items()) or "the only test" for test in alone[:SHOWN]
        )
        found.append(
            f"without any effect, the simulator ends early at {len(alone)} of {len(tests)} tests where no real rollout "
            f"does ({where}). There the gap in ρ is the cost of a fall and shows few causes. Make the simulator stand "
            f"at these tests first, or use a smaller test space"
        )
    longer = [trace.meta[CUT] for _, trace in rollouts if CUT in trace.meta]
    if longer:
        found.append(
            f"{len(longer)} of {count} real rollouts are longer than the simulator's; only their first {longer[0]:g} s "
            f"are used"
        )
    apart = [trace.meta[READ_AT] for _, trace in rollouts if READ_AT in trace.meta]
    if apart:
        found.append(
            f"a window of the spec is shorter than the sample period of {len(apart)} of {count} real rollouts. They "
            f"are interpolated linearly at the simulator's period of {apart[0]:g} s, which may change ρ a little"
        )
    lacking = [
        channel.name
        for channel in bench.backend.channels
        if all(
            channel.name not in trace.channels or not np.isfinite(trace[channel.name]).any()
            for _, trace in rollouts
        )
    ]
    if lacking:
        found.append(
            f"the real rollouts have no {_some(lacking)}. An effect that only these would show "
            f"cannot be found{_unread(bench, rollouts)}"
        )
    found += _gaps(bench, rollouts, lacking)
    found += _without_residuals(bench, rollouts)
    tests = {key_of(test) for test, _ in rollouts}
    if len(tests) == 1 and rollouts[0][0]:
        found.append("all real rollouts repeat one test, so nothing is known about other tests")
    if not used.held_out:
        takes, here = (
            f"{used.least[1]} rollouts of {used.least[0]} different tests",
            f"{count} of {len(tests)}",
        )
        if not bench.spec.space.dim:
            # There is one test, and rollouts of it are all there is to hold out.
            takes, here = f"{used.least[0]} rollouts", f"{count}"
        found.append(
            f"no rollouts were held out, so the reduction of the gap was not measured: it takes {takes}, and there are "
            f"{here}"
        )
    return tuple(found)


def _again(rollouts: Sequence[Rollout]) -> str:
    """Return at how many tests rollouts ended early every time, in words."""
    always = always_early(rollouts)
    tests = {key_of(test) for test, trace in rollouts if trace.failure is not None}
    if not always:
        return ""
    if len(tests) == 1:
        return ", every time at one test, so it is no accident"
    return f", at {len(tests)} tests, and in every repetition at {always} of them, so it is no accident"


def _unread(bench: Bench, rollouts: Sequence[Rollout]) -> str:
    """Return which channels the simulator does not know, for one of them may be what is lacking."""
    known = {channel.name for channel in bench.backend.channels}
    names = sorted({name for _, trace in rollouts for name in trace.channels} - known)
    return f". The simulator has no {_some(names)}: is a name misspelt?" if names else ""


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return f"{', '.join(names[:SHOWN])}{more}"


def _gaps(bench: Bench, rollouts: Sequence[Rollout], lacking: Sequence[str]) -> list[str]:
    """Return which channels some rollouts lack, or have gaps in, a sentence for every number of rollouts."""
    holes: dict[int, list[str]] = {}
    for name in (channel.name for channel in bench.backend.channels):
        count = sum(not _whole(trace, name) for _, trace in rollouts)
        if count and name not in lacking:
            holes.setdefault(count, []).append(name)
    found = []
    for count, names in holes.items():
        verbs = ("is missing or has", "is") if len(names) == 1 else ("are missing or have", "are")
        found.append(
            f"{_some(names)} {verbs[0]} gaps in {count} of {len(rollouts)} real rollouts, and {verbs[1]} not used "
            f"{'there' if 2 * count < len(rollouts) else 'at all'}"
        )
    return found


def _whole(trace: Trace, name: str) -> bool:
    return name in trace.channels and bool(np.isfinite(trace[name]).all())


def _without_residuals(bench: Bench, rollouts: Sequence[Rollout]) -> list[str]:
    """Return why no residual of the simulator's model can be computed, if none can of any rollout."""
    if not isinstance(bench.backend, HasResiduals):
        return []
    why = ""
    for test, trace in rollouts:
        try:
            bench.backend.residuals(trace, bench.matched.to_backend(test))
            return []
        except TraceError as error:
            why = str(error)
    return [
        f"residuals of the equations of motion cannot be computed for any real rollout ({why}). The answer rests "
        f"on the channels alone"
    ]
