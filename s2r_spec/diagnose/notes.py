"""What the real rollouts lack for a diagnosis: channels, tests, rollouts that ended whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import HasResiduals
from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.falls import Falls, always_early
from s2r_spec.diagnose.simulate import Bench, blamed
from s2r_spec.errors import BackendError, TraceError
from s2r_spec.space import key_of
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Rollout = tuple[dict[str, float], Trace]

CUT = "cut at"
"""In the metadata of a recording of which only the begin is used: until when [s]."""
READ_AT = "read at samples apart"
"""In the metadata of a recording between whose samples the spec's times fall: how far apart they are now [s]."""
UNITS = {
    "1000 times": 1e3,
    "a thousandth of": 1e-3,
    "100 times": 1e2,
    "a hundredth of": 1e-2,
    "57 times": 180.0 / np.pi,
    "a 57th of": np.pi / 180.0,
}
"""Factors by which a channel is off whose unit was forgotten: milli and kilo, centi, degrees."""
NEAR = 1.2
"""A factor is one of these if it is this many times as much at most."""
FAR, ALIKE = 1.6, 0.8
"""Or, where a channel is correlated with the simulator's by the second at least, this many times: what a machine
lacks moves its commands, too."""
LOUD = 5.0
"""A channel with the other sign is at most so many times the simulator's, or a part of it."""
COMPARED = 5
"""Rollouts that are compared with the simulator for it, at most."""
OPPOSITE = -0.9
"""A channel whose correlation with the simulator's is below this in all of them has the other sign."""
SAME, BETTER = 0.999, 0.1
"""A command is the simulator's at another time if it is correlated with it there by the first at least, and what that
leaves is the second part, at most, of what it leaves at the same time."""
LATEST = 0.25
"""Part of a rollout by which it is looked for earlier and later."""
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
    misread: Mapping[str, str] | None = None,
    alone: Sequence[Mapping[str, float]] = (),
) -> tuple[str, ...]:
    """Return, a sentence each, what these rollouts lack for a diagnosis.

    Args:
        bench: the simulator whose channels they should have.
        used: the rollouts.
        least: from how many different tests, and rollouts, on some are held out.
        idle: effects of the catalogue that change nothing at any test.
        why: what may have ended some of them early.
        misread: of :func:`misread`.
        alone: tests at which the simulator ends early, and the machine does not.
    """
    found = list((misread or {}).values())
    rollouts, count = used.rollouts, len(used.rollouts)
    if idle:
        found.append(
            f"at the tests of this spec the simulator does the same with and without {', '.join(idle)}: no data can "
            f"say whether that is there, and it is left out of the catalogue"
        )
    if used.recorded > count:
        found.append(
            f"only the first {count} of {used.recorded} recorded rollouts were used, as the budget says"
        )
    if used.others:
        fixed = ", ".join(bench.matched.fixed)
        found.append(
            f"{used.others} recorded rollouts were not used: what the spec gives one value ({fixed}) had another there"
        )
    fell = [trace.failure for _, trace in rollouts if trace.failure is not None]
    if fell:
        kinds = ", ".join(sorted({str(failure) for failure in fell}))
        early = f"{len(fell)} of {count} real rollouts ended early ({kinds}{_again(rollouts)})"
        if used.count < count:
            found.append(f"{early} and {'is' if len(fell) == 1 else 'are'} left out")
        elif used.begun:
            found.append(f"{early}: the cause is named from the others, the gap in ρ is that of all")
        else:
            found.append(f"{early}: the cause is named from what came before, too, which says little")
        if why is not None:
            found[-1] += f"; {why}"
    if alone:
        tests = {key_of(test) for test, _ in rollouts}
        where = " and ".join(
            ", ".join(f"{k} = {v:.4g}" for k, v in test.items()) or "the only test" for test in alone[:SHOWN]
        )
        found.append(
            f"the simulator itself, with no effect, ends early at {len(alone)} of {len(tests)} tests, where no real "
            f"rollout does ({where}): the gap in ρ there is that of a fall, and few causes can be told from it; make "
            f"the simulator stand there first, or ask of a smaller test space"
        )
    longer = [trace.meta[CUT] for _, trace in rollouts if CUT in trace.meta]
    if longer:
        found.append(
            f"{len(longer)} of {count} real rollouts go on after the simulator's end: only their first "
            f"{longer[0]:g} s are used"
        )
    apart = [trace.meta[READ_AT] for _, trace in rollouts if READ_AT in trace.meta]
    if apart:
        found.append(
            f"the spec's times fall between the samples of {len(apart)} of {count} real rollouts: these are read at "
            f"the simulator's, {apart[0]:g} s apart, by straight lines, which may change ρ a little"
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
            f"the real rollouts have no {', '.join(lacking[:SHOWN])}{more}: what shows there alone cannot be told"
        )
    found += _gaps(bench, rollouts, lacking)
    found += _without_residuals(bench, rollouts)
    tests = {key_of(test) for test, _ in rollouts}
    if len(tests) == 1 and rollouts[0][0]:
        found.append("all real rollouts are of one test: of the others nothing was seen")
    if not used.held:
        takes, here = f"{least[1]} rollouts of {least[0]} different tests", f"{count} of {len(tests)}"
        if not bench.spec.space.dim:
            # There is one test, and rollouts of it are all there is to hold out.
            takes, here = f"{least[0]} rollouts", f"{count}"
        found.append(
            f"nothing was held out, so how far the gap shrinks was not measured: that takes {takes}, and here are "
            f"{here}"
        )
    return tuple(found)


