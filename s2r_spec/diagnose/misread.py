"""What seems to be misread in the real rollouts: a channel in another unit, or that counts or begins otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Channel
from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.simulate import Bench, blamed
from s2r_spec.errors import BackendError
from s2r_spec.space import key_of
from s2r_spec.trace import Trace, between

FloatArray = NDArray[np.float64]
Rollout = tuple[dict[str, float], Trace]
Pair = tuple[Trace, Trace]
"""A simulated rollout, and the real one of the same test."""

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
ROUNDED, STEPS = 1e-5, 1.5
"""What it leaves at the same time is more than the first, which is rounding, and the other time further away than so
many steps of the simulator: nobody reads two clocks better."""
TURNS, NEARLY = {"rad": 2.0 * np.pi, "deg": 360.0}, 0.1
"""By unit, what an angle jumps by where it is kept within a turn; by this part of it more or less."""
OTHERWISE = 15.0
"""Times that a channel is larger or smaller in one rollout than in most, from which on the simulator is asked why."""
LATEST = 0.25
"""Part of a rollout by which it is looked for earlier and later."""


def misread(bench: Bench, rollouts: Sequence[Rollout], lines: Sequence[Line] = ()) -> dict[str, str]:
    """Return what to say of each channel that seems to have another unit, sign or begin than the simulator's.

    And of "the tests", where one recording stands under two of them.

    Args:
        bench: the simulator.
        rollouts: the machine's.
        lines: of the catalogue; a channel that none of them moves is a command, and tells when a recording began.
    """
    ran = [(test, trace) for test, trace in rollouts if trace.failure is None][:COMPARED]
    if not ran:
        return {}
    pairs = []
    for test, trace in ran:
        with blamed(bench, {}, test, 0):
            pairs.append((bench.run({}, test, 0), trace))
    found = {}
    for channel in bench.backend.channels:
        if words := (
            _other_sign(channel, pairs)
            or _other_unit(channel, pairs)
            or _other_unit_of_one(bench, channel, rollouts)
        ):
            found[channel.name] = words
        if words := _wrapped(channel, [trace for _, trace in rollouts], pairs):
            found[channel.name] = words
        if _still(channel.name, pairs):
            found[channel.name] = (
                f"{channel.name} of the real rollouts never moves, and the simulator's does: was it recorded? If not, "
                f"leave it out"
            )
    if words := _copied(bench, rollouts):
        found["the tests"] = words
    for name in _commands(bench, lines, ran[0][0], pairs[0][0]):
        if words := _other_begin(name, pairs):
            found[name] = words
    return found


def _other_sign(channel: Channel, pairs: Sequence[Pair]) -> str:
    name, factors = channel.name, _factors(channel.name, pairs)
    if not factors or not 1.0 / LOUD < np.median(factors) < LOUD:
        return ""
    if max(_correlation(simulated, real, name) for simulated, real in pairs) >= OPPOSITE:
        return ""
    return f"{name} of the real rollouts goes the other way than the simulator's: does it count the same way?"


def _other_unit(channel: Channel, pairs: Sequence[Pair]) -> str:
    name, factors = channel.name, _factors(channel.name, pairs)
    # One that is next to nothing in either is no matter of units.
    if not factors or not channel.unit or max(factors) > NEAR**2 * min(factors):
        return ""
    alike = float(np.median([_correlation(simulated, real, name) for simulated, real in pairs]))
    words = _times(float(np.median(factors)), FAR if abs(alike) > ALIKE else NEAR)
    if not words:
        return ""
    return (
        f"{name} of the real rollouts is about {words} the simulator's: is it in {channel.unit}? If not, say its unit "
        f"in the recording"
    )


def _times(much: float, reach: float) -> str:
    """Return which of the factors of a forgotten unit this is, to within ``reach`` times; "" for none."""
    words, factor = min(UNITS.items(), key=lambda item: abs(np.log(much / item[1])))
    return words if 1.0 / reach < much / factor < reach else ""


def _other_unit_of_one(bench: Bench, channel: Channel, rollouts: Sequence[Rollout]) -> str:
    """Say of the first rollout in which a channel is another size by one of the factors, and the simulator's is not."""
    name = channel.name
    sizes = np.array([_rms(trace[name]) if name in trace.channels else 0.0 for _, trace in rollouts])
    if not channel.unit or np.count_nonzero(sizes) <= len(sizes) / 2:
        return ""
    factors = sizes / np.median(sizes[sizes > 0.0])
    odd = np.flatnonzero((sizes > 0.0) & ((factors > OTHERWISE) | (factors < 1.0 / OTHERWISE)))
    if not len(odd):
        return ""
    number = int(odd[0])
    test, trace = rollouts[number]
    with blamed(bench, {}, test, 0):
        simulated = bench.run({}, test, 0)
    of_one = _factors(name, [(simulated, trace)])
    words = _times(of_one[0], FAR) if of_one else ""
    if not words:
        return ""
    return (
        f"{name} of {called(number, test)} is about {words} the simulator's, and not so in the others: is it "
        f"in {channel.unit} there? If not, convert it, or leave the rollout out"
    )


