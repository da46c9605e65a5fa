"""Effects on motors, gears and the bus."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from benchmarks.blind.a1.effects.kind import Kind, Values, sign
from benchmarks.blind.a1.twin import Twin


def _weak(twin: Twin, rng: Generator, values: Values) -> None:
    """Less current, by a little more or less on every joint, and less smoothly."""
    lost = 1.0 - values["factor"]
    twin.world["strength"] *= 1.0 - lost * (1.0 + 0.08 * rng.normal(size=12))
    twin.world["strength_ripple"] += 0.1 * abs(lost)


def _sag(twin: Twin, rng: Generator, values: Values) -> None:
    """A battery behind a resistor and a capacitor: it sags with the load, and recovers."""
    twin.world["sag_rate"] += values["rate"]


def _slow(twin: Twin, rng: Generator, values: Values) -> None:
    twin.world["voltage"] = np.minimum(twin.world["voltage"], values["voltage"])


def _late(twin: Twin, rng: Generator, values: Values) -> None:
    twin.timing = replace(twin.timing, delay=twin.timing.delay + values["delay"])


def _rub(twin: Twin, rng: Generator, values: Values) -> None:
    """Dahl's law, more of it on some joints than on others."""
    twin.world["coulomb"] += values["torque"] * (1.0 + 0.1 * rng.normal(size=12))


def _grease(twin: Twin, rng: Generator, values: Values) -> None:
    """Grease that thins at speed."""
    twin.world["viscous"] += values["coefficient"] * (1.0 + 0.1 * rng.normal(size=12))


def _rotors(twin: Twin, rng: Generator, values: Values) -> None:
    """Inertia on the motors' side of elastic gears, somewhat different from hip to calf."""
    twin.world["rotor"] += values["inertia"] * np.tile(1.0 + 0.08 * rng.normal(size=3), 4)


def _play(twin: Twin, rng: Generator, values: Values) -> None:
    """Two masses and a gap between them, wider on some joints than on others."""
    twin.world["half_gap"] += values["half_gap"] * np.clip(1.0 + 0.1 * rng.normal(size=12), 0.5, 1.5)


def _constant(twin: Twin, rng: Generator, values: Values) -> None:
    """Other magnets, which lose a little as they warm up."""
    lost = 1.0 - values["factor"]
    twin.world["torque_constant"] *= 1.0 - lost * (1.0 + 0.05 * rng.normal(size=12))
    twin.world["warming"] += 0.1 * abs(lost)


DRIVES = (
    Kind("motor_strength", 0.06, 0.45, lambda rng, size: {"factor": 1.0 - size}, _weak),
    Kind("strength_decay", 0.05, 0.25, lambda rng, size: {"rate": size}, _sag),
    Kind("torque_speed_line", 0.7, 0.78, lambda rng, size: {"voltage": 1.0 - size}, _slow),
    Kind("latency", 0.002, 0.014, lambda rng, size: {"delay": size}, _late),
    Kind("dry_friction", 0.1, 1.2, lambda rng, size: {"torque": size}, _rub),
    Kind("viscous_friction", 0.1, 1.2, lambda rng, size: {"coefficient": size}, _grease),
    Kind("armature", 0.003, 0.02, lambda rng, size: {"inertia": size}, _rotors),
    Kind("backlash", 0.003, 0.02, lambda rng, size: {"half_gap": size}, _play),
    Kind("torque_constant", 0.06, 0.3, lambda rng, size: {"factor": 1.0 - sign(rng, 0.75) * size}, _constant),
)
