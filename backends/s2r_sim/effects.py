"""The catalogue of effects: physics that the nominal simulator omits."""

from __future__ import annotations

from s2r_sim.plant.physics import PAYLOAD_HEIGHT, Physics
from s2r_spec.effects import Choice, ModelEffect, add_effects, adds, limits, scales


class PayloadEffect(ModelEffect):
    """The effect of a point mass, which joins a list instead of changing a number."""

    def apply(self, model: Physics, **values: float) -> Physics:
        """Return the physics with this mass [kg] on the trunk, at x, y and z [m] in base axes."""
        return model.with_payload(**values)


effect = ModelEffect.of
_EFFECTS = (  # of a parameter: name, unit, low, high, nominal value, prior, and what it changes
    effect("motor_strength", "actuation",
           "The motors deliver this fraction of the torque command, and reach their limit that much earlier.",
           ("factor", "", 0.3, 1.2, 1.0, "normal around 1, standard deviation 0.15", scales("strength"))),
    effect("strength_decay", "actuation",
           "The motors lose this part of their strength in every second from the command on, as with an emptying "
           "battery. The part by_load of the loss grows with the squared torques instead of time.",
           ("rate", "1/s", 0.0, 0.3, 0.0, "half-normal, 0.05 1/s", adds("fade")),
           ("by_load", "", 0.0, 1.0, 0.0, "uniform", adds("fade_by_load"))),
    effect("torque_speed_line", "actuation",
           "At a part v of the supply voltage the driving torque is at most 2 (v - |speed| / 21 rad/s) of its "
           "maximum. At v = 1 there is no such limit.",
           ("voltage", "", 0.2, 1.0, 1.0, "1 minus half-normal, 0.2", limits("voltage"))),
    effect("latency", "timing", "Motor commands take effect this much later, in whole physics steps of 1 ms.",
           ("delay", "s", 0.0, 0.03, 0.0, "half-normal, 0.006 s", adds("latency"))),
    effect("dry_friction", "actuation", "Coulomb friction of this torque is added to every joint.",
           ("torque", "N*m", 0.0, 2.0, 0.0, "half-normal, 0.5 N*m", adds("dry_friction"))),
    effect("viscous_friction", "actuation", "Friction proportional to speed is added to every joint.",
           ("coefficient", "N*m*s/rad", 0.0, 2.0, 0.0, "half-normal, 0.4 N*m*s/rad", adds("damping"))),
    effect("armature", "inertia", "Rotor inertia is added to every joint, beyond that of the controller's model.",
           ("inertia", "kg*m^2", 0.0, 0.03, 0.0, "half-normal, 0.008 kg*m^2", adds("armature"))),
    effect("backlash", "actuation",
           "Between the flanks of its gear a rotor turns freely, and encoders sit on the rotor's side.",
           ("half_gap", "rad", 0.0, 0.05, 0.0, "half-normal, 0.01 rad", adds("backlash"))),
    effect("ground_friction", "contact", "The friction coefficient of foot on ground is multiplied by this factor.",
           ("factor", "", 0.1, 1.5, 1.0, "log-normal around 1, 0.4", scales("friction"))),
    effect("soft_ground", "contact", "The ground builds up its resistance over this depth instead of at once.",
           ("sink", "m", 0.0, 0.03, 0.0, "half-normal, 0.01 m", adds("sink"))),
    effect("foot_drag", "contact",
           "A foot less than 6 cm above the ground is held back by a force proportional to its velocity.",
           ("coefficient", "N*s/m", 0.0, 20.0, 0.0, "half-normal, 5 N*s/m", adds("drag"))),
    effect("shear_creep", "contact",
           "Friction builds up more slowly under a loaded foot by this factor on its stiffness, so that the foot "
           "creeps.",
           ("stiffness", "", 0.01, 1.0, 1.0, "log-uniform", scales("impratio"))),
    effect("slope", "terrain",
           "The ground is tilted by this angle, uphill in the direction in which the robot starts.",
           ("angle", "deg", -8.0, 8.0, 0.0, "normal, 2 deg", adds("slope"))),
    effect("roughness", "terrain",
           "The ground's height varies smoothly, with wavelengths of 0.2 to 0.6 m and this standard deviation. The "
           "seed of a rollout chooses the place where it begins.",
           ("height", "m", 0.0, 0.015, 0.0, "half-normal, 0.004 m", adds("roughness"))),
    PayloadEffect.of("payload", "inertia", "A point mass sits on the trunk, at x, y and z from the base origin.",
                     ("mass", "kg", 0.0, 6.0, 0.0, "half-normal, 1.5 kg"),
                     ("x", "m", -0.15, 0.15, 0.0, "normal, 0.05 m"),
                     ("y", "m", -0.1, 0.1, 0.0, "normal, 0.03 m"),
                     ("z", "m", 0.0, 0.25, PAYLOAD_HEIGHT, "normal around 0.08, standard deviation 0.04")),
    effect("com_offset", "inertia", "The trunk's centre of mass lies elsewhere than the controller's model has it.",
           ("x", "m", -0.1, 0.1, 0.0, "normal, 0.02 m", adds("com_shift", 0)),
           ("y", "m", -0.06, 0.06, 0.0, "normal, 0.01 m", adds("com_shift", 1)),
           ("z", "m", -0.06, 0.06, 0.0, "normal, 0.01 m", adds("com_shift", 2))),
    effect("velocity_bias", "sensing", "The controller's velocity has this error, in the heading frame.",
           ("forward", "m/s", -0.15, 0.15, 0.0, "normal, 0.03 m/s", adds("velocity_bias", 0)),
           ("left", "m/s", -0.15, 0.15, 0.0, "normal, 0.03 m/s", adds("velocity_bias", 1))),
    effect("velocity_scale", "sensing", "The controller's velocity is multiplied by this factor.",
           ("factor", "", 0.7, 1.4, 1.0, "normal around 1, standard deviation 0.1", scales("velocity_scale"))),
    effect("attitude_bias", "sensing",
           "The IMU is misaligned on the trunk, and reports roll and pitch with these errors.",
           ("roll", "deg", -6.0, 6.0, 0.0, "normal, 1.5 deg", adds("attitude_bias", 0)),
           ("pitch", "deg", -6.0, 6.0, 0.0, "normal, 1.5 deg", adds("attitude_bias", 1))),
    effect("encoder_offset", "sensing",
           "Joint encoders, for the controller and for the motors' own loop, are off by these angles on all legs.",
           ("hip", "rad", -0.08, 0.08, 0.0, "normal, 0.02 rad", adds("encoder_offset", 0)),
           ("thigh", "rad", -0.08, 0.08, 0.0, "normal, 0.02 rad", adds("encoder_offset", 1)),
           ("calf", "rad", -0.08, 0.08, 0.0, "normal, 0.02 rad", adds("encoder_offset", 2))),
    effect("torque_constant", "actuation",
           "The same current makes this multiple of the assumed torque; torque reported from the current does not "
           "show it.",
           ("factor", "", 0.6, 1.3, 1.0, "normal around 1, standard deviation 0.1", scales("torque_constant"))),
)  # fmt: skip
CATALOGUE: dict[str, ModelEffect] = {each.name: each for each in _EFFECTS}


def with_effects(nominal: Physics, choice: Choice) -> Physics:
    """Return the physics with these effects added; a parameter that is not set is nominal."""
    return add_effects(nominal, CATALOGUE.values(), choice)
