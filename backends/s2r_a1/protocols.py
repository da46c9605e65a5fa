"""The excitation protocols of the A1: those of `sim`, with joint gains within the guard's limits.

A client sends the references of :mod:`s2r_sim.protocols.references` at the vendor's rate of 500 Hz. The motors follow
τ = kp (q − q_measured) + kd (dq − dq_measured) themselves.
"""

from __future__ import annotations

from dataclasses import replace
from math import floor

from s2r_a1.guard.limits import LIMITS
from s2r_sim.protocols import PROTOCOLS as SIMULATED
from s2r_sim.protocols.references import GAIN, MOTIONS
from s2r_spec.protocols import Protocol


def _clip_gains(protocol: Protocol) -> Protocol:
    """Return a protocol whose gains the guard passes on unchanged."""
    most = min(GAIN.high, floor(100.0 * LIMITS.kp / MOTIONS[protocol.name].kp) / 100.0)
    gain = replace(GAIN, high=most, default=min(GAIN.default, most))
    return replace(
        protocol, parameters=tuple(gain if p.name == gain.name else p for p in protocol.parameters)
    )


PROTOCOLS = tuple(_clip_gains(protocol) for protocol in SIMULATED)
"""A definition: every protocol, in the order of `sim`."""


def height_in_rig(protocol: str) -> float | None:
    """Return the height of the base in its rig [m]; None for a protocol on the ground."""
    motion = MOTIONS[protocol]
    return motion.height if motion.held else None
