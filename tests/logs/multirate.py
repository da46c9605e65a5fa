"""Random logs of several topics, with their faults; :mod:`tests.logs.multirate_files` writes them.

Data: topics with a time of sending for each message [ms], whole numbers. A stamp is what the file says of it; a fault
makes both differ. Values of "real" fields are odd multiples of 1/8, so that sums and ties are exact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

FAULTS = (
    "gap", "late start", "early end", "reset", "stall", "merged", "repeated", "both repeated", "late", "jump", "unset",
    "missing",
)  # fmt: skip
MOST = 220
"""Budget: messages of a topic."""


@dataclass(frozen=True)
class Sent:
    """The messages of a topic in the order of the file.

    Args:
        name: its name.
        kinds: field → "real", "int" or "bool".
        times: when each message was sent [ms].
        stamps: what its stamp says [ms]; None for one that is not set.
        received: when it was recorded [ms].
        values: field → its values; NaN where a message has none.
    """

    name: str
    kinds: Mapping[str, str]
    times: tuple[int, ...]
    stamps: tuple[int | None, ...]
    received: tuple[int, ...]
    values: Mapping[str, tuple[float, ...]]

    def picked(self, order: Sequence[int]) -> Sent:
        """Return the messages of these numbers, in this order; a number may come twice."""

        def pick(row: Sequence[Any]) -> tuple[Any, ...]:
            return tuple(row[k] for k in order)

        return replace(
            self,
            times=pick(self.times),
            stamps=pick(self.stamps),
            received=pick(self.received),
            values={name: pick(row) for name, row in self.values.items()},
        )


@dataclass(frozen=True)
class Log:
    """A log, and the faults that were planted in it."""

    topics: tuple[Sent, ...]
    faults: tuple[str, ...]


# -- random logs ----------------------------------------------------------------------------------------------------


def drawn(rng: np.random.Generator, count: int, faults: Sequence[str]) -> Log:
    """Return a random log of so many topics with these faults, as far as its topics can have them."""
    length = int(rng.integers(800, 4000))
    shared = _stamps(rng, length) if rng.random() < 0.15 else None
    topics = [_topic(rng, f"topic{k}", length, shared if k < 2 else None) for k in range(count)]
    planted = []
    for fault in faults:
        in_all = _IN_ALL.get(fault)
        found = _in_one(rng, topics, fault, length) if in_all is None else in_all(rng, topics, length)
        if found is not None:
            topics = found
            planted.append(fault)
    return Log(tuple(topics), tuple(planted))


def _stamps(rng: np.random.Generator, length: int) -> list[int]:
    """Return times of sending [ms]: with a period, in bursts, or on change."""
    kind = rng.choice(["periodic", "periodic", "periodic", "jitter", "bursts", "change", "few"])
    if kind in ("periodic", "jitter"):
        period = int(rng.choice([p for p in (5, 8, 10, 16, 20, 25, 40, 50, 80) if length / p < MOST]))
        phase = int(rng.integers(0, period))
        times = np.arange(phase, length, period)
        if kind == "jitter":
            most = max(1, int(period * rng.choice([0.1, 0.3, 0.45])))
            times = times + rng.integers(-most, most + 1, times.size)
        if rng.random() < 0.3 and times.size > 30:  # single losses of a network
            times = np.delete(times, rng.integers(1, times.size - 1, 3))
    elif kind == "bursts":
        begins = np.cumsum(rng.integers(120, 400, MOST // 6))
        times = np.concatenate([b + np.arange(rng.integers(2, 6)) * 3 for b in begins[begins < length - 20]])
        times = np.append(int(rng.integers(0, 60)), times)
    else:
        times = rng.integers(0, length, int(rng.integers(1, 4) if kind == "few" else rng.integers(5, 40)))
        times = np.append(int(rng.integers(0, 60)), times)
    return np.unique(times[(times >= 0) & (times < length)]).tolist()


def _topic(rng: np.random.Generator, name: str, length: int, times: list[int] | None) -> Sent:
    times = _stamps(rng, length) if times is None else times
    kinds = {
        f"f{k}": str(rng.choice(["real", "real", "real", "int", "bool"]))
        for k in range(1 if rng.random() < 0.8 else 2)
    }
    values = {field: _values(rng, kind, len(times)) for field, kind in kinds.items()}
    return Sent(name, kinds, tuple(times), tuple(times), tuple(times), values)


def _values(rng: np.random.Generator, kind: str, count: int) -> tuple[float, ...]:
    if kind == "bool":
        toggles = rng.random(count) < rng.choice([0.05, 0.3])
        return tuple(((np.cumsum(toggles) + rng.integers(2)) % 2).astype(float).tolist())
    if kind == "int":
        return tuple(np.cumsum(rng.integers(-1, 2, count) * (rng.random(count) < 0.4)).astype(float).tolist())
    steps = 2 * np.cumsum(rng.integers(-2, 3, count) * (rng.random(count) < 0.7)) + 1
    if rng.random() < 0.4 and count:
        steps[rng.integers(count)] += 2 * int(rng.choice([-20, 20]))  # a spike of one message
    return tuple((steps / 8).tolist())


def _in_one(rng: np.random.Generator, topics: list[Sent], fault: str, length: int) -> list[Sent] | None:
    """Return the topics, one of them with a fault; None if none can have it."""
    for place in rng.permutation(len(topics)):
        found = _FAULTS[fault](rng, topics[place], length)
        if found is not None:
            return [*topics[:place], found, *topics[place + 1 :]]
    return None


def _gap(rng: np.random.Generator, sent: Sent, length: int) -> Sent | None:
    if len(sent.times) < 25:
        return None
    first = int(rng.integers(2, len(sent.times) - 15))
    lost = int(rng.integers(7, min(60, len(sent.times) - first - 2)))
    return sent.picked([*range(first), *range(first + lost, len(sent.times))])


def _late_start(rng: np.random.Generator, sent: Sent, length: int) -> Sent | None:
    kept = [k for k, at in enumerate(sent.times) if at >= length * rng.uniform(0.2, 0.6)]
    return sent.picked(kept) if kept else None


def _early_end(rng: np.random.Generator, sent: Sent, length: int) -> Sent | None:
    kept = [k for k, at in enumerate(sent.times) if at <= length * rng.uniform(0.3, 0.9)]
    return sent.picked(kept) if kept else None


def _reset(rng: np.random.Generator, topics: list[Sent], length: int) -> list[Sent] | None:
    """Return topics whose clocks all begin anew at one instant."""
    at = int(rng.uniform(0.3, 0.8) * length)
    busiest = max(topics, key=lambda sent: len(sent.times))
    if sum(time < at for time in busiest.times) < 12 or sum(time >= at for time in busiest.times) < 2:
        return None

    def shown(time: int) -> int:
        return time if time < at else time - at

    def reset(sent: Sent) -> Sent:
        moved = tuple(map(shown, sent.times))
        return replace(sent, stamps=moved, received=sent.received)

    return [reset(sent) for sent in topics]


def _both_repeated(rng: np.random.Generator, topics: list[Sent], length: int) -> list[Sent] | None:
    """Return topics of which two have two values with one stamp, at nearly the same time."""
    able = [k for k, sent in enumerate(topics) if len(sent.times) >= 100 and sent.kinds["f0"] == "real"]
    if len(able) < 2:
        return None
    at = rng.uniform(0.2, 0.8) * length
    for k in able[:2]:
        sent = topics[k]
        place = min(np.searchsorted(sent.times, at), len(sent.times) - 1)
        topics = [*topics[:k], _twice(rng, sent, int(place)), *topics[k + 1 :]]
    return topics


def _stall(rng: np.random.Generator, sent: Sent, length: int) -> Sent | None:
    field = next(iter(sent.kinds))
    if sent.kinds[field] != "real" or len(sent.times) < 20:
        return None
    first = int(rng.integers(1, len(sent.times) - 10))
    count = max(6, len(sent.times) // 20)
    stamps = list(sent.stamps)
    stamps[first : first + count] = [stamps[first]] * len(stamps[first : first + count])
    values = list(sent.values[field])
    values[first : first + count] = [k + 0.125 for k in range(len(values[first : first + count]))]
    return replace(sent, stamps=tuple(stamps), values={**sent.values, field: tuple(values)})


def _merged(rng: np.random.Generator, sent: Sent, length: int) -> Sent | None:
    order = sorted([*range(len(sent.times)), *rng.integers(0, len(sent.times), int(rng.integers(1, 6)))])
    return sent.picked(order)


def _repeated(rng: np.random.Generator, sent: Sent, length: int) -> Sent | None:
    field = next(iter(sent.kinds))
    if sent.kinds[field] == "bool" or len(sent.times) < 100:
        return None
    return _twice(rng, sent, int(rng.integers(0, len(sent.times))))


def _twice(rng: np.random.Generator, sent: Sent, at: int) -> Sent:
    """Return a topic of which one message comes twice, with two values."""
    field = next(iter(sent.kinds))
    twice = sent.picked([*range(at + 1), *range(at, len(sent.times))])
    values = list(twice.values[field])
    values[at + int(rng.integers(2))] += float(rng.choice([-3, -1, 1, 3]))
    return replace(twice, values={**twice.values, field: tuple(values)})


def _late(rng: np.random.Generator, sent: Sent, length: int) -> Sent | None:
    """Return a topic of which one message is stamped when it was sent, and stands in the file up to four later."""
    steps = np.diff(sent.times)
    if len(sent.times) < 25 or steps.max() > 1.4 * steps.min():
        return None
    order = list(range(len(sent.times)))
    at = int(rng.integers(5, len(order) - 6))
    order.insert(at + int(rng.integers(1, 5)), order.pop(at))
    late = sent.picked(order)
    return replace(late, received=tuple(np.maximum.accumulate(late.received).tolist()))


def _jump(rng: np.random.Generator, sent: Sent, length: int) -> Sent | None:
    if len(sent.times) < 10:
        return None
    first = int(rng.integers(3, len(sent.times) - 3))
    stamps = tuple(at if k < first else at + 5000 for k, at in enumerate(sent.times))
    return replace(sent, stamps=stamps)


def _unset(rng: np.random.Generator, sent: Sent, length: int) -> Sent | None:
    if len(sent.times) < 10:
        return None
    chosen = set(rng.integers(0, len(sent.times), int(rng.integers(1, 4))).tolist())
    return replace(sent, stamps=tuple(None if k in chosen else at for k, at in enumerate(sent.stamps)))


def _missing(rng: np.random.Generator, sent: Sent, length: int) -> Sent | None:
    field = next(iter(sent.kinds))
    if sent.kinds[field] != "real" or len(sent.times) < 5:
        return None
    values = list(sent.values[field])
    for k in rng.integers(0, len(values), int(rng.integers(1, 4))):
        values[k] = np.nan
    return replace(sent, values={**sent.values, field: tuple(values)})


_FAULTS: dict[str, Callable[[np.random.Generator, Sent, int], Sent | None]] = {
    "gap": _gap, "late start": _late_start, "early end": _early_end, "stall": _stall, "merged": _merged,
    "repeated": _repeated, "late": _late, "jump": _jump, "unset": _unset, "missing": _missing,
}  # fmt: skip
_IN_ALL: dict[str, Callable[[np.random.Generator, list[Sent], int], list[Sent] | None]] = {
    "reset": _reset, "both repeated": _both_repeated,
}  # fmt: skip
