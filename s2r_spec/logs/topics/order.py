"""The order of messages: which stamps are sorted, merged or refused.

Data: stamps s_1, s_2, … in the order of the file, with the values that are read. Rules, the same for every format:

    late       a message after one with a later stamp. Senders of headers may be late by at most five periods, and a
               late message must fill a gap that it left: then it is sorted. Tables are never sorted.
    reset      any other step back: the clock began anew, and the file is refused.
    merged     a message with the stamp and all values of another one.
    repeated   a message with the stamp of another one and other values. Up to 1 % of the messages may be so, and each
               value counts. With more, the stamps are no times, and the file is refused.
    still      over five messages of a periodic topic with one stamp, and then a gap: the clock stood still.
    jump       a header whose stamp is ahead of those before by over a second, against its receipt: the clock was set.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray, IntArray
from s2r_spec.base.errors import TraceError
from s2r_spec.base.printable import count_messages
from s2r_spec.logs.topics.topic import Topic, seconds, stamp_text
from s2r_spec.trace.messages import SILENT, period_of_messages

MOST_REPEATED = 0.01
"""Tolerance: share of a topic's messages with the stamp of another one and other values."""


@dataclass(frozen=True)
class Ordered:
    """A topic whose stamps do not decrease.

    Args:
        topic: the topic.
        merged: messages with the stamp and the values of another one, which are left out.
        resorted: messages that were sorted.
        notes: a sentence on each of these.
    """

    topic: Topic
    merged: int
    resorted: int
    notes: tuple[str, ...]

    @property
    def messages(self) -> int:
        """Number of the topic's messages in the file."""
        return len(self.topic) + self.merged + sum(self.topic.dropped.values())


def sort_messages(topic: Topic, sortable: bool, place: Callable[[int], str] | None = None) -> Ordered:
    """Return a topic in order of its stamps, which are its sender's, and may come late, if it is sortable.

    ``place`` is number of a message → its place in the file; None to number the messages.

    Raises:
        TraceError: the clock began anew, was set, or stood still.
    """
    name = topic.name or "the file"
    remedy = "save each part in a file of its own" if topic.age is None else "use --stamps received"
    where = place or (lambda number: f"message {number + 1}")
    stamps = topic.stamps
    if len(topic) < 2:
        return Ordered(topic, 0, 0, ())
    counts = seconds(stamps - stamps[0])
    if topic.jump is not None:
        first, ahead = topic.jump
        raise TraceError(
            f"the header stamps of {name} jump {ahead:.6g} s ahead of their receipt at message {first + 1}, "
            f"{stamp_text(stamps[first])}: its clock was set; use --stamps received"
        )
    back = np.flatnonzero(np.diff(counts) < 0) + 1
    late = np.zeros(0, dtype=np.intp)
    if back.size:
        late = _late_messages(counts)
        if not sortable or not _fills_gaps(counts, late):
            first = int(back[0])
            raise TraceError(
                f"{where(first)}: the times of {name} step back by {counts[first - 1] - counts[first]:.6g} s, from "
                f"{stamp_text(stamps[first - 1])} to {stamp_text(stamps[first])}, so its clock began anew; "
                f"{remedy}"
            )
        order = np.argsort(stamps, kind="stable")
        topic, counts = topic.only(order), counts[order]
    if sortable and (still := _stands_still(counts, topic)) is not None:
        raise TraceError(
            f"{where(still)}: the stamps of {name} stand still at {stamp_text(topic.stamps[still])}, though messages "
            f"go on; {remedy}"
        )
    same = np.flatnonzero(np.diff(counts) == 0) + 1
    notes = [f"{count_messages(late.size, name, 'come')} late, sorted by stamps"] * bool(late.size)
    if not same.size:
        return Ordered(topic, 0, int(late.size), tuple(notes))
    equal = _equal_to_previous(topic, same)
    merged, repeated = same[equal], same[~equal]
    if repeated.size > MOST_REPEATED * len(topic):
        raise TraceError(
            f"{where(int(repeated[0]))}: {repeated.size} of {len(topic)} messages of {name} have the time of the one "
            f"before and another value, first at {stamp_text(topic.stamps[repeated[0]])}: times must increase; "
            f"{remedy}"
        )
    kept = np.ones(len(topic), dtype=bool)
    kept[merged] = False
    if merged.size:
        notes.append(
            f"{count_messages(merged.size, name, 'repeat')} stamp and values of the one before, merged"
        )
    if repeated.size:
        notes.append(
            f"{count_messages(repeated.size, name, 'have')} the stamp of the one before and another value, first "
            f"{stamp_text(topic.stamps[repeated[0]])}; both count"
        )
    return Ordered(topic.only(kept) if merged.size else topic, int(merged.size), int(late.size), tuple(notes))


def _late_messages(counts: FloatArray) -> IntArray:
    return np.flatnonzero(counts < np.maximum.accumulate(counts))


def _stands_still(counts: FloatArray, topic: Topic) -> int | None:
    """Return the first of more than five messages with one stamp, after which the stamps jump; None if there is none.

    A stamp of a periodic topic whose messages are only repeated has no gap after it.
    """
    begins = np.concatenate(([0], np.flatnonzero(np.diff(counts) > 0) + 1))
    own = counts[begins]
    end = own[-1] if topic.log_end is None else seconds(np.array([topic.log_end - topic.stamps[0]]))[0]
    gaps = np.diff(own, append=max(end, own[-1]))
    lengths = np.diff(begins, append=counts.size)
    still = np.flatnonzero((lengths > SILENT) & (gaps > SILENT * period_of_messages(own)))
    return int(begins[still[0]]) if still.size else None


def _fills_gaps(counts: FloatArray, late: IntArray) -> bool:
    """Return whether late messages each fill a gap, at most five periods back, that the others left."""
    latest = np.maximum.accumulate(counts)
    rest = np.delete(counts, late)
    period = period_of_messages(np.unique(counts))
    if not np.isfinite(period) or (latest[late] - counts[late]).max() > SILENT * period:
        return False
    if np.unique(counts).size < counts.size:
        return False
    place = np.searchsorted(rest, counts[late])
    gaps, number = np.unique(place[place > 0], return_counts=True)  # nothing is known before the first one
    room = np.round((rest[gaps] - rest[gaps - 1]) / period) - 1
    return bool((number <= room).all())


def _equal_to_previous(topic: Topic, at: IntArray) -> NDArray[np.bool_]:
    """Return whether all values of messages are those of the message before, bit for bit."""
    equal = np.ones(at.size, dtype=bool)
    for column in topic.columns.values():
        if column.fault:
            continue
        now, before = column.values[at], column.values[at - 1]
        same = now == before
        if now.dtype.kind == "f":
            same |= np.isnan(now) & np.isnan(before)
        same = same.reshape(at.size, -1).all(axis=1)
        if column.missing is not None:
            lacks, lacked = column.missing[at], column.missing[at - 1]
            same = np.where(lacks | lacked, lacks == lacked, same)
        equal &= np.asarray(same, dtype=bool)
    return equal


def resets(stamps: NDArray[Any]) -> list[int]:
    """Return the messages at which a clock began anew: steps back that no late message makes."""
    counts = seconds(stamps - stamps[0]) if len(stamps) else np.zeros(0)
    late = _late_messages(counts)
    if not late.size or _fills_gaps(counts, late):
        return []
    return (np.flatnonzero(np.diff(counts) < 0) + 1).tolist()
