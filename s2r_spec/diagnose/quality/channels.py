"""Mistakes that one channel tells by itself: beside the simulator's, or in one rollout beside all others.

Each check reads every sample, so that it sees what is too short, or in too few rollouts, for :mod:`.comparison`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Channel
from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.gap import LEVEL
from s2r_spec.diagnose.quality.faults import PER_RADIAN
from s2r_spec.diagnose.quality.finding import Finding, join_words, rollout_name
from s2r_spec.diagnose.quality.recordings import Recordings, as_columns, rms
from s2r_spec.space import key_of
from s2r_spec.trace import Trace
from s2r_spec.trace.samples import between, period_of

UNITS = {
    **{"1000 times": 1e3, "100 times": 1e2, "57 times": 180.0 / np.pi},
    **{"a thousandth of": 1e-3, "a hundredth of": 1e-2, "a 57th of": np.pi / 180.0},
}
"""Definition: factors by which a channel is off whose unit was forgotten: milli and kilo, centi, degrees."""
NEAR = 1.5
"""Tolerance: a factor is one of these if it is this many times as much at most, for what a machine lacks moves its
commands, too."""
ODD = 5.0
"""Tolerance: one rollout has what most have not if it is so many times as much as in half of them."""
FREEDOM = 0.19
"""Definition: degrees of freedom of a deviation by the median of |second differences|, in parts of their number: 0.37,
the median's efficiency, over 1 + 2 Σ r² = 1.94, for their correlations r are −2/3 and 1/6."""
PART = 0.2
"""Tolerance: part of a range, of a turn or of a rollout that counts."""


def by_channel(of: Recordings) -> list[Finding]:
    """Return the first finding about every channel, and about "the tests"."""
    checks = (find_still, find_wrapped, unit, unit_of_one, spike, find_stopped)
    mistakes = [
        next(filter(None, (check(channel, of) for check in checks)), None)
        for channel in of.bench.backend.channels
    ]
    return [*filter(None, mistakes), *find_copied(of)]


def find_still(channel: Channel, of: Recordings) -> Finding | None:
    """Find a channel that never moves, and always in the simulator; what is 0 or 1 may well not move."""
    name = channel.name
    pairs = of.paired(name)
    moved = [[np.ptp(trace[name], axis=0).max() for trace in pair] for pair in pairs]
    flag = any(np.isin(simulated[name], (0.0, 1.0)).all() for simulated, _ in pairs)
    if flag or not moved or not all(here > 0.0 == there for here, there in moved):
        return None
    text = f"{name} of the real rollouts never changes, and the simulator's does. Was it recorded? If not, leave it out"
    return Finding("still", name, text)


def find_wrapped(channel: Channel, of: Recordings) -> Finding | None:
    """Find an angle that jumps by a turn, where the simulator's goes on."""
    if channel.unit not in PER_RADIAN:
        return None
    turn = 2.0 * np.pi * PER_RADIAN[channel.unit]

    def jumps(trace: Trace) -> bool:
        steps = np.abs(np.diff(as_columns(trace, channel.name), axis=0))
        return bool((np.abs(steps - turn) < PART * turn).any())

    count = sum(jumps(trace) for _, trace in of.rollouts)
    if not count or any(jumps(simulated) for simulated, _ in of.pairs):
        return None
    text = (
        f"{channel.name} jumps by a full turn in {count} of {len(of.rollouts)} real rollouts, and the simulator's does "
        f"not. Unwrap it in the recordings, as numpy.unwrap does"
    )
    return Finding("wrapped", channel.name, text)


def unit(channel: Channel, of: Recordings) -> Finding | None:
    """Find a channel that is a factor of a forgotten unit larger than the simulator's."""
    name = channel.name
    sizes = np.array([(rms(here[name]), rms(there[name])) for here, there in of.paired(name)])
    # One that is next to nothing in either is no matter of units.
    if not channel.unit or not sizes.size or not sizes.min() > 0.0:
        return None
    times = sizes[:, 1] / sizes[:, 0]
    words = _times(float(np.median(times))) if times.max() <= NEAR * times.min() else ""
    text = (
        f"{name} of the real rollouts is about {words} the simulator's. Is it in {channel.unit}? If not, write its "
        f"unit in the recording"
    )
    return Finding("unit", name, text, "another unit") if words else None


def unit_of_one(channel: Channel, of: Recordings) -> Finding | None:
    """Find the rollout in which a channel is farthest from its usual size, by such a factor of the simulator's."""
    name = channel.name
    sizes = np.array([rms(as_columns(trace, name)) for _, trace in of.rollouts])
    if not channel.unit or np.count_nonzero(sizes) <= len(sizes) / 2:
        return None
    far = np.log(np.where(sizes > 0.0, sizes, np.median(sizes[sizes > 0.0])) / np.median(sizes[sizes > 0.0]))
    number = int(np.abs(far).argmax())
    if abs(far[number]) < np.log(ODD):
        return None
    test, trace = of.rollouts[number]
    simulated = of.simulated(test)
    size = rms(as_columns(simulated, name))
    words = _times(float(sizes[number]) / size) if size else ""
    if not words:
        return None
    # Another channel of that size is not this one in another unit.
    there = between(
        simulated.times - simulated.times[0], trace.times - trace.times[0], as_columns(trace, name)
    )
    if rms(there / UNITS[words] - as_columns(simulated, name)) > (NEAR - 1.0) * size:
        return None
    text = (
        f"{name} of {rollout_name(number, test)} is about {words} the simulator's, and in no other rollout. Is it in "
        f"{channel.unit} there? If not, convert it, or leave the rollout out"
    )
    return Finding("unit of one", name, text)


