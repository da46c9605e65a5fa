"""The catalogue of effects that the nominal axis leaves out."""

from __future__ import annotations

from s2r_emps.physics import Physics
from s2r_spec.backend import EffectParameter
from s2r_spec.effects import Choice, ModelEffect, add_effects, adds, limits, scales, sets

_LIST = (
    ModelEffect(
        "viscous", "friction", "Grease and seals resist the carriage in proportion to its speed.",
        (EffectParameter("coefficient", "N*s/m", low=0.0, high=800.0, nominal=0.0, prior="half-normal, 150 N*s/m"),),
        (adds("viscous"),),
    ),
    ModelEffect(
        "coulomb", "friction", "Dry friction of this force opposes any motion, and holds the carriage at rest.",
        (EffectParameter("force", "N", low=0.0, high=80.0, nominal=0.0, prior="half-normal, 20 N"),),
        (adds("coulomb"),),
    ),
    ModelEffect(
        "stribeck", "friction",
        "Static friction exceeds sliding friction by this force; the excess fades as exp(-(v / speed)^2).",
        (
            EffectParameter("force", "N", low=0.0, high=80.0, nominal=0.0, prior="half-normal, 20 N"),
            EffectParameter("speed", "m/s", low=0.005, high=0.1, nominal=0.02, prior="log-normal around 0.02, 0.5"),
        ),
        (adds("stribeck"), sets("stribeck_speed")),
    ),
    ModelEffect(
        "quadratic_drag", "friction",
        "A drag resists the carriage in proportion to its speed squared, as of a fan or of stirred grease.",
        (EffectParameter("coefficient", "N*s^2/m^2", low=0.0, high=4000.0, nominal=0.0,
                         prior="half-normal, 700 N*s^2/m^2"),),
        (adds("drag"),),
    ),
    ModelEffect(
        "load_friction", "friction", "The friction of the screw grows in proportion to the force that it transmits.",
        (EffectParameter("coefficient", "", low=0.0, high=0.5, nominal=0.0, prior="half-normal, 0.1"),),
        (adds("load_friction"),),
    ),
    ModelEffect(
        "offset", "load", "A constant force opposes positive motion: the axis is not level, or the drive has a bias.",
        (EffectParameter("force", "N", low=-60.0, high=60.0, nominal=0.0, prior="normal, 10 N"),),
        (adds("offset"),),
    ),
    ModelEffect(
        "cable", "load", "A cable chain pulls the carriage towards the middle of the axis like a spring.",
        (EffectParameter("stiffness", "N/m", low=0.0, high=1000.0, nominal=0.0, prior="half-normal, 200 N/m"),),
        (adds("cable"),),
    ),
    ModelEffect(
        "mass", "inertia", "The moving mass, without the payload, is larger than in the drawing.",
        (EffectParameter("extra", "kg", low=-30.0, high=60.0, nominal=0.0, prior="normal, 12 kg"),),
        (adds("mass"),),
    ),
    ModelEffect(
        "motor_gain", "actuation", "The drive's force per volt is this factor times the manufacturer's figure.",
        (EffectParameter("factor", "", low=0.6, high=1.4, nominal=1.0,
                         prior="normal around 1, standard deviation 0.1"),),
        (scales("gain"),),
    ),
    ModelEffect(
        "force_ripple", "actuation", "The magnets of the motor add a force that oscillates four times per turn.",
        (
            EffectParameter("amplitude", "N", low=0.0, high=60.0, nominal=0.0, prior="half-normal, 12 N"),
            EffectParameter("phase", "rad", low=-3.1416, high=3.1416, nominal=0.0, prior="uniform"),
        ),
        (adds("ripple"), sets("ripple_phase")),
    ),
    ModelEffect(
        "current_lag", "actuation", "The current, and with it the force, follows the voltage with this time constant.",
        (EffectParameter("time", "s", low=0.0, high=0.004, nominal=0.0, prior="half-normal, 0.0015 s"),),
        (adds("lag"),),
    ),
    ModelEffect(
        "supply_sag", "actuation",
        "The supply voltage sags under load: at full voltage this share of the force is lost, and in proportion to "
        "the voltage below it.",
        (EffectParameter("drop", "", low=0.0, high=0.8, nominal=0.0, prior="half-normal, 0.2"),),
        (adds("sag"),),
    ),
    ModelEffect(
        "voltage_limit", "actuation", "The drive saturates at this voltage, below the one on its plate.",
        (EffectParameter("voltage", "V", low=1.5, high=10.0, nominal=10.0, prior="10 minus half-normal, 3 V"),),
        (limits("voltage"),),
    ),
    ModelEffect(
        "delay", "timing", "The controller's output reaches the drive this much later.",
        (EffectParameter("time", "s", low=0.0, high=0.004, nominal=0.0, prior="half-normal, 0.0015 s"),),
        (adds("delay"),),
    ),
    ModelEffect(
        "speed_filter", "sensing", "The drive smooths the speed that it feeds back with this time constant.",
        (EffectParameter("time", "s", low=0.0, high=0.004, nominal=0.0, prior="half-normal, 0.0015 s"),),
        (adds("speed_filter"),),
    ),
    ModelEffect(
        "encoder_ripple", "sensing",
        "The encoder is off its centre: its error has this amplitude and one period per motor turn.",
        (
            EffectParameter("amplitude", "m", low=0.0, high=0.0001, nominal=0.0, prior="half-normal, 1.5e-05 m"),
            EffectParameter("phase", "rad", low=-3.1416, high=3.1416, nominal=0.0, prior="uniform"),
        ),
        (adds("encoder_ripple"), sets("encoder_phase")),
    ),
    ModelEffect(
        "backlash", "transmission",
        "Between two flanks the motor turns without the carriage; the encoder is on the motor's side.",
        (EffectParameter("half_gap", "m", low=0.0, high=0.0005, nominal=0.0, prior="half-normal, 0.0001 m"),),
        (adds("half_gap"),),
    ),
)  # fmt: skip

CATALOGUE: dict[str, ModelEffect] = {effect.name: effect for effect in _LIST}


def world(nominal: Physics, choice: Choice) -> Physics:
    """Return the constants of the axis with these effects."""
    return add_effects(nominal, CATALOGUE.values(), choice)
