"""One machine, and what one run of it has of its own."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

TICK = 1e-3
"""[s] of the controller."""
SUBSTEPS = 4
STEP = TICK / SUBSTEPS
"""[s] of the integrator."""
CENTRE = 0.12
"""[m] middle of the axis."""


@dataclass
class Machine:
    """One machine in one rollout; zero is "not there" unless a field says otherwise."""

    # As in the catalogue, in other forms.
    viscous: float = 0.0
    coulomb: float = 0.0
    stribeck: float = 0.0
    stribeck_speed: float = 0.02
    quadratic: float = 0.0
    load_friction: float = 0.0
    offset: float = 0.0
    cable: float = 0.0
    mass: float = 95.0
    gain: float = 1.0
    force_ripple: float = 0.0
    force_phase: float = 0.0
    lag: float = 0.0
    sag: float = 0.0
    limit: float = 10.0
    delay: float = 0.0
    speed_filter: float = 0.0
    encoder_ripple: float = 0.0
    encoder_phase: float = 0.0
    half_gap: float = 0.0
    # Which other form.
    bristle: float = 0.0
    """1: Dahl's bristle; 0: tanh."""
    presliding: float = 1e-5
    """[m] that a bristle bends."""
    creep: float = 1e-3
    """[m/s] of the tanh."""
    lopsided: float = 0.0
    """Difference of viscosity and drag between the directions."""
    motor_share: float = 0.3
    supply_time: float = 0.03
    """[s] of the supply's capacitor."""
    jitter: float = 0.0
    """Part of the delay by which it varies."""
    # What the catalogue does not have.
    cubic: float = 0.0
    """[N*s^3/m^3]"""
    thinning: float = 0.0
    """[N] at 0.1 m/s of a friction that grows with the speed to the power 0.4."""
    root_stribeck: float = 0.0
    """[N] of a friction that falls as exp(-sqrt(v / 0.05))."""
    graded: float = 0.0
    """[N/m] of dry friction along the rail."""
    warming: float = 0.0
    """[N*s/m] of viscosity that is gone after a second."""
    one_sided: float = 0.0
    """[N/m] of a cable that pulls beyond the middle only."""
    lopsided_gain: float = 0.0
    """Share of the force that is more forwards and less backwards."""
    bump: float = 0.0
    """[N] of a dent in the rail at ``place``."""
    sticking: float = 0.0
    """[N] of dry friction at ``place``."""
    place: float = CENTRE
    gust: float = 0.0
    """[N] from ``since`` for 0.3 s."""
    brake: float = 0.0
    """[N] of dry friction from ``since`` on."""
    since: float = 0.0
    flexible: float = 0.0
    """[kg] of the carriage that hang on a spring of ``frequency``."""
    frequency: float = 10.0
    outages: float = 0.0
    """Probability with which the controller stops for 20 ms at a tick; its last output holds."""
    slipped: float = 0.0
    """[m] that the encoder loses whenever it passes ``place`` forwards."""


@dataclass
class Nuisance:
    """What one run has of its own: payload error [kg], gain factor, start [m], friction factor."""

    payload: float
    gain: float
    start: float
    friction: float
    seed: int


def drawn_nuisance(rng: np.random.Generator) -> Nuisance:
    payload, gain, start, friction = rng.normal(size=4)
    return Nuisance(
        0.1 * payload, 1 + 0.002 * gain, 2e-5 * start, 1 + 0.01 * friction, int(rng.integers(2**62))
    )


def sines(rng: np.random.Generator, steps: int) -> FloatArray:
    """Return (steps,) of a force of 1 N standard deviation, between 0.3 and 8 Hz."""
    times = STEP * np.arange(steps)
    frequencies, phases = rng.uniform(0.3, 8.0, 12), rng.uniform(0, 2 * pi, 12)
    sizes = rng.normal(size=12)
    sizes *= np.sqrt(2 / np.sum(sizes**2))
    return np.asarray(np.sin(2 * pi * frequencies * times[:, None] + phases) @ sizes)


def arrivals(rng: np.random.Generator, ticks: int, machine: Machine) -> NDArray[np.intp]:
    """Return (substeps,) which tick's command is the newest at the drive, −1 before any: none overtakes another."""
    sent = TICK * np.arange(ticks)
    waits = machine.delay * (1 + machine.jitter * rng.uniform(-1, 1, ticks))
    arrived = np.maximum.accumulate(sent + waits)
    times = STEP * np.arange(ticks * SUBSTEPS) + 1e-9
    return np.searchsorted(arrived, times, side="right") - 1


def missing(rng: np.random.Generator, ticks: int, machine: Machine) -> NDArray[np.bool_]:
    """Return (ticks,) whether the controller is out."""
    begun = rng.random(ticks) < machine.outages
    return np.asarray(np.convolve(begun, np.ones(20))[:ticks] > 0)