def _times(much: float) -> str:
    words, factor = min(UNITS.items(), key=lambda item: abs(np.log(much / item[1])))
    return words if 1.0 / NEAR < much / factor < NEAR else ""


def spike(channel: Channel, of: Recordings) -> Finding | None:
    """Find the single sample that is farthest off its neighbours, and farther than noise ever is.

    A sample of n is off its neighbours by at most y_i = |x_i − (x_i−1 + x_i+1) / 2|. In white noise y is half-normal;
    its deviation is s, the median of y over that of |N(0, 1)|, with d = FREEDOM · n degrees of freedom. So all N
    samples of all channels and rollouts are off by at most s t_d(1 − LEVEL / 2N) with probability 1 − LEVEL
    (Bonferroni). The median's efficiency of 0.37: Rousseeuw and Croux, *J. Am. Stat. Assoc.* 88 (1993).
    """
    name = channel.name
    one = _odd_rollout(
        of,
        name,
        lambda trace: (
            _isolation(as_columns(trace, name)).max(axis=0) / np.ptp(as_columns(trace, name), axis=0)
        ),
    )
    if one is None:
        return None
    number, column = one
    test, trace = of.rollouts[number]
    values = as_columns(trace, name)
    far = _isolation(values)[:, column]
    every = [as_columns(each, name)[:, column] for _, each in of.rollouts if name in each.channels]
    if far.max() <= _noise_at_most(values[:, column], _resolution(every), of.samples):
        return None
    text = (
        f"{name} of {rollout_name(number, test)} is off by {f'{far.max():.3g} {channel.unit}'.rstrip()} for one sample "
        f"at {trace.times[far.argmax()]:.4g} s, and in no other rollout. Is it an error of the recording? If so, "
        f"correct the sample, or leave the rollout out"
    )
    return Finding("spike", name, text)


def _isolation(values: FloatArray) -> FloatArray:
    """Return (samples, columns) how far each sample is from both of its neighbours: 0 in a step or a slope."""
    away = np.zeros_like(values)
    away[1:-1] = np.abs(values[1:-1] - np.median([values[:-2], values[1:-1], values[2:]], axis=0))
    return away


def _noise_at_most(values: FloatArray, resolution: float, among: int) -> float:
    """Return how far any of so many samples of noise is off its neighbours; ``values`` (n,) tell its deviation."""
    from scipy.stats import t  # here: a rollout needs no scipy

    apart = np.abs(values[1:-1] - (values[:-2] + values[2:]) / 2.0)
    # What is quantised may keep its value at most samples, and is known to a step.
    deviation = max(float(np.median(apart)) / NormalDist().inv_cdf(0.75), resolution)
    return deviation * float(t.ppf(1.0 - LEVEL / (2.0 * among), FREEDOM * len(values)))


def _resolution(columns: Sequence[FloatArray]) -> float:
    """Return the smallest step of a column in any rollout; 0 where it has none."""
    steps = np.concatenate([np.abs(np.diff(values)) for values in columns])
    return float(steps[steps > 0.0].min(initial=np.inf))


def find_stopped(channel: Channel, of: Recordings) -> Finding | None:
    """Find a channel that keeps one value for long in one rollout, but for one at which it saturates."""
    name = channel.name
    one = _odd_rollout(
        of, name, lambda trace: np.diff(_longest_constant(trace, name), axis=0)[0] / trace.duration
    )
    if one is None:
        return None
    number, column = one
    test, trace = of.rollouts[number]
    since, until = _longest_constant(trace, name)[:, column]
    every = [as_columns(each, name)[:, column] for _, each in of.rollouts if name in each.channels]
    ends = [end(values) for values in every for end in (np.min, np.max)]
    if as_columns(trace, name)[trace.times >= since, column][0] in (min(ends), max(ends)):
        return None
    text = (
        f"{name} of {rollout_name(number, test)} keeps one value from {since:.4g} to {until:.4g} s, while the "
        f"simulator's changes. Was it recorded all the time? If not, leave the rollout out"
    )
    return Finding("stopped", name, text)


def _longest_constant(trace: Trace, name: str) -> FloatArray:
    """Return (2, columns) from when until when [s] each column of a channel keeps its value the longest."""
    intervals = []
    for values in as_columns(trace, name).T:
        at = _changes(values[:, None])
        first, last = trace.times[at], trace.times[np.append(at[1:] - 1, len(values) - 1)]
        k = int(np.argmax(last - first))
        intervals.append((first[k], last[k]))
    return np.array(intervals).reshape(-1, 2).T


