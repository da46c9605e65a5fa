"""Effects between feet and ground: friction, drag, and ground that gives way."""

from __future__ import annotations

from s2r_spec.backend import EffectParameter
from s2r_spec.effects import ModelEffect, adds, scales

GROUND_FRICTION = ModelEffect(
    "ground_friction", "contact", "The friction coefficient of foot on ground is multiplied by this factor.",
    (EffectParameter("factor", "", low=0.1, high=1.5, nominal=1.0, prior="log-normal around 1, 0.4"),),
    (scales("friction"),),
)  # fmt: skip
SOFT_GROUND = ModelEffect(
    "soft_ground", "contact", "The ground builds up its resistance over this depth instead of at once.",
    (EffectParameter("sink", "m", low=0.0, high=0.03, nominal=0.0, prior="half-normal, 0.01 m"),),
    (adds("sink"),),
)  # fmt: skip
FOOT_DRAG = ModelEffect(
    "foot_drag", "contact",
    "A foot less than 6 cm above the ground is held back by a force proportional to its velocity.",
    (EffectParameter("coefficient", "N*s/m", low=0.0, high=20.0, nominal=0.0, prior="half-normal, 5 N*s/m"),),
    (adds("drag"),),
)  # fmt: skip
SHEAR_CREEP = ModelEffect(
    "shear_creep", "contact",
    "Friction builds up more slowly under a loaded foot by this factor on its stiffness, so that the foot creeps.",
    (EffectParameter("stiffness", "", low=0.01, high=1.0, nominal=1.0, prior="log-uniform"),),
    (scales("impratio"),),
)  # fmt: skip
