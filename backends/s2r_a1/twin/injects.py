"""Faults for a twin: their notation, and the rounds in which they act.

    KIND[=VALUE][@ROUND[-[ROUND]]]      nan=gyro@100-101    loss=0.01    heat=3:65@500-    silence@200-210

A round is 2 ms; the first command arrives in round 0. ``@100`` is only this round, ``@100-`` this round and all later
ones; without ``@`` the fault acts in every round. A value for motors may begin with the number of a motor (0…11 in the
order of the wire), or with ``hip``, ``thigh``, ``calf`` or ``all``: ``joint=calf:-2.6``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import inf, isfinite
from typing import NamedTuple

from s2r_a1.remote import BUTTONS
from s2r_a1.wire import MOTORS
from s2r_spec.errors import UsageError, did_you_mean, one_of

NUMBERS = ("quaternion", "gyro", "accelerometer", "q", "dq")
"""A definition: the parts of a state for the inject ``nan``."""

GROUPS: dict[str, tuple[int, ...]] = {
    "all": tuple(range(MOTORS)),
    **{name: tuple(range(place, MOTORS, 3)) for place, name in enumerate(("hip", "thigh", "calf"))},
}
"""A definition: names for groups of motors."""
REMOTE_OFF = "off"
"""A definition: value of the inject ``button`` for a remote that is switched off."""


class MotorNumbers(NamedTuple):
    """A number for some motors."""

    motors: tuple[int, ...]
    number: float


Value = float | str | MotorNumbers | None


@dataclass(frozen=True)
class Inject:
    """A fault, and the rounds in which it acts, both ends included."""

    kind: str
    value: Value = None
    first: int = 0
    last: float = inf

    def acts(self, round_: int) -> bool:
        """Return whether the fault acts in a round."""
        return self.first <= round_ <= self.last

    @property
    def number(self) -> float:
        """The value, for a kind whose value is a number."""
        assert isinstance(self.value, float)
        return self.value

    @property
    def per_motor(self) -> MotorNumbers:
        """The value, for a kind whose value is a number for some motors."""
        assert isinstance(self.value, MotorNumbers)
        return self.value


Injects = tuple[Inject, ...]


class FaultKind(NamedTuple):
    """One kind of fault: its default value, the parser of its value, and its effect."""

    default: Value
    read: Callable[[str], Value]
    does: str


def acting_faults(injects: Iterable[Inject], round_: int, *kinds: str) -> Iterator[Inject]:
    """Yield the faults of these kinds that act in a round."""
    return (inject for inject in injects if inject.kind in kinds and inject.acts(round_))


def read_inject(text: str) -> Inject:
    """Read a fault; raise UsageError if its kind, value or rounds are not valid."""
    written, at, rounds = text.partition("@")
    name, equals, value = written.partition("=")
    if name not in KINDS:
        raise UsageError(
            f"there is no inject {name!r}{did_you_mean(name, KINDS)}; use one of {one_of(KINDS)}"
        )
    kind = KINDS[name]
    try:
        parsed = kind.read(value) if equals else kind.default
    except ValueError as error:
        raise UsageError(f"the inject {text!r}: {error}; {name} {kind.does}") from None
    first, last = _rounds(text, rounds) if at else (0, inf)
    return Inject(name, parsed, first, last)


def _rounds(text: str, rounds: str) -> tuple[int, float]:
    match = re.fullmatch(r"(\d{1,12})(-(\d{1,12})?)?", rounds, re.ASCII)
    if not match:
        raise UsageError(f"the inject {text!r} has no rounds after @; write @100, @100-200 or @100-")
    first = int(match[1])
    last = first if not match[2] else int(match[3]) if match[3] else inf
    if last < first:
        raise UsageError(f"the inject {text!r} ends before it begins; write the smaller round first")
    return first, last


def _number(low: float, high: float) -> Callable[[str], float]:
    def read(text: str) -> float:
        value = float(text)
        if not isfinite(value) or not low <= value <= high:
            raise ValueError(f"{text} is not within {low:g}…{high:g}")
        return value

    return read


def _motor(low: float, high: float) -> Callable[[str], MotorNumbers]:
    number = _number(low, high)

    def read(text: str) -> MotorNumbers:
        who, colon, value = text.rpartition(":")
        if who in GROUPS:
            return MotorNumbers(GROUPS[who], number(value))
        if colon and not (who.isascii() and who.isdigit() and int(who) < MOTORS):
            raise ValueError(f"{who!r} is not a motor; write 0…{MOTORS - 1}, or one of {one_of(GROUPS)}")
        return MotorNumbers((int(who or 0),), number(value))

    return read


def _word(*words: str) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text not in words:
            raise ValueError(f"{text!r} is not one of {one_of(words)}")
        return text

    return read


def _no_value(text: str) -> None:
    raise ValueError(f"it takes no value; leave out ={text}")


def _buttons(text: str) -> str:
    if unknown := [name for name in text.split("+") if name not in (*BUTTONS, REMOTE_OFF)]:
        raise ValueError(f"{unknown[0]!r} is not one of {one_of((*BUTTONS, REMOTE_OFF))}")
    return text


_probability = _number(0.0, 1.0)

KINDS: dict[str, FaultKind] = {
    "loss": FaultKind(1.0, _probability, "loses states, with a probability per packet"),
    "deaf": FaultKind(1.0, _probability, "loses commands, with a probability per packet"),
    "delay": FaultKind(5.0, _number(0, 1000), "holds states back for a number of rounds"),
    "duplicate": FaultKind(1.0, _probability, "delivers states once more a round later, after that round's own"),
    "reorder": FaultKind(1.0, _probability, "delivers states a round late, after that round's own"),
    "corrupt": FaultKind(1.0, _probability, "flips one bit of a state, with a probability per packet"),
    "short": FaultKind(1.0, _probability, "truncates states, with a probability per packet"),
    "silence": FaultKind(None, _no_value, "sends no state"),
    "stuck_tick": FaultKind(None, _no_value, "stops the tick"),
    "back_tick": FaultKind(
        100.0, _number(-1e6, 1e6), "sets the tick back by a number of ms; negative numbers set it ahead"
    ),
    "tick_unit": FaultKind("us", _word("ms", "us"), "counts the tick in ms or us from then on"),
    "nan": FaultKind("q", _word(*NUMBERS), f"makes one of {one_of(NUMBERS)} NaN"),
    "quaternion": FaultKind(2.0, _number(-1e6, 1e6), "multiplies the quaternion by a number"),
    "gyro": FaultKind(100.0, _number(-1e6, 1e6), "replaces the reported roll rate, in rad/s"),
    "tilt": FaultKind(0.6, _number(-3.2, 3.2), "adds to the reported roll, in rad"),
    "joint": FaultKind(MotorNumbers((0,), 3.0), _motor(-1e6, 1e6), "replaces the reported angle of a motor, in rad"),
    "speed": FaultKind(MotorNumbers((0,), 20.0), _motor(-1e6, 1e6), "replaces the reported speed of a motor, in rad/s"),
    "torque": FaultKind(MotorNumbers((0,), 40.0), _motor(-127, 127), "replaces the reported torque of a motor, in N·m"),
    "heat": FaultKind(
        MotorNumbers((0,), 65.0), _motor(-128, 127), "replaces the reported temperature of a motor, in °C"
    ),
    "mode": FaultKind(MotorNumbers((0,), 0.0), _motor(0, 255), "makes a motor go limp and report this mode"),
    "error": FaultKind(MotorNumbers((0,), 4.0), _motor(0, 2**32 - 1), "replaces the reported error word of a motor"),
    "button": FaultKind("R2", _buttons, "holds down buttons of the remote, as L2+B, or switches it off"),
    "push": FaultKind(100.0, _number(-1000, 1000), "pushes the trunk to the left, in N"),
}  # fmt: skip
"""A definition: all faults. Most change reported values or the network; ``mode`` and ``push`` act on the robot."""