def _changes(values: FloatArray) -> NDArray[np.int64]:
    return np.append(0, 1 + np.flatnonzero((np.diff(values, axis=0) != 0.0).any(axis=1)))


def _odd_rollout(of: Recordings, name: str, part: Callable[[Trace], FloatArray]) -> tuple[int, int] | None:
    """Return number and column of the rollout that has most of something that others, and the simulator, have not.

    The channel is of measured numbers, no flag or count. ``part`` gives (columns,) how much of it there is in a trace,
    as a part of a range or of a rollout.
    """
    having = [
        (number, trace)
        for number, (_, trace) in enumerate(of.rollouts)
        for values in [as_columns(trace, name)]
        if len(values) > 2 and np.isfinite(values).all() and not (values == np.round(values)).all()
    ]
    if len(having) < 2:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = np.nan_to_num([part(trace) for _, trace in having])
        odd = np.where(parts >= np.maximum(PART, ODD * np.median(parts, axis=0)), parts, 0.0)
        k, column = (int(place) for place in np.unravel_index(odd.argmax(), odd.shape))
        number = having[k][0]
        here = np.nan_to_num(part(of.simulated(of.rollouts[number][0]))) if odd[k, column] else np.zeros(0)
    return (number, column) if len(here) and ODD * here[column] <= odd[k, column] else None


def find_copied(of: Recordings) -> list[Finding]:
    """Find the first recording that stands under two tests; not where these are one to the simulator, too."""
    number_by_key: dict[tuple[bytes, ...], int] = {}
    for number, (test, trace) in enumerate(of.rollouts):
        first = number_by_key.setdefault(_bytes(trace), number)
        before = of.rollouts[first][0]
        if key_of(before) == key_of(test):
            continue
        if _bytes(of.simulated(before)) == _bytes(of.simulated(test)):
            return []
        text = f"{rollout_name(number, test)} equals {rollout_name(first, before)} in every sample. Which test was it?"
        return [Finding("copied", "the tests", text)]
    return []


def _bytes(trace: Trace) -> tuple[bytes, ...]:
    return tuple(values.tobytes() for _, values in sorted(trace.channels.items()))


def hold(of: Recordings) -> tuple[list[Finding], Recordings]:
    """Find channels that keep each value for several samples, where the simulator's move at every one.

    A held channel is also late by half of what it is held, so that the other checks get straight lines between the
    samples at which it changes: the recordings without the finding.
    """
    if not of.pairs:
        return [], of
    held: dict[str, float] = {}
    step = max(period_of(trace.times) for pair in of.pairs for trace in pair)
    for channel in of.bench.backend.channels:
        kept = [[_hold_time(trace, channel.name) for trace in pair] for pair in of.pairs]
        there = [seconds if regular else 0.0 for _, (seconds, regular) in kept]
        here = max(seconds for (seconds, _), _ in kept)
        if min(there) > 2.0 * max(step, here) and max(there) <= NEAR * min(there):
            held[channel.name] = float(np.median(there))
    if not held:
        return [], of
    names, one = list(held), len(held) == 1
    text = (
        f"{join_words(names)} of the real rollouts {'keeps' if one else 'keep'} each value for "
        f"{float(np.median(list(held.values()))):.2g} s, while the simulator's {'changes' if one else 'change'} at "
        f"every sample. Was the last value repeated between slower samples? If so, record {'it' if one else 'them'} as "
        f"often as the rest"
    )
    straight = [(test, _straight(trace, names)) for test, trace in of.rollouts]
    return [Finding("hold", join_words(names), text)], replace(of, rollouts=straight)


def _hold_time(trace: Trace, name: str) -> tuple[float, bool]:
    """Return how long [s] a channel usually keeps a value, 0 where it hardly moves, and whether that is one time.

    What is quantised is kept as long as its slope wants, and its steps are of few sizes.
    """
    values = as_columns(trace, name)
    at = _changes(values)
    if len(at) <= 2 or not np.isfinite(values).all():
        return 0.0, False
    runs = np.diff(at)
    usual = float(np.median(runs))
    steps = np.abs(np.diff(values[at], axis=0))
    sizes = max(len(np.unique(np.round(column / max(column.max(), 1e-300), 3))) for column in steps.T)
    regular = sizes > ODD and (np.abs(runs - usual) <= 1.0).mean() >= 1.0 - PART
    return usual * period_of(trace.times), bool(regular)


def _straight(trace: Trace, names: Sequence[str]) -> Trace:
    channels = dict(trace.channels)
    for name in names:
        if name in channels and np.isfinite(channels[name]).all():
            values = as_columns(trace, name)
            at = _changes(values)
            straight = [np.interp(trace.times, trace.times[at], column[at]) for column in values.T]
            channels[name] = np.stack(straight, axis=1).reshape(channels[name].shape)
    return replace(trace, channels=channels)
