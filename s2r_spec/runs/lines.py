"""The lines of a journal. The reader checks everything, because a file may be damaged, edited or something else."""

from __future__ import annotations

import json
import math
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from s2r_spec.base.errors import UsageError

LONGEST = 1 << 20
"""Budget: bytes of a line, a thousand times the size of a usual one."""
TRACE_SUM = "trace_crc32"
"""Definition: field with the CRC-32 of the line's trace file, as hex digits."""
_CHECKED = re.compile(rb'(?P<body>.*), "crc32": "(?P<sum>[0-9a-f]{8})"\}')
SUM = "crc32"
"""Definition: field with the checksum of a line and all lines before it, as hex digits."""


class JournalError(UsageError):
    """The journal of a run is missing or damaged, or belongs to another run."""


def damage(path: Path, number: int, words: str) -> JournalError:
    """Return the error of a damaged line."""
    return JournalError(f"{path}:{number}: {words}; restore the journal from a copy, or begin a new run")


Key = tuple[int, int]
"""Query and replicate of a rollout."""


@dataclass(frozen=True)
class Rollout:
    """A rollout of a run: the number of its test, in the order of the search, and its own number at this test."""

    query: int
    replicate: int

    @property
    def key(self) -> Key:
        """Query and replicate."""
        return self.query, self.replicate

    @property
    def name(self) -> str:
        """Query and replicate as text: "12.3"."""
        return f"{self.query}.{self.replicate}"


def read(path: Path) -> tuple[list[bytes], bytes]:
    """Return the complete lines of a file, and the text after the last line feed.

    No file, or a line longer than ``LONGEST``, is a JournalError.
    """
    if path.exists() and not path.is_file():
        raise JournalError(f"{path} is not a file, so there is no run to resume at {path.parent}")
    whole: list[bytes] = []
    with path.open("rb") as file:
        while line := file.readline(LONGEST + 1):
            if len(line) > LONGEST:
                raise damage(path, len(whole) + 1, f"the line is longer than {LONGEST} bytes")
            if not line.endswith(b"\n"):
                return whole, line
            whole.append(line[:-1])
    return whole, b""


def parse(path: Path, number: int, line: bytes) -> dict[str, Any]:
    """Return the JSON object of a line; a JournalError says that it is none."""
    try:
        value = json.loads(line, parse_constant=_no_number)
    except RecursionError:
        raise damage(path, number, "damaged line (nested too deeply)") from None
    except ValueError as error:
        raise damage(path, number, f"damaged line ({error})") from None
    if not isinstance(value, dict):
        raise damage(path, number, "the line is not a JSON object")
    return value


def encode(value: Mapping[str, Any], before: int) -> tuple[bytes, int]:
    """Return a line and its checksum, continued from the checksum ``before``."""
    body = json.dumps(value, allow_nan=False).encode()[:-1]
    checksum = zlib.crc32(body, before)
    return body + b', "crc32": "%08x"}' % checksum, checksum


def check(path: Path, lines: Sequence[bytes]) -> int:
    """Return the checksum of all lines; a JournalError names the first line that was changed or removed."""
    checksum = 0
    for number, line in enumerate(lines, 1):
        match = _CHECKED.fullmatch(line)
        if match is not None:
            checksum = zlib.crc32(match["body"], checksum)
        if match is None or int(match["sum"], 16) != checksum:
            words = "the checksum crc32 is wrong: this line was changed, or a line before it was removed"
            raise damage(path, number, words)
    return checksum


Test = Callable[[Any], bool]
"""Returns whether a JSON value is valid for a field."""


def fault(values: Mapping[str, Any], schema: Mapping[str, tuple[Test, str]]) -> str:
    """Return the fault in the first invalid field of an object; "" if all are valid.

    The schema has field → (test, description of valid values); other fields are ignored.
    """
    for name, (is_valid, description) in schema.items():
        if name not in values:
            return f"{name} is missing"
        if not is_valid(values[name]):
            return f"{name} must be {description}, not {excerpt(values[name])}"
    return ""


def read_fields(
    path: Path, number: int, line: Mapping[str, Any], schema: Mapping[str, tuple[Test, str]], what: str
) -> dict[str, Any]:
    """Return the fields of a line without its checksums; a JournalError that begins with ``what`` names a wrong one."""
    values = {name: value for name, value in line.items() if name not in (SUM, TRACE_SUM)}
    wrong = fault(values, schema)
    if not wrong and (unknown := sorted(values.keys() - schema.keys())):
        wrong = f"{unknown[0]!r} is an unknown field"
    if not wrong and not is_text_or_none(line.get(TRACE_SUM)):
        wrong = f"{TRACE_SUM} must be a string"
    if wrong:
        raise damage(path, number, what + wrong)
    return values


def is_number(value: Any) -> bool:
    """Return whether a value is a finite number within the range of a float."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def is_count(value: Any) -> bool:
    """Return whether a value is a whole number from 0 to 2⁶⁴ − 1, the range of seeds."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 64


def is_length(value: Any) -> bool:
    """Return whether a value is a finite number ≥ 0."""
    return is_number(value) and value >= 0


def is_text(value: Any) -> bool:
    """Return whether a value is a string."""
    return isinstance(value, str)


def is_text_or_none(value: Any) -> bool:
    """Return whether a value is a string or null."""
    return value is None or isinstance(value, str)


def is_file(form: str) -> Test:
    """Return a test whether a value is null or a name of this form, a regular expression."""
    return lambda value: value is None or (isinstance(value, str) and bool(re.fullmatch(form, value)))


def is_point(value: Any) -> bool:
    """Return whether a value is an object of finite numbers."""
    return isinstance(value, dict) and all(map(is_number, value.values()))


COUNT = (is_count, "a whole number")
TEST: Mapping[str, tuple[Test, str]] = {
    "params": (is_point, "an object with a number for each parameter"),
    "seed": COUNT,
}
"""Fields of a rollout's test."""
TEXT = (is_text, "a text")
SECONDS = (is_length, "a number that is not negative")
ROLLOUT: Mapping[str, tuple[Test, str]] = {
    "query": COUNT,
    "replicate": COUNT,
    **TEST,
    "rho": (is_number, "a finite number"),
    "failure": (is_text_or_none, "a text or null"),
    "trace": (is_file(r"traces/[0-9]{5,}\.[0-9]{4,}\.npz"), "the name of a file in traces/, or null"),
    "seconds": SECONDS,
}
"""Fields of a rollout's line."""


def _no_number(word: str) -> NoReturn:
    raise ValueError(f"{word} is not a finite number")


def excerpt(value: object) -> str:
    """Return a value as JSON for a message, shortened if it is long."""
    try:
        text = json.dumps(value)
    except ValueError:  # an integer with thousands of digits
        text = "a number of many digits"
    return text if len(text) <= 60 else text[:57] + "..."
