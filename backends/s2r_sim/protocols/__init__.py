"""Excitation protocols of the A1: joint references under a plain PD law, with the base held in the air or standing."""

from s2r_sim.protocols.references import PROTOCOLS

__all__ = ["PROTOCOLS"]
