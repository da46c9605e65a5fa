"""Effects on what the robot believes."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin

import numpy as np
from numpy.random import Generator

from benchmarks.blind.a1.effects.kind import Kind, Values, sign
from benchmarks.blind.a1.twin import Twin


def _biased(twin: Twin, rng: Generator, values: Values) -> None:
    """An offset that wanders by a tenth of itself."""
    forward, left = twin.sensing.velocity_bias
    twin.sensing = replace(twin.sensing, velocity_bias=(forward + values["forward"], left + values["left"]))


def _scaled(twin: Twin, rng: Generator, values: Values) -> None:
    """A scale whose error wanders by a tenth of itself."""
    twin.sensing = replace(twin.sensing, velocity_scale=twin.sensing.velocity_scale * values["factor"])


def _askew(twin: Twin, rng: Generator, values: Values) -> None:
    """An offset that drifts."""
    roll, pitch = twin.sensing.attitude_bias
    twin.sensing = replace(twin.sensing, attitude_bias=(roll + values["roll"], pitch + values["pitch"]))


def _encoders(twin: Twin, rng: Generator, values: Values) -> None:
    """Offsets that are not quite the same on all legs."""
    each = np.tile([values["hip"], values["thigh"], values["calf"]], 4)
    twin.world["encoder_offset"] += each * (1.0 + 0.12 * rng.normal(size=12))


def _direction(first: str, second: str, mostly: float, part: float):
    """Return values along the first axis mostly, and else in any direction, by ``part`` along the second."""

    def values(rng: Generator, size: float) -> dict[str, float]:
        angle = rng.choice((0.0, pi)) if rng.uniform() < mostly else rng.uniform(0.0, 2.0 * pi)
        return {first: size * cos(angle), second: part * size * sin(angle)}

    return values


def _joint(rng: Generator, size: float) -> dict[str, float]:
    """Return an offset of thighs or calves, seldom of hips."""
    values = {"hip": 0.0, "thigh": 0.0, "calf": 0.0}
    values[str(rng.choice(("hip", "thigh", "calf"), p=(0.2, 0.45, 0.35)))] = sign(rng) * size
    return values


SENSES = (
    Kind("velocity_bias", 0.01, 0.1, _direction("forward", "left", 0.6, 1.0), _biased),
    Kind("velocity_scale", 0.06, 0.3, lambda rng, size: {"factor": 1.0 + sign(rng, 0.7) * size}, _scaled),
    Kind("attitude_bias", 0.4, 4.0, _direction("pitch", "roll", 0.6, 1.0), _askew),
    Kind("encoder_offset", 0.008, 0.05, _joint, _encoders),
)
