"""What the real rollouts lack for a diagnosis: channels, tests, rollouts that ended whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Effect, HasResiduals
from s2r_spec.diagnose.falls import Falls, always_early
from s2r_spec.diagnose.how_far import HowFar
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.errors import TraceError
from s2r_spec.space import key_of
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Rollout = tuple[dict[str, float], Trace]

CUT = "cut at"
"""In the metadata of a recording of which only the begin is used: until when [s]."""
READ_AT = "read at samples apart"
"""In the metadata of a recording between whose samples the spec's times fall: how far apart they are now [s]."""
SHOWN = 6
"""Channels that are named in a note; of more the number is told."""


@dataclass(frozen=True)
class Used:
    """Which of the real rollouts a diagnosis is of.

    Attributes:
        rollouts: that there are.
        count: how many of them it is of; of the others all failed.
        begun: whether a cause is named without some of these, that failed too.
        held: how many of them were held out.
        recorded: how many more there were that nobody asked for, and these; 0 of a machine that is asked.
        others: how many were recorded with another value of a parameter of which the spec has one.
    """

    rollouts: Sequence[Rollout]
    count: int
    begun: bool
    held: int
    recorded: int
    others: int = 0


def notes(
    bench: Bench,
    used: Used,
    least: tuple[int, int],
    idle: Sequence[str] = (),
    why: Falls | None = None,
    odd: Sequence[Finding] = (),
    alone: Sequence[Mapping[str, float]] = (),
) -> tuple[str, ...]:
    """Return, a sentence each, what these rollouts lack for a diagnosis.

    Args:
        bench: the simulator whose channels they should have.
        used: the rollouts.
        least: from how many different tests, and rollouts, on some are held out.
        idle: effects of the catalogue that change nothing at any test.
        why: what may have ended some of them early.
        odd: what the recordings seem to have wrong.
        alone: tests at which the simulator ends early, and the machine does not.
    """
    found = [each.text for each in odd]
    rollouts, count = used.rollouts, len(used.rollouts)
    if idle:
        found.append(
            f"at the tests of this spec, {', '.join(idle)} {'changes' if len(idle) == 1 else 'change'} nothing in the "
            f"simulator. No data can show {'it' if len(idle) == 1 else 'them'}, so the diagnosis leaves "
            f"{'it' if len(idle) == 1 else 'them'} out"
        )
    if used.recorded > count:
        found.append(
            f"only the first {count} of {used.recorded} recorded rollouts were used, because of the budget"
        )
    if used.others:
        fixed = ", ".join(bench.matched.fixed)
        found.append(
            f"{used.others} recorded rollouts were not used: they have another value of {fixed} than the spec"
        )
    fell = [trace.failure for _, trace in rollouts if trace.failure is not None]
    if fell:
        kinds = ", ".join(sorted({str(failure) for failure in fell}))
        early = f"{len(fell)} of {count} real rollouts ended early ({kinds}{_again(rollouts)})"
        if used.count < count:
            found.append(f"{early}, and {'is' if len(fell) == 1 else 'are'} left out")
        elif used.begun:
            found.append(f"{early}. The others name the cause; the gap in ρ includes all")
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
        more = f" and {len(lacking) - SHOWN} more" if len(lacking) > SHOWN else ""
        found.append(
            f"the real rollouts have no {', '.join(lacking[:SHOWN])}{more}. An effect that only these would show "
            f"cannot be found{_unread(bench, rollouts)}"
        )
    found += _gaps(bench, rollouts, lacking)
    found += _without_residuals(bench, rollouts)
    tests = {key_of(test) for test, _ in rollouts}
    if len(tests) == 1 and rollouts[0][0]:
        found.append("all real rollouts repeat one test, so nothing is known about other tests")
    if not used.held:
        takes, here = f"{least[1]} rollouts of {least[0]} different tests", f"{count} of {len(tests)}"
        if not bench.spec.space.dim:
            # There is one test, and rollouts of it are all there is to hold out.
            takes, here = f"{least[0]} rollouts", f"{count}"
        found.append(
            f"no rollouts were held out, so the reduction of the gap was not measured: it takes {takes}, and there are "
            f"{here}"
        )
    return tuple(found)


def hidden_by_one(effect: Effect, far: HowFar) -> str:
    """Return what is said where a gap is not material because of one effect's prior alone."""
    priors = " and ".join(f"{p.name}: {p.prior}" for p in effect.parameters)
    gap, little = (f"{value:.3g} {far.unit}".rstrip() for value in (far.before.mean, far.background))
    more = (
        f"{far.before.mean / far.floor:.0f} times the scatter"
        if far.floor > 0.0
        else "larger than the scatter"
    )
    return (
        f"the gap of {gap} is {more}. It is not called material because a few percent of every effect make {little}, "
        f"nearly all of it from {effect.name}. Is its prior right ({priors})? If not, write a smaller one"
    )


def looked_again(tests: int) -> str:
    """Return what is said where so many tests had been held out that alone show a gap."""
    which, its = ("1 of them was", "its place") if tests == 1 else (f"{tests} of them were", "their places")
    return (
        f"only held-out tests showed the gap, and the first answer did not close it. So {which} diagnosed after all, "
        f"and other tests were held out in {its}"
    )


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
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return f". The simulator has no {', '.join(names[:SHOWN])}{more}: is a name misspelt?" if names else ""


def _gaps(bench: Bench, rollouts: Sequence[Rollout], lacking: Sequence[str]) -> list[str]:
    """Return which channels some rollouts lack, or have gaps in, a sentence for every number of rollouts."""
    read = None if bench.features is None else {block.source for block in bench.features.blocks}
    holes: dict[int, list[str]] = {}
    for channel in bench.backend.channels:
        name = channel.name
        if name in lacking or (read is not None and name not in read):
            continue
        count = sum(name not in trace.channels or not np.isfinite(trace[name]).all() for _, trace in rollouts)
        if count:
            holes.setdefault(count, []).append(name)
    return [_missing(names, count, len(rollouts)) for count, names in holes.items()]


def _missing(names: Sequence[str], count: int, rollouts: int) -> str:
    """Return that so many of the rollouts lack these channels, or have gaps in them."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    verbs = ("is missing or has", "is") if len(names) == 1 else ("are missing or have", "are")
    return (
        f"{', '.join(names[:SHOWN])}{more} {verbs[0]} gaps in {count} of {rollouts} real rollouts, and {verbs[1]} not "
        f"used {'there' if 2 * count < rollouts else 'at all'}"
    )


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
