"""The excitation protocols of the A1: those of `sim`, with joint gains within the guard's limits.

A client sends the references of :mod:`s2r_sim.protocols.references` at the vendor's rate of 500 Hz. The motors follow
τ = kp (q − q_measured) + kd (dq − dq_measured) themselves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import floor

import numpy as np

from s2r_a1.guard.limits import LIMITS
from s2r_sim.controller.gains import RATE
from s2r_sim.protocols import PROTOCOLS as SIMULATED
from s2r_sim.protocols.references import GAIN, MOTIONS, reference
from s2r_spec.backend import Parameter
from s2r_spec.protocols import PROTOCOL, Protocol, named
from s2r_spec.trace import Trace


def _clip_gains(protocol: Protocol) -> Protocol:
    """Return a protocol whose gains the guard passes on unchanged."""
    most = min(GAIN.high, floor(100.0 * LIMITS.kp / MOTIONS[protocol.name].kp) / 100.0)
    gain = replace(GAIN, high=most, default=min(GAIN.default, most))
    return replace(protocol, parameters=tuple(_or(p, gain) for p in protocol.parameters))


def _or(parameter: Parameter, other: Parameter) -> Parameter:
    return other if parameter.name == other.name else parameter


PROTOCOLS = tuple(_clip_gains(protocol) for protocol in SIMULATED)
"""A definition: every protocol, in the order of `sim`."""


def height_in_rig(protocol: str) -> float | None:
    """Return the height of the base in its rig [m]; None for a protocol on the ground."""
    motion = MOTIONS[protocol]
    return motion.height if motion.held else None


def playable(name: str, protocol: str, params: Mapping[str, float]) -> Trace:
    """Return the references of a protocol; see :class:`s2r_spec.protocols.HasPlayable`.

    Args:
        name: name of the backend, for messages.
        protocol: name of the protocol.
        params: its parameters.

    Raises:
        UsageError: there is no such protocol, or a parameter is unknown or out of range.
    """
    values = named(PROTOCOLS, protocol, name).values(params)
    made = reference(protocol, **values)
    return Trace(
        np.arange(len(made.q)) / RATE,
        {"q": made.q, "dq": made.dq, "kp": made.kp, "kd": made.kd},
        {"q": "rad", "dq": "rad/s", "kp": "N*m/rad", "kd": "N*m*s/rad"},
        {PROTOCOL: protocol, "params": values},
    )
