"""Effects of delay between controller and motors."""

from __future__ import annotations

from s2r_spec.backend import EffectParameter
from s2r_spec.effects import ModelEffect, adds

LATENCY = ModelEffect(
    "latency", "timing", "Motor commands take effect this much later, in whole physics steps of 1 ms.",
    (EffectParameter("delay", "s", low=0.0, high=0.03, nominal=0.0, prior="half-normal, 0.006 s"),),
    (adds("latency"),),
)  # fmt: skip
