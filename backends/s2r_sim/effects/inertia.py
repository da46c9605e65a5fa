"""Effects of masses and inertias: a payload, the centre of mass, rotors."""

from __future__ import annotations

from s2r_sim.plant.physics import PAYLOAD_HEIGHT, Physics
from s2r_spec.backend import EffectParameter
from s2r_spec.effects import ModelEffect, adds


class PayloadEffect(ModelEffect):
    """The effect of a point mass, which joins a list instead of changing a number."""

    def apply(self, model: Physics, **values: float) -> Physics:
        """Return the physics with this mass [kg] on the trunk, at x, y and z [m] in base axes."""
        return model.with_payload(**values)


ARMATURE = ModelEffect(
    "armature", "inertia", "Rotor inertia is added to every joint, beyond that of the controller's model.",
    (EffectParameter("inertia", "kg*m^2", low=0.0, high=0.03, nominal=0.0, prior="half-normal, 0.008 kg*m^2"),),
    (adds("armature"),),
)  # fmt: skip
PAYLOAD = PayloadEffect(
    "payload", "inertia", "A point mass sits on the trunk, at x, y and z from the base origin.",
    (
        EffectParameter("mass", "kg", low=0.0, high=6.0, nominal=0.0, prior="half-normal, 1.5 kg"),
        EffectParameter("x", "m", low=-0.15, high=0.15, nominal=0.0, prior="normal, 0.05 m"),
        EffectParameter("y", "m", low=-0.1, high=0.1, nominal=0.0, prior="normal, 0.03 m"),
        EffectParameter(
            "z", "m", low=0.0, high=0.25, nominal=PAYLOAD_HEIGHT, prior="normal around 0.08, standard deviation 0.04"
        ),
    ),
)  # fmt: skip
COM_OFFSET = ModelEffect(
    "com_offset", "inertia", "The trunk's centre of mass lies elsewhere than the controller's model has it.",
    (
        EffectParameter("x", "m", low=-0.1, high=0.1, nominal=0.0, prior="normal, 0.02 m"),
        EffectParameter("y", "m", low=-0.06, high=0.06, nominal=0.0, prior="normal, 0.01 m"),
        EffectParameter("z", "m", low=-0.06, high=0.06, nominal=0.0, prior="normal, 0.01 m"),
    ),
    (adds("com_shift", 0), adds("com_shift", 1), adds("com_shift", 2)),
)  # fmt: skip
