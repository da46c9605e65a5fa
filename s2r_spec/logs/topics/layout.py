"""Where the numbers of a raw ROS message stand, if they stand at the same place in all messages of a topic.

Texts and sequences have a length before them. Messages whose lengths are equal have one layout, so that numpy reads a
field of many messages at once. CDR (ROS 2) aligns a number to its size; ROS 1 does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

BASE, NAME, ARRAY, SEQUENCE = 1, 2, 3, 4
"""Definition: rosbags' numbers of the kinds of a field: a base type, a message, and vectors of either."""
_TYPES = {"byte": "u1", "char": "u1", "bool": "?"}
"""Definition: numpy's names of the base types of ROS that it knows by another name."""
_ENCAPSULATION = 4
"""Definition: bytes before the first field in CDR."""


@dataclass(frozen=True)
class Layout:
    """The places of a message's fields.

    Args:
        size: length of the message [bytes].
        fields: field → (offset [bytes], type, number of components, or None for a number).
        constant: (n,) offsets of the bytes that are equal in all messages of this layout.
        sample: a message of this layout.
    """

    size: int
    fields: dict[str, tuple[int, np.dtype[Any], int | None]]
    constant: NDArray[np.int64]
    sample: NDArray[np.uint8]

    def columns(self, messages: Sequence[bytes], fields: Sequence[str]) -> list[NDArray[Any]] | None:
        """Return (n,) or (n, k) values of fields in n messages; None if a message has another layout.

        Floats have 64 bits, and integers if possible ``int64``, as numbers of Python would; vectors keep their type.
        """
        if any(len(message) != self.size for message in messages):
            return None
        rows = np.frombuffer(b"".join(messages), dtype=np.uint8).reshape(len(messages), self.size)
        if (rows[:, self.constant] != self.sample[self.constant]).any():
            return None
        return [self._column(rows, *self.fields[field]) for field in fields]

    def _column(
        self, rows: NDArray[np.uint8], offset: int, dtype: np.dtype[Any], count: int | None
    ) -> NDArray[Any]:
        size = dtype.itemsize * (1 if count is None else count)
        raw = np.ascontiguousarray(rows[:, offset : offset + size])
        values = raw.view(dtype) if size else np.zeros((len(rows), 0), dtype)
        values = values.astype(dtype.newbyteorder("="), copy=False)
        if count is not None:
            return values
        values = values[:, 0]
        if dtype.kind == "f":
            return values.astype(np.float64)
        if dtype.kind in "iu" and not (dtype.itemsize == 8 and dtype.kind == "u" and (values >> 63).any()):
            return values.astype(np.int64)
        return values


class _Walk:
    """Walks over a message along its definition."""

    def __init__(self, store: Any, message: bytes, cdr: bool) -> None:
        self._store, self._message, self._cdr = store, message, cdr
        self._order: Literal["<", ">"] = "<" if not cdr or message[1] else ">"
        self._start = _ENCAPSULATION if cdr else 0
        self.place = self._start
        self.fields: dict[str, tuple[int, np.dtype[Any], int | None]] = {}
        self.constant = [*range(self._start)]

    def message(self, kind: str, prefix: str = "") -> None:
        for name, (shape, content) in self._store.fielddefs[kind][1]:
            path = f"{prefix}{name}"
            if shape == NAME:
                self.message(content, f"{path}.")
            elif shape == BASE and content[0] == "string":
                length = self._length()
                self.place += length
            elif shape == BASE:
                self._numbers(path, content[0], None)
            elif content[0][0] != BASE or content[0][1][0] == "string":
                raise LookupError(path)
            else:
                self._numbers(path, content[0][1][0], content[1] if shape == ARRAY else self._length())

    def _align(self, size: int) -> None:
        if self._cdr:
            self.place += -(self.place - self._start) % size

    def _length(self) -> int:
        self._align(4)
        self.constant += range(self.place, self.place + 4)
        self.place += 4
        return int(np.frombuffer(self._message, f"{self._order}u4", 1, self.place - 4)[0])

    def _numbers(self, path: str, name: str, count: int | None) -> None:
        try:
            dtype = np.dtype(_TYPES.get(name, name)).newbyteorder(self._order)
        except TypeError:
            raise LookupError(path) from None
        if count != 0:
            self._align(dtype.itemsize)
        self.fields[path] = self.place, dtype, count
        self.place += dtype.itemsize * (1 if count is None else count)


def layout(store: Any, kind: str, message: bytes, cdr: bool) -> Layout | None:
    """Return the layout of a raw message; None if it has none that this module knows.

    Args:
        store: rosbags' definitions of messages.
        kind: type of the message.
        message: its bytes.
        cdr: whether it is in CDR, as in ROS 2.
    """
    try:
        walk = _Walk(store, message, cdr)
        walk.message(kind)
    except (LookupError, ValueError):
        return None
    if not 0 <= len(message) - walk.place <= (3 if cdr else 0):  # CDR may fill up the last 4 bytes
        return None
    sample = np.frombuffer(message, dtype=np.uint8)
    return Layout(len(message), walk.fields, np.array(walk.constant, dtype=np.int64), sample)
