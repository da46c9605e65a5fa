"""One mapping of a file, with checks whose messages name file and key."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from sys import float_info
from typing import Any, NoReturn

from s2r_mujoco.deploy.yaml import Tagged
from s2r_spec.errors import UsageError, one_of, shortened, suggest


@dataclass(frozen=True)
class Section:
    """The values of one mapping; remembers which keys were used, so that the others can be listed."""

    values: Mapping[str, Any]
    source: str  # file name
    path: str = ""  # keys that lead here: "observations.base_ang_vel"
    used: set[str] = field(default_factory=set)  # keys of the whole file, with the keys that lead there

    def name(self, key: str) -> str:
        """Return a key with those that lead there: ``observations.base_ang_vel.scale``."""
        return f"{self.path}.{key}" if self.path else key

    def place(self, key: str) -> str:
        """Return file and key, as a message begins."""
        return f"{self.source}: {self.name(key)}"

    def fail(self, key: str, problem: str) -> NoReturn:
        """Raise the sentence "file: key problem"."""
        raise UsageError(f"{self.place(key)} {problem}")

    def has(self, key: str) -> bool:
        """Return whether the file gives a value; null is none."""
        return self.get(key) is not None

    def get(self, key: str) -> Any:
        """Return a value as it is; None where it is missing or null."""
        if key in self.values:
            self.used.add(self.name(key))
        return self.values.get(key)

    def needed(self, key: str, form: str) -> Any:
        """Return a value that must be there; ``form`` says which, for the message.

        Raises:
            UsageError: the key is missing or null, with the keys that are there.
        """
        value = self.get(key)
        if value is None:
            where = f"{self.source}: {self.path}" if self.path else self.source
            hint = suggest(key, self.values)
            raise UsageError(f"{where} has no {key!r} ({form}){hint} its keys are {one_of(self.values)}")
        return value

    def section(self, key: str) -> Section:
        """Return a mapping; an empty one where it is missing, null or ``{}``."""
        value = self.get(key)
        if value is not None and not isinstance(value, Mapping):
            self.fail(key, f"must be a mapping, not {shown(value)}")
        return Section(value or {}, self.source, self.name(key), self.used)

    def number(self, key: str, positive: bool = False) -> float:
        """Return a number that must be there."""
        value = self.needed(key, "a number")
        if not is_number(value):
            self.fail(key, f"must be a number, not {shown(value)}")
        if positive and value <= 0:
            self.fail(key, f"must be above 0, not {shown(value)}")
        return float(value)

    def whole(self, key: str, low: int, high: int) -> int:
        """Return a whole number within limits that must be there."""
        value = self.number(key)
        if value != int(value) or not low <= value <= high:
            self.fail(key, f"must be a whole number from {low} to {high}, not {value:g}")
        return int(value)

    def numbers(self, key: str, count: int | None = None, per: str = "") -> tuple[float, ...]:
        """Return a list of numbers that must be there, of a length that ``per`` explains, if any is given."""
        value = self.needed(key, "a list of numbers")
        if not isinstance(value, list) or not all(is_number(one) for one in value):
            self.fail(key, f"must be a list of numbers, not {shown(value)}")
        if count is not None and len(value) != count:
            self.fail(key, f"has {len(value)} numbers instead of {count}, {per or 'its length'}")
        return tuple(float(one) for one in value)

    def gains(self, key: str, count: int | None = None, per: str = "") -> tuple[float, ...]:
        """Return a list of numbers that must be there, none of them below 0."""
        gains = self.numbers(key, count, per)
        if any(gain < 0 for gain in gains):
            self.fail(key, f"has a number below 0: {min(gains):g}")
        return gains

    def spread(self, key: str, count: int, per: str) -> tuple[float, ...]:
        """Return ``count`` numbers from a list, or from one number for all."""
        value = self.needed(key, "a number or a list of numbers")
        return (float(value),) * count if is_number(value) else self.numbers(key, count, per)

    def indices(self, key: str, below: int | None = None) -> tuple[int, ...]:
        """Return a list of different indices that must be there, from 0 and below a limit, if any is given."""
        numbers = self.numbers(key)
        if any(one != int(one) or one < 0 for one in numbers):
            self.fail(key, f"must be a list of whole numbers from 0, not {shown(self.get(key))}")
        if len(set(numbers)) < len(numbers):
            self.fail(key, f"has an index twice: {shown([int(one) for one in numbers])}")
        if below is not None and any(one >= below for one in numbers):
            self.fail(key, f"has the index {int(max(numbers))}; the last one is {below - 1}")
        return tuple(int(one) for one in numbers)

    def interval(self, key: str) -> tuple[float, float]:
        """Return two numbers, the smaller first, that must be there."""
        low, high = self.numbers(key, 2, "the lower and the upper limit")
        if low > high:
            self.fail(key, f"has its lower limit {low:g} above its upper limit {high:g}")
        return low, high

    def text(self, key: str) -> str:
        """Return a text; an empty one where it is missing."""
        value = self.get(key)
        if value is not None and not isinstance(value, str):
            self.fail(key, f"must be a text, not {shown(value)}")
        return value or ""

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of different texts that must be there."""
        value = self.needed(key, "a list of names")
        if not isinstance(value, list) or not all(isinstance(one, str) and one for one in value):
            self.fail(key, f"must be a list of names, not {shown(value)}")
        seen: set[str] = set()
        for one in value:
            if one in seen:
                self.fail(key, f"has the name {shortened(one)!r} twice")
            seen.add(one)
        return tuple(value)

    def unused(self) -> tuple[str, ...]:
        """Return the keys that nothing read; a mapping of which something was read is looked into."""
        found: list[str] = []
        for key, value in self.values.items():
            name = self.name(key)
            if name not in self.used and value is not None:
                found.append(shortened(name))
            elif isinstance(value, Mapping):
                found.extend(Section(value, self.source, name, self.used).unused())
        return tuple(found)


def is_number(value: object) -> bool:
    """Return whether a value of a file is a finite number; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < float_info.max


def shown(value: object) -> str:
    """Return a value for a message, shortened."""
    if isinstance(value, Tagged):
        return f"a value with the tag {value.tag!r}"
    if isinstance(value, Mapping):
        return f"a mapping with the keys {one_of(map(str, value))}"
    return shortened(str(value) if isinstance(value, list) else repr(value))
