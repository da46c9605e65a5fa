"""What a check says of the recordings, and the words that it says it in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from s2r_spec.base.json_values import Shown
from s2r_spec.trace import SHOWN


@dataclass(frozen=True)
class Finding(Shown):
    """A mistake that the recordings seem to have.

    Attributes:
        code: kind of mistake: late, begin, clock, hold, exchanged, sign, scale, frame, offset, labels, unit, …
        channel: the channel with the mistake; 'the tests' or 'the clock' if it is in no channel.
        text: the mistake and its remedy in a few sentences; the notes repeat it.
        imitates: what would do the same as an effect, in a few words ("a wrong clock"); "" where the mistake is no
            rival of any effect.
        same: whether an effect of the catalogue explains the recordings as well.
        certain: whether no machine can explain the recordings; nothing is estimated from these.
    """

    code: str
    channel: str
    text: str
    imitates: str = ""
    same: bool = False
    certain: bool = False

    JSON = "code channel text"


def join_words(names: Sequence[str]) -> str:
    """Return "x, y and heading"."""
    if len(names) > SHOWN:
        return f"{', '.join(names[:SHOWN])} and {len(names) - SHOWN} more"
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def rollout_name(number: int, test: Mapping[str, float]) -> str:
    """Return which real rollout it is, in words."""
    values = ", ".join(f"{name} = {value:.4g}" for name, value in test.items())
    return f"real rollout {number}" + (f" ({values})" if values else "")