def _copied(bench: Bench, rollouts: Sequence[Rollout]) -> str:
    """Say of the first recording that stands under two tests; not where these are one to the simulator, too."""
    seen: dict[tuple[bytes, ...], int] = {}
    for number, (test, trace) in enumerate(rollouts):
        first = seen.setdefault(_bytes(trace), number)
        before = rollouts[first][0]
        if key_of(before) == key_of(test):
            continue
        with blamed(bench, {}, test, 0):
            alike = _bytes(bench.run({}, before, 0)) == _bytes(bench.run({}, test, 0))
        if alike:
            return ""
        return f"{called(number, test)} is {called(first, before)}, sample for sample: which of the tests was it?"
    return ""


def _bytes(trace: Trace) -> tuple[bytes, ...]:
    return tuple(values.tobytes() for _, values in sorted(trace.channels.items()))


def called(number: int, test: Mapping[str, float]) -> str:
    """Return which real rollout it is, in words."""
    values = ", ".join(f"{name} = {value:.4g}" for name, value in test.items())
    return f"real rollout {number}" + (f" ({values})" if values else "")


def _factors(name: str, pairs: Sequence[Pair]) -> list[float]:
    """Return how many times the simulator's each real one is; nothing where one of the two is nothing, or is not."""
    if not all(name in trace.channels for pair in pairs for trace in pair):
        return []
    sizes = [(_rms(simulated[name]), _rms(real[name])) for simulated, real in pairs]
    return [there / here for here, there in sizes] if all(min(both) > 0.0 for both in sizes) else []


def _wrapped(channel: Channel, real: Sequence[Trace], pairs: Sequence[Pair]) -> str:
    turn = TURNS.get(channel.unit)
    if turn is None:
        return ""
    count = sum(_jumps(trace, channel.name, turn) for trace in real)
    if not count or any(_jumps(simulated, channel.name, turn) for simulated, _ in pairs):
        return ""
    return (
        f"{channel.name} jumps by a turn in {count} of {len(real)} real rollouts, and the simulator's goes on: "
        f"unwrap it in the recordings, as numpy.unwrap does"
    )


def _jumps(trace: Trace, name: str, turn: float) -> bool:
    """Return whether an angle jumps by a turn from one sample to the next."""
    if name not in trace.channels:
        return False
    steps = np.abs(np.diff(trace[name], axis=0))
    return bool((np.abs(steps - turn) < NEARLY * turn).any())


def _still(name: str, pairs: Sequence[Pair]) -> bool:
    """Return whether a channel moves in every simulated rollout, and in no real one; what is 0 or 1 may well not."""
    if not all(name in trace.channels for pair in pairs for trace in pair):
        return False
    moved = [[float(np.ptp(trace[name], axis=0).max()) for trace in pair] for pair in pairs]
    flag = any(np.isin(simulated[name], (0.0, 1.0)).all() for simulated, _ in pairs)
    return not flag and all(here > 0.0 and there == 0.0 for here, there in moved)


def _other_begin(name: str, pairs: Sequence[Pair]) -> str:
    if not all(name in real.channels for _, real in pairs):
        return ""
    by = [seconds for pair in pairs if (seconds := _later(*pair, name)) is not None]
    if len(by) < len(pairs) or np.ptp(by) > 0.2 * abs(by[0]):
        return ""
    when = float(np.median(by))
    return (
        f"{name} of the real rollouts, which no effect changes, comes {abs(when):.3g} s "
        f"{'after' if when > 0.0 else 'before'} the simulator's: do the recordings begin so much "
        f"{'too early' if when > 0.0 else 'too late'}?"
    )


def _commands(bench: Bench, lines: Sequence[Line], test: Mapping[str, float], plain: Trace) -> list[str]:
    """Return the channels of one number that are as in ``plain``, whatever is added to the simulator and drawn."""
    much: dict[str, dict[str, float]] = {}
    for line in lines:
        half = line.value(0.5 if line.values[-1] > line.nominal else -0.5)
        much.setdefault(line.effect, {}).update(line.at(half)[line.effect])
    if not much:
        return []
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
    if 1.0 - at_once < ROUNDED or at_once == -1.0:
        return None
    lags = sorted(range(-most, most + 1), key=abs)
    best = max(lags, key=alike)
    there = alike(best)
    if abs(best) < STEPS or there < SAME or 1.0 - there > BETTER * (1.0 - at_once):
        return None
    return best * step


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


def _rms(values: FloatArray) -> float:
    """Return the root mean square of what is a number; 0 of nothing."""
    known = values[np.isfinite(values)]
    return float(np.sqrt((known**2).mean())) if known.size else 0.0
