"""The catalogue of effects that the nominal axis leaves out."""

from __future__ import annotations

from s2r_emps.physics import Physics
from s2r_spec.effects import Choice, ModelEffect, add_effects, adds, limits, scales, sets

effect = ModelEffect.of
_EFFECTS = (  # of a parameter: name, unit, low, high, nominal value, prior, and what it changes
    effect("viscous", "friction",
           "Grease and seals resist the carriage in proportion to its speed, in positive motion more by the share "
           "direction, and in negative motion less.",
           ("coefficient", "N*s/m", 0.0, 800.0, 0.0, "half-normal, 150 N*s/m", adds("viscous")),
           ("direction", "", -1.0, 1.0, 0.0, "normal, 0.25", adds("viscous_direction"))),
    effect("coulomb", "friction", "Dry friction of this force opposes any motion, and holds the carriage at rest.",
           ("force", "N", 0.0, 80.0, 0.0, "half-normal, 20 N", adds("coulomb"))),
    effect("stribeck", "friction",
           "Static friction exceeds sliding friction by this force; the excess fades as exp(-(v / speed)^2).",
           ("force", "N", 0.0, 80.0, 0.0, "half-normal, 20 N", adds("stribeck")),
           ("speed", "m/s", 0.005, 0.1, 0.02, "log-normal around 0.02, 0.5", sets("stribeck_speed"))),
    effect("quadratic_drag", "friction",
           "A drag resists the carriage in proportion to its speed squared, as of a fan or of stirred grease.",
           ("coefficient", "N*s^2/m^2", 0.0, 4000.0, 0.0, "half-normal, 700 N*s^2/m^2", adds("drag"))),
    effect("load_friction", "friction",
           "The friction of the screw grows in proportion to the force that it transmits.",
           ("coefficient", "", 0.0, 0.5, 0.0, "half-normal, 0.1", adds("load_friction"))),
    effect("offset", "load",
           "A constant force opposes positive motion: the axis is not level, the drive has a bias, or dry friction "
           "differs between the directions.",
           ("force", "N", -60.0, 60.0, 0.0, "normal, 10 N", adds("offset"))),
    effect("cable", "load", "A cable chain pulls the carriage towards the middle of the axis like a spring.",
           ("stiffness", "N/m", 0.0, 1000.0, 0.0, "half-normal, 200 N/m", adds("cable"))),
    effect("mass", "inertia", "The moving mass, without the payload, is larger than in the drawing.",
           ("extra", "kg", -30.0, 60.0, 0.0, "normal, 12 kg", adds("mass"))),
    effect("motor_gain", "actuation", "The drive's force per volt is this factor times the manufacturer's figure.",
           ("factor", "", 0.6, 1.4, 1.0, "normal around 1, standard deviation 0.1", scales("gain"))),
    effect("force_ripple", "actuation", "The magnets of the motor add a force that oscillates four times per turn.",
           ("amplitude", "N", 0.0, 60.0, 0.0, "half-normal, 12 N", adds("ripple")),
           ("phase", "rad", -3.1416, 3.1416, 0.0, "uniform", sets("ripple_phase"))),
    effect("current_lag", "actuation",
           "The current, and with it the force, follows the voltage with this time constant.",
           ("time", "s", 0.0, 0.004, 0.0, "half-normal, 0.0015 s", adds("lag"))),
    effect("supply_sag", "actuation",
           "The supply voltage sags under load: at full voltage this share of the force is lost, and in proportion "
           "to the voltage below it.",
           ("drop", "", 0.0, 0.8, 0.0, "half-normal, 0.2", adds("sag"))),
    effect("voltage_limit", "actuation", "The drive saturates at this voltage, below the one on its plate.",
           ("voltage", "V", 1.5, 10.0, 10.0, "10 minus half-normal, 3 V", limits("voltage"))),
    effect("delay", "timing",
           "The controller's output reaches the drive this much later. It varies from tick to tick; jitter is "
           "its standard deviation, as a share of it.",
           ("time", "s", 0.0, 0.004, 0.0, "half-normal, 0.0015 s", adds("delay")),
           ("jitter", "", 0.0, 0.5, 0.0, "half-normal, 0.15", adds("jitter"))),
    effect("speed_filter", "sensing", "The drive smooths the speed that it feeds back with this time constant.",
           ("time", "s", 0.0, 0.004, 0.0, "half-normal, 0.0015 s", adds("speed_filter"))),
    effect("encoder_ripple", "sensing",
           "The encoder is off its centre: its error has this amplitude and one period per motor turn.",
           ("amplitude", "m", 0.0, 0.0001, 0.0, "half-normal, 1.5e-05 m", adds("encoder_ripple")),
           ("phase", "rad", -3.1416, 3.1416, 0.0, "uniform", sets("encoder_phase"))),
    effect("backlash", "transmission",
           "Between two flanks the motor turns without the carriage; the encoder is on the motor's side.",
           ("half_gap", "m", 0.0, 0.0005, 0.0, "half-normal, 0.0001 m", adds("half_gap"))),
)  # fmt: skip
CATALOGUE: dict[str, ModelEffect] = {each.name: each for each in _EFFECTS}


def world(nominal: Physics, choice: Choice) -> Physics:
    """Return the constants of the axis with these effects."""
    return add_effects(nominal, CATALOGUE.values(), choice)
