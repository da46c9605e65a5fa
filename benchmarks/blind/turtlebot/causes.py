"""What can be wrong with the turtlebot: the members of the catalogue, and what the catalogue does not have.

Sizes of members are in typical sizes of the catalogue; those of other causes are in the units of their number. They run
from just material to large, which ``python -m benchmarks.blind.turtlebot_compare`` shows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import inf

from benchmarks.blind.outsiders.cases import Cause, linear
from benchmarks.blind.turtlebot.plant import JAM, PATCH, SHOVE

BACKGROUND = 0.05
"""Prior: standard deviation of every effect that a case is not about, in typical sizes."""

Where = Callable[[Mapping[str, float]], dict[str, list[float]]]


def _member(
    name: str, parameter: str, typical: float, nominal: float = 0.0, signed: bool = False, low: float = 0.25
) -> Cause:
    cause = linear(name, parameter, typical, nominal, signed)
    return replace(cause, sizes=(low, 1.25), background=BACKGROUND)


KNOWN = (
    _member("position_bias", "left", 0.08, signed=True),
    _member("heading_bias", "angle", 0.2, signed=True),
    _member("latency", "delay", 0.12),
    # Wheels reach 0.6 to 0.7 m/s in a test: a higher limit does not show.
    _member("speed_limit", "speed", -0.6, nominal=1.0, low=0.7),
    _member("motor_lag", "time", 0.2),
    _member("wheel_radius", "factor", 0.2, nominal=1.0, signed=True),
    _member("uneven_wheels", "share", 0.04, signed=True),
    _member("axle_length", "factor", 0.3, nominal=1.0, signed=True),
    _member("turning_slip", "coefficient", 1.6),
)
"""The catalogue's members, in other laws."""


def _other(
    name: str, parameter: str, low: float, high: float, signed: bool = False, of: str | None = None
) -> Cause:
    return Cause(name, parameter, lambda size: size, signed=signed, sizes=(low, high), relative_of=of)


NEAR = (
    _other("square_slip", "coefficient", 0.3, 1.2, of="turning_slip"),
    Cause("acceleration_limit", "limit", lambda size: 1.0 / size, inf, sizes=(0.7, 2.2), relative_of="motor_lag"),
    _other("turning_delay", "delay", 0.05, 0.15, of="latency"),
    _other("growing_delay", "delay", 0.08, 0.25, of="latency"),
    Cause("weak_wheel", "speed", lambda size: 1.0 - size, 1.0, sizes=(0.45, 0.65), relative_of="speed_limit"),
    _other("braking_lag", "time", 0.1, 0.4, of="motor_lag"),
    _other("heading_drift", "rate", 0.02, 0.1, signed=True, of="heading_bias"),
    _other("lever", "ahead", 0.03, 0.12, of="position_bias"),
    _other("weakening", "share", 0.1, 0.4, of="wheel_radius"),
)  # fmt: skip
"""A member of the catalogue with another law."""


def _local(cause: Cause, also: str, where: Where) -> Cause:
    return replace(cause, also=(also,), where=where)


def _for(seconds: float) -> Where:
    return lambda values: {"window": [values["since"], values["since"] + seconds]}


UNLIKE = (
    _other("floor_drift", "speed", 0.01, 0.05, signed=True),
    _local(_other("estimate_jump", "left", 0.03, 0.12, signed=True), "place",
           lambda values: {"place": [values["place"], 0.8]}),
    _other("lost_frames", "rate", 0.6, 2.5),
    _local(_other("wheel_jam", "share", 0.2, 0.8), "since", _for(JAM)),
    _local(_other("heading_step", "angle", 0.25, 0.8, signed=True), "since", _for(0.02)),
    _local(_other("stall", "time", 0.3, 1.2), "since",
           lambda values: {"window": [values["since"], values["since"] + values["stall"]]}),
    _local(_other("shove", "left", 0.04, 0.15, signed=True), "since", _for(SHOVE)),
    _local(_other("slippery_patch", "share", 0.2, 0.7), "place",
           lambda values: {"place": [values["place"] - PATCH, values["place"] + PATCH]}),
    _other("dead_zone", "speed", 0.06, 0.18),
)  # fmt: skip
"""Structurally different from everything in the catalogue."""

UNKNOWN = (*UNLIKE, *NEAR)
"""As many of either kind."""
