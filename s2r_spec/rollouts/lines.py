"""The lines of a journal: read without trust, because a file may be damaged, edited or of something else."""

from __future__ import annotations

import json
import math
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from s2r_spec.errors import UsageError

LONGEST = 1 << 20
"""Bytes of a line at most: a budget of memory, some thousand times what a rollout takes. No longer one is written."""
TRACE_SUM = "trace_crc32"
"""Definition: the field with the CRC-32 of the file of a line's trace, as hex digits."""
_CHECKED = re.compile(rb'(?P<body>.*), "crc32": "(?P<sum>[0-9a-f]{8})"\}')
_DAMAGED = "restore it from a copy, or begin a new run"


class JournalError(UsageError):
    """The journal of a run cannot be used: it is missing, damaged, or of another run."""


def read(path: Path) -> tuple[list[bytes], bytes]:
    """Return the whole lines of a file, and what follows the last line feed.

    Raises:
        OSError: it cannot be read.
        JournalError: it is no file, or a line is longer than any of a journal.
    """
    if path.exists() and not path.is_file():
        raise JournalError(f"{path} is not a file, so there is no run to resume at {path.parent}")
    whole: list[bytes] = []
    with path.open("rb") as file:
        while line := file.readline(LONGEST + 1):
            if len(line) > LONGEST:
                raise JournalError(
                    f"{path}:{len(whole) + 1}: the line is longer than {LONGEST} bytes; {_DAMAGED}"
                )
            if not line.endswith(b"\n"):
                return whole, line
            whole.append(line[:-1])
    return whole, b""


def parse(path: Path, number: int, line: bytes) -> dict[str, Any]:
    """Return the JSON object of a line.

    Raises:
        JournalError: it is none.
    """
    try:
        value = json.loads(line, parse_constant=_no_number)
    except RecursionError:
        raise JournalError(f"{path}:{number}: damaged line (nested too deeply); {_DAMAGED}") from None
    except ValueError as error:
        raise JournalError(f"{path}:{number}: damaged line ({error}); {_DAMAGED}") from None
    if not isinstance(value, dict):
        raise JournalError(f"{path}:{number}: not an object; {_DAMAGED}")
    return value


def written(value: Mapping[str, Any], before: int | None) -> tuple[bytes, int | None]:
    """Return a line and its checksum, from that of the line before; without one if that is None."""
    body = json.dumps(value, allow_nan=False).encode()[:-1]
    if before is None:
        return body + b"}", None
    checksum = zlib.crc32(body, before)
    return body + b', "crc32": "%08x"}' % checksum, checksum


def check(path: Path, lines: Sequence[bytes]) -> int:
    """Return the checksum of all lines.

    Raises:
        JournalError: a line is not as it was written.
    """
    checksum = 0
    for number, line in enumerate(lines, 1):
        match = _CHECKED.fullmatch(line)
        if match is not None:
            checksum = zlib.crc32(match["body"], checksum)
        if match is None or int(match["sum"], 16) != checksum:
            raise JournalError(
                f"{path}:{number}: the checksum does not fit: this line was changed after it was written, or one "
                f"before it was taken out; {_DAMAGED}"
            )
    return checksum


Test = Callable[[Any], bool]
"""Whether a value of JSON is what a field holds."""


def fault(values: Mapping[str, Any], wanted: Mapping[str, tuple[Test, str]]) -> str:
    """Return what is wrong with an object in the first field that is, "" if nothing is.

    Args:
        values: of the object; fields that are not wanted are left alone.
        wanted: field → (test, what it must be in words).
    """
    for name, (fits, words) in wanted.items():
        if name not in values:
            return f"{name} is missing"
        if not fits(values[name]):
            return f"{name} must be {words}, not {shown(values[name])}"
    return ""


def is_number(value: Any) -> bool:
    """Whether it is a finite number that a float holds."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def is_count(value: Any) -> bool:
    """Whether it is a whole number from 0 to 2⁶⁴ − 1, as seeds are."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 64


def is_length(value: Any) -> bool:
    """Whether it is a finite number that is not negative."""
    return is_number(value) and value >= 0


def is_text(value: Any) -> bool:
    """Whether it is a text."""
    return isinstance(value, str)


def is_text_or_none(value: Any) -> bool:
    """Whether it is a text or null."""
    return value is None or isinstance(value, str)


def is_trace_name(value: Any) -> bool:
    """Whether it is null or a file in the run's folder of traces, and so none elsewhere."""
    return value is None or (
        isinstance(value, str) and bool(re.fullmatch(r"traces/[0-9]{5,}\.[0-9]{4,}\.npz", value))
    )


def is_point(value: Any) -> bool:
    """Whether it gives a finite number for each of its names."""
    return isinstance(value, dict) and all(map(is_number, value.values()))


ROLLOUT: Mapping[str, tuple[Test, str]] = {
    "query": (is_count, "a whole number"),
    "replicate": (is_count, "a whole number"),
    "params": (is_point, "an object with a number for each parameter"),
    "seed": (is_count, "a whole number"),
    "rho": (is_number, "a finite number"),
    "failure": (is_text_or_none, "a text or null"),
    "trace": (is_trace_name, "the name of a file in traces/, or null"),
    "seconds": (is_length, "a number that is not negative"),
}
"""What a rollout's line holds."""


def _no_number(word: str) -> NoReturn:
    raise ValueError(f"{word} is no number")


def shown(value: object) -> str:
    """Return a value as a sentence quotes it: JSON, cut if it is long."""
    try:
        text = json.dumps(value)
    except ValueError:  # an integer of thousands of digits
        text = "a number of many digits"
    return text if len(text) <= 60 else text[:57] + "..."
