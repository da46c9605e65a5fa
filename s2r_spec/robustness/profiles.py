"""The conventions of other tools by name, to get the same numbers as they give."""

from __future__ import annotations

from typing import TypedDict

from s2r_spec.base.errors import UsageError, one_of, suggest
from s2r_spec.robustness.evaluate import Witness
from s2r_spec.robustness.evaluation import End, Interpolation


class Profile(TypedDict):
    """Conventions of a tool, as keywords of :meth:`s2r_spec.spec.Spec.evaluate`."""

    interpolation: Interpolation | None
    until: Witness
    end: End


PROFILES: dict[str, Profile] = {
    "breach": {"interpolation": "linear", "until": "closed", "end": "hold"},
    "moonlight": {"interpolation": "hold", "until": "open", "end": "nan"},
    "rtamt": {"interpolation": "samples", "until": "open", "end": "clip"},
    "rtamt-dense": {"interpolation": "hold", "until": "closed", "end": "hold"},
    "s2r": {"interpolation": None, "until": "open", "end": "clip"},
    "stlcgpp": {"interpolation": "samples", "until": "closed", "end": "hold"},
    "stlrom": {"interpolation": "linear", "until": "closed", "end": "hold"},
    "tidystl": {"interpolation": "samples", "until": "closed", "end": "hold"},
}
"""benchmarks/lang/conventions.py compares the profiles of RTAMT, STLRom, stlcgpp and tidystl with the tools."""


def profile(name: str) -> Profile:
    """Return the keywords that evaluate a trace with a tool's conventions.

    ``spec.evaluate(trace, "walking", **profile("breach"))``

    Raises:
        UsageError: no profile has this name.
    """
    if name not in PROFILES:
        raise UsageError(
            f"there is no profile {name!r}{suggest(name, PROFILES)} the profiles are {one_of(PROFILES)}"
        )
    return PROFILES[name].copy()