def looked_again(tests: int) -> str:
    """Return what is said where so many tests had been held out that alone show a gap."""
    which, its = ("a test", "its place") if tests == 1 else (f"{tests} tests", "their places")
    return (
        f"the gap showed at tests alone that had been held out, and what was found did not close it: {which} of them "
        f"{'was' if tests == 1 else 'were'} diagnosed with after all, and others held out in {its}"
    )


def _again(rollouts: Sequence[Rollout]) -> str:
    """Return at how many tests rollouts ended early every time, in words."""
    always = always_early(rollouts)
    tests = {key_of(test) for test, trace in rollouts if trace.failure is not None}
    if not always:
        return ""
    if len(tests) == 1:
        return ", every time at one test: no accident"
    return f", at {len(tests)} tests, at {always} of them every time of several: no accident"


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
    return [
        f"{', '.join(names[:SHOWN])}{f' and {len(names) - SHOWN} more' if len(names) > SHOWN else ''} "
        f"{'is' if len(names) == 1 else 'are'} missing, or no number at times, in {count} of {len(rollouts)} real "
        f"rollouts: nothing is read from {'it' if len(names) == 1 else 'them'} "
        f"{'there' if 2 * count < len(rollouts) else 'at all'}"
        for count, names in holes.items()
    ]


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
        f"the equations of motion could be asked of no real rollout ({why}): causes are told by the channels alone"
    ]


def misread(bench: Bench, rollouts: Sequence[Rollout], lines: Sequence[Line] = ()) -> dict[str, str]:
    """Return what to say of each channel that seems to have another unit, sign or begin than the simulator's.

    Args:
        bench: the simulator.
        rollouts: the machine's.
        lines: of the catalogue; a channel that none of them moves is a command, and tells when a recording began.
    """
    ran = [(test, trace) for test, trace in rollouts if trace.failure is None][:COMPARED]
    factors: dict[str, list[float]] = {}
    alike: dict[str, list[float]] = {}
    late: dict[str, list[float]] = {}
    still: list[str] = []
    commands = _commands(bench, lines, ran[0][0]) if ran else []
    for test, trace in ran:
        with blamed(bench, {}, test, 0):
            simulated = bench.run({}, test, 0)
        for name in commands:
            if name in trace.channels and (seconds := _later(simulated, trace, name)) is not None:
                late.setdefault(name, []).append(seconds)
        for channel in bench.backend.channels:
            name = channel.name
            if name in trace.channels and name in simulated.channels:
                here, there = (_rms(x[name]) for x in (simulated, trace))
                moved, stood = (float(np.ptp(x[name], axis=0).max()) for x in (simulated, trace))
                if moved > 0.0 and stood == 0.0 and not np.isin(simulated[name], (0.0, 1.0)).all():
                    still.append(name)
                if here > 0.0 and there > 0.0:
                    factors.setdefault(name, []).append(there / here)
                    alike.setdefault(name, []).append(_correlation(simulated, trace, name))
    found = {}
    for channel in bench.backend.channels:
        name, of = channel.name, factors.get(channel.name, [])
        if not of or len(of) < len(ran):
            continue
        middle = float(np.median(of))
        if 1.0 / LOUD < middle < LOUD and max(alike[name]) < OPPOSITE:
            found[name] = (
                f"{name} of the real rollouts goes the other way than the simulator's: does it count the same way?"
            )
        # One that is next to nothing in either is no matter of units.
        if not channel.unit or max(of) > NEAR**2 * min(of):
            continue
        words, factor = min(UNITS.items(), key=lambda item: abs(np.log(middle / item[1])))
        reach = FAR if abs(float(np.median(alike[name]))) > ALIKE else NEAR
        if 1.0 / reach < middle / factor < reach:
            found[name] = (
                f"{name} of the real rollouts is about {words} the simulator's: is it in {channel.unit}? If not, "
                f"say its unit in the recording"
            )
    for name in dict.fromkeys(still):
        if still.count(name) == len(ran):
            found[name] = (
                f"{name} of the real rollouts never moves, and the simulator's does: was it recorded? If not, leave it "
                f"out"
            )
    for name, by in late.items():
        if len(by) == len(ran) and np.ptp(by) <= 0.2 * abs(by[0]):
            when = float(np.median(by))
            found[name] = (
                f"{name} of the real rollouts, which no effect changes, comes {abs(when):.3g} s "
                f"{'after' if when > 0.0 else 'before'} the simulator's: do the recordings begin so much "
                f"{'too early' if when > 0.0 else 'too late'}?"
            )
    return found


