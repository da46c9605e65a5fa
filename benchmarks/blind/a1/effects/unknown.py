"""Effects that the catalogue does not have: half of them unlike anything in it, half near relatives."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin

import numpy as np
from numpy.random import Generator

from benchmarks.blind.a1.effects.kind import Kind, Values, sign
from benchmarks.blind.a1.robot import A1
from benchmarks.blind.a1.twin import Twin

_PARTS = ("hip", "thigh", "calf")


def _leg(rng: Generator) -> float:
    return float(rng.integers(4))


def _of_leg(values: Values) -> slice:
    first = 3 * int(values["leg"])
    return slice(first, first + 3)


# Unlike anything in the catalogue


def _weak_leg(twin: Twin, rng: Generator, values: Values) -> None:
    twin.world["strength"][0, _of_leg(values)] *= values["factor"]


def _dragging_foot(twin: Twin, rng: Generator, values: Values) -> None:
    twin.world["drag_coulomb"][0, int(values["leg"])] += values["force"]


def _gust(twin: Twin, rng: Generator, values: Values) -> None:
    to = values["towards"]
    twin.world["gust"] = [values["force"] * cos(to), values["force"] * sin(to), 0.0]
    twin.world["gust_start"], twin.world["gust_end"] = values["start"], values["start"] + values["duration"]


def _gust_values(rng: Generator, size: float) -> dict[str, float]:
    towards = rng.choice((0.0, pi)) + rng.normal() * 0.3
    return {
        "force": size,
        "towards": towards,
        "start": rng.uniform(0.3, 1.0),
        "duration": rng.uniform(0.25, 0.45),
    }


def _tether(twin: Twin, rng: Generator, values: Values) -> None:
    twin.world["tether_stiffness"], twin.world["tether_slack"] = values["stiffness"], values["slack"]
    twin.world["tether_height"] = 0.06


def _slosh(twin: Twin, rng: Generator, values: Values) -> None:
    """A part of the trunk's own mass swings on springs: the weight stays what it was."""
    *links, trunk = twin.build.masses
    twin.build = replace(twin.build, masses=(*links, trunk - values["mass"] / A1.base.mass))
    twin.world["slosh_mass"], twin.world["slosh_rate"] = values["mass"], 2.0 * pi * values["frequency"]
    twin.world["slosh_damping"], twin.world["slosh_height"] = 0.08, 0.1


def _gaps(twin: Twin, rng: Generator, values: Values) -> None:
    twin.timing = replace(
        twin.timing, lost_every=values["every"], lost_for=values["for"], lost_from=rng.uniform(0.0, 0.2)
    )


def _cogs(twin: Twin, rng: Generator, values: Values) -> None:
    twin.world["cogging"] += values["torque"]


def _stale(twin: Twin, rng: Generator, values: Values) -> None:
    twin.timing = replace(twin.timing, stale=values["most"])


def _bump(twin: Twin, rng: Generator, values: Values) -> None:
    twin.world["bump_height"], twin.world["bump_at"] = values["height"], values["x"]


# Near relatives


def _square(twin: Twin, rng: Generator, values: Values) -> None:
    twin.world["drag_square"] += values["coefficient"]


def _one_joint_rubs(twin: Twin, rng: Generator, values: Values) -> None:
    twin.world["coulomb"][0, int(values["part"]) :: 3] += values["torque"]


def _leg_load(twin: Twin, rng: Generator, values: Values) -> None:
    twin.build = replace(twin.build, leg_load=values["mass"], leg=int(values["leg"]))


def _drift(twin: Twin, rng: Generator, values: Values) -> None:
    twin.sensing = replace(twin.sensing, velocity_drift=values["rate"])


def _one_encoder(twin: Twin, rng: Generator, values: Values) -> None:
    twin.world["encoder_offset"][0, 3 * int(values["leg"]) + int(values["part"])] += values["angle"]


def _cross_slope(twin: Twin, rng: Generator, values: Values) -> None:
    twin.world["cross_slope"] += np.tan(np.radians(values["angle"]))


def _lag(twin: Twin, rng: Generator, values: Values) -> None:
    twin.world["lag"] += values["time"]


UNLIKE = (
    Kind("weak_leg", 0.2, 0.5, lambda rng, size: {"leg": _leg(rng), "factor": 1.0 - size}, _weak_leg),
    Kind("dragging_foot", 8.0, 25.0, lambda rng, size: {"leg": _leg(rng), "force": size}, _dragging_foot),
    Kind(
        "gust", 6.0, 25.0, _gust_values, _gust, window=lambda v: (v["start"], v["start"] + v["duration"])
    ),
    Kind(
        "tether", 20.0, 150.0,
        lambda rng, size: {"stiffness": size, "slack": rng.uniform(-0.05, 0.05)}, _tether,
    ),
    Kind(
        "sloshing", 1.0, 3.0,
        lambda rng, size: {"mass": size, "frequency": rng.uniform(1.0, 2.5)}, _slosh,
    ),
    Kind(
        "lost_commands", 0.015, 0.045, lambda rng, size: {"for": size, "every": rng.uniform(0.08, 0.2)}, _gaps
    ),
    Kind("cogging", 0.8, 2.5, lambda rng, size: {"torque": size}, _cogs),
    Kind(
        "bump", 0.01, 0.03, lambda rng, size: {"height": size, "x": rng.uniform(-0.3, 0.4)}, _bump
    ),
)  # fmt: skip

NEAR = (
    Kind("square_drag", 3.0, 16.0, lambda rng, size: {"coefficient": size}, _square, "foot_drag"),
    Kind(
        "one_joint_rubs", 0.8, 2.5,
        lambda rng, size: {"part": float(rng.integers(3)), "torque": size}, _one_joint_rubs, "dry_friction",
    ),
    Kind("leg_load", 0.3, 0.9, lambda rng, size: {"leg": _leg(rng), "mass": size}, _leg_load, "payload"),
    Kind("velocity_drift", 0.025, 0.1, lambda rng, size: {"rate": sign(rng) * size}, _drift, "velocity_bias"),
    Kind(
        "one_encoder", 0.05, 0.12,
        lambda rng, size: {"leg": _leg(rng), "part": float(rng.integers(1, 3)), "angle": sign(rng) * size},
        _one_encoder, "encoder_offset",
    ),
    Kind("cross_slope", 1.2, 3.5, lambda rng, size: {"angle": sign(rng) * size}, _cross_slope, "slope"),
    Kind("stale_picture", 0.008, 0.02, lambda rng, size: {"most": size}, _stale, "latency"),
    Kind("current_lag", 0.004, 0.015, lambda rng, size: {"time": size}, _lag, "latency"),
)  # fmt: skip
