"""Cases for a diagnosis: healthy machines, and machines with one large effect.

    null     masses, rubber, frictions and noise differ from the data sheet as in ``machine.py``; nothing is wrong
    single   the same, and one effect, drawn uniformly from ``machine.EFFECTS``

Of an effect with several parameters one is drawn, uniformly, and the others are nominal; a payload sits at the centre.
Its size |θ| is log-uniform from 0.5 to 1 typical. Its sign is drawn from the sides on which the range reaches that far.
*Typical* is twice the standard deviation of the parameter's prior, at most its range
(``s2r_spec.diagnose.simulator.axes``).

The rollouts of a case are ``Case.trots`` and ``Case.protocols``. ``Case.label`` is the truth: no diagnosis may read it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.random import Generator

from benchmarks.plants import PLANTS, Plant
from benchmarks.plants.machine import EFFECTS, Machine, healthy
from benchmarks.plants.robot import CATALOGUE, PROTOCOLS
from s2r_spec.diagnose.simulator.axes import EffectAxis, effect_axis
from s2r_spec.trace import Trace

Kind = Literal["null", "single"]
KINDS: tuple[Kind, ...] = get_args(Kind)
RANGE = (-0.2, 0.3)
"""Definition: test space of ``specs/a1_velocity.stl`` [m/s]."""
TROTS, REPEATS = 6, 2
"""Budgets: trots of a case, each in its own sixth of the test space; runs of each protocol."""
SMALLEST, LARGEST = 0.5, 1.0
"""Definitions: sizes of a large effect, in typical sizes."""


@dataclass(frozen=True)
class Label:
    """What is wrong with a machine.

    Attributes:
        effect: an effect of the catalogue, or None.
        parameter: its parameter that is not nominal, or None.
        value: its value, in the catalogue's unit.
        size: its signed distance from nominal, in typical sizes.
    """

    effect: str | None = None
    parameter: str | None = None
    value: float = 0.0
    size: float = 0.0


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes:
        trots: parameters and trace of every trot.
        protocols: name and trace of every run of a protocol, at full amplitude and at the nominal gain.
        label: the truth.
    """

    trots: tuple[tuple[dict[str, float], Trace], ...]
    protocols: tuple[tuple[str, Trace], ...]
    label: Label


def plant(name: str, kind: Kind, seed: int) -> tuple[Plant, Label]:
    """Return the machine of a case, and what is wrong with it; ``name`` is "smooth" or "stiff"."""
    rng = _stream(name, kind, seed, 0)
    machine = healthy(rng)
    if kind == "null":
        return Plant(PLANTS[name], machine), Label()
    effect = str(rng.choice(list(EFFECTS)))
    parameter = str(rng.choice(EFFECTS[effect]))
    label = large(effect, parameter, math.exp(rng.uniform(math.log(SMALLEST), math.log(LARGEST))), rng)
    return Plant(PLANTS[name], affected(machine, label)), label


def large(effect: str, parameter: str, size: float, rng: Generator) -> Label:
    """Return a label of this size, on a side on which the range reaches as far."""
    one = axis(effect, parameter)
    sides = [
        side for side, end in ((-1.0, one.low), (1.0, one.high)) if side * one.coordinate(end) >= size - 1e-9
    ]
    signed = float(rng.choice(sides)) * size
    return Label(effect, parameter, one.value(signed), signed)


def axis(effect: str, parameter: str) -> EffectAxis:
    """Return the parameter's axis, with its typical size."""
    return effect_axis(
        CATALOGUE[effect], next(one for one in CATALOGUE[effect].parameters if one.name == parameter)
    )


def affected(machine: Machine, label: Label) -> Machine:
    """Return the machine with what the label says."""
    if label.effect is None:
        return machine
    return replace(machine, effects={**machine.effects, f"{label.effect}.{label.parameter}": label.value})


def commands(name: str, kind: Kind, seed: int) -> list[float]:
    """Return the commands of a case's trots [m/s], rising."""
    low, high = RANGE
    parts = (np.arange(TROTS) + _stream(name, kind, seed, 1).uniform(size=TROTS)) / TROTS
    return [float(vd) for vd in np.round(low + (high - low) * parts, 4)]


def cases(
    name: str,
    kind: Kind,
    seed: int,
    protocols: Iterable[str] = PROTOCOLS,
    repeats: int = REPEATS,
    trots: int = TROTS,
) -> Case:
    """Make the case of a plant, a kind and a seed, a pure function of them; less of it where the rest says so.

    Args:
        name: "smooth" or "stiff".
        kind: "null" or "single".
        seed: of the machine and its runs.
        protocols: names of the protocols to run.
        repeats: runs of each protocol.
        trots: how many of the six trots.
    """
    made, label = plant(name, kind, seed)
    walks = tuple(
        ({"vd": vd}, made.trot(vd, _stream(name, kind, seed, 2, k)))
        for k, vd in enumerate(commands(name, kind, seed)[:trots])
    )
    runs = tuple(
        (protocol, made.run(protocol, _stream(name, kind, seed, 3, PROTOCOLS.index(protocol), k)))
        for protocol in protocols
        for k in range(repeats)
    )
    return Case(walks, runs, label)


def _stream(name: str, kind: Kind, seed: int, *place: int) -> Generator:
    """Return the random numbers of one purpose."""
    return np.random.default_rng([list(PLANTS).index(name), KINDS.index(kind), seed, *place])