def _commands(bench: Bench, lines: Sequence[Line], test: Mapping[str, float]) -> list[str]:
    """Return the channels of one number that are the same, whatever is added to the simulator and drawn."""
    much: dict[str, dict[str, float]] = {}
    for line in lines:
        half = line.value(0.5 if line.values[-1] > line.nominal else -0.5)
        much.setdefault(line.effect, {}).update(line.at(half)[line.effect])
    if not much:
        return []
    with blamed(bench, {}, test, 0):
        plain = bench.run({}, test, 0)
    try:
        with blamed(bench, much, test, 1):
            other = bench.run(much, test, 1)
    except BackendError:
        return []  # all of them at once, at half of what is typical, is more than anybody promised
    n = min(len(plain), len(other))
    if n < 0.5 * len(plain):
        return []
    return [
        name
        for name, values in plain.channels.items()
        if values.ndim == 1 and name in other.channels and np.array_equal(values[:n], other[name][:n])
    ]


def _later(simulated: Trace, real: Trace, name: str) -> float | None:
    """Return by how much a command comes later than the simulator's [s]; None where it does not, or is another."""
    times, own = simulated.times - simulated.times[0], real.times - real.times[0]
    step, values = float(np.median(np.diff(times))), real[name]
    if values.ndim != 1 or not np.isfinite(values).all():
        return None

    def alike(lag: int) -> float:
        at = times + lag * step
        common = (at >= 0.0) & (at <= own[-1])
        here, there = simulated[name][common], np.interp(at[common], own, values)
        if common.sum() < 0.5 * len(times) or not (here.std() and there.std()):
            return -1.0
        return float(np.corrcoef(here, there)[0, 1])

    most = int(LATEST * len(times))
    at_once = alike(0)
    if at_once >= SAME or at_once == -1.0:
        return None
    lags = sorted(range(-most, most + 1), key=abs)
    best = max(lags, key=alike)
    there = alike(best)
    return best * step if there >= SAME and 1.0 - there <= BETTER * (1.0 - at_once) else None


def _correlation(simulated: Trace, real: Trace, name: str) -> float:
    """Return the correlation of a channel with the simulator's, at the times of the latter; 0 where nothing moves."""
    times, own = simulated.times - simulated.times[0], real.times - real.times[0]
    common = times <= own[-1]
    here, there = simulated[name], between(times, own, real[name])
    if here.shape != there.shape:
        return 0.0
    both = np.array([here[common].ravel(), there[common].ravel()])
    both = both[:, np.isfinite(both).all(axis=0)]
    if both.shape[1] < 2 or not both.std(axis=1).all():
        return 0.0
    return float(np.corrcoef(both)[0, 1])


def between(times: FloatArray, own: FloatArray, values: FloatArray) -> FloatArray:
    """Return (m,) or (m, k) values at other times (m,): straight lines between those (n,) or (n, k) at ``own``."""
    if values.ndim == 1:
        return np.interp(times, own, values)
    return np.stack([np.interp(times, own, column) for column in values.T], axis=1)


def _rms(values: FloatArray) -> float:
    """Return the root mean square of what is a number; 0 of nothing."""
    known = values[np.isfinite(values)]
    return float(np.sqrt((known**2).mean())) if known.size else 0.0
