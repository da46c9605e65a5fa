"""The catalogue of effects that the nominal axis leaves out.

``apply(physics, **values)`` changes fields of its own, or multiplies or adds to others, so the order of effects does
not matter. With all values nominal it returns an equal table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from s2r_emps.physics import Physics
from s2r_spec.backend import Effect, EffectParameter
from s2r_spec.effects import Choice, settings


@dataclass(frozen=True)
class PhysicsEffect(Effect):
    """An effect of this simulator: its catalogue entry, and its function from one table of constants to another."""

    apply: Callable[..., Physics]


def _viscous(physics: Physics, coefficient: float) -> Physics:
    return replace(physics, viscous=physics.viscous + coefficient)


def _coulomb(physics: Physics, force: float) -> Physics:
    return replace(physics, coulomb=physics.coulomb + force)


def _stribeck(physics: Physics, force: float, speed: float) -> Physics:
    return replace(physics, stribeck=physics.stribeck + force, stribeck_speed=speed)


def _quadratic_drag(physics: Physics, coefficient: float) -> Physics:
    return replace(physics, drag=physics.drag + coefficient)


def _load_friction(physics: Physics, coefficient: float) -> Physics:
    return replace(physics, load_friction=physics.load_friction + coefficient)


def _offset(physics: Physics, force: float) -> Physics:
    return replace(physics, offset=physics.offset + force)


def _cable(physics: Physics, stiffness: float) -> Physics:
    return replace(physics, cable=physics.cable + stiffness)


def _force_ripple(physics: Physics, amplitude: float, phase: float) -> Physics:
    return replace(physics, ripple=physics.ripple + amplitude, ripple_phase=phase)


def _motor_gain(physics: Physics, factor: float) -> Physics:
    return replace(physics, gain=physics.gain * factor)


def _current_lag(physics: Physics, time: float) -> Physics:
    return replace(physics, lag=physics.lag + time)


def _supply_sag(physics: Physics, drop: float) -> Physics:
    return replace(physics, sag=physics.sag + drop)


def _voltage_limit(physics: Physics, voltage: float) -> Physics:
    return replace(physics, voltage=min(physics.voltage, voltage))


def _delay(physics: Physics, time: float) -> Physics:
    return replace(physics, delay=physics.delay + time)


def _speed_filter(physics: Physics, time: float) -> Physics:
    return replace(physics, speed_filter=physics.speed_filter + time)


def _encoder_ripple(physics: Physics, amplitude: float, phase: float) -> Physics:
    return replace(physics, encoder_ripple=physics.encoder_ripple + amplitude, encoder_phase=phase)


def _backlash(physics: Physics, half_gap: float) -> Physics:
    return replace(physics, half_gap=physics.half_gap + half_gap)


def _mass(physics: Physics, extra: float) -> Physics:
    return replace(physics, mass=physics.mass + extra)


_LIST = (
    PhysicsEffect(
        name="viscous",
        family="friction",
        physics="Grease and seals resist the carriage in proportion to its speed.",
        parameters=(
            EffectParameter(
                "coefficient", "N*s/m", low=0.0, high=800.0, nominal=0.0, prior="half-normal, 150 N*s/m"
            ),
        ),
        apply=_viscous,
    ),
    PhysicsEffect(
        name="coulomb",
        family="friction",
        physics="Dry friction of this force opposes any motion, and holds the carriage at rest.",
        parameters=(
            EffectParameter("force", "N", low=0.0, high=80.0, nominal=0.0, prior="half-normal, 20 N"),
        ),
        apply=_coulomb,
    ),
    PhysicsEffect(
        name="stribeck",
        family="friction",
        physics="Static friction exceeds sliding friction by this force; the excess fades as exp(-(v / speed)^2).",
        parameters=(
            EffectParameter("force", "N", low=0.0, high=80.0, nominal=0.0, prior="half-normal, 20 N"),
            EffectParameter(
                "speed", "m/s", low=0.005, high=0.1, nominal=0.02, prior="log-normal around 0.02, 0.5"
            ),
        ),
        apply=_stribeck,
    ),
    PhysicsEffect(
        name="quadratic_drag",
        family="friction",
        physics="A drag resists the carriage in proportion to its speed squared, as of a fan or of stirred grease.",
        parameters=(
            EffectParameter(
                "coefficient",
                "N*s^2/m^2",
                low=0.0,
                high=4000.0,
                nominal=0.0,
                prior="half-normal, 700 N*s^2/m^2",
            ),
        ),
        apply=_quadratic_drag,
    ),
    PhysicsEffect(
        name="load_friction",
        family="friction",
        physics="The friction of the screw grows in proportion to the force that it transmits.",
        parameters=(
            EffectParameter("coefficient", "", low=0.0, high=0.5, nominal=0.0, prior="half-normal, 0.1"),
        ),
        apply=_load_friction,
    ),
    PhysicsEffect(
        name="offset",
        family="load",
        physics="A constant force opposes positive motion: the axis is not level, or the drive has a bias.",
        parameters=(EffectParameter("force", "N", low=-60.0, high=60.0, nominal=0.0, prior="normal, 10 N"),),
        apply=_offset,
    ),
    PhysicsEffect(
        name="cable",
        family="load",
        physics="A cable chain pulls the carriage towards the middle of the axis like a spring.",
        parameters=(
            EffectParameter(
                "stiffness", "N/m", low=0.0, high=1000.0, nominal=0.0, prior="half-normal, 200 N/m"
            ),
        ),
        apply=_cable,
    ),
    PhysicsEffect(
        name="mass",
        family="inertia",
        physics="The moving mass, without the payload, is larger than in the drawing.",
        parameters=(
            EffectParameter("extra", "kg", low=-30.0, high=60.0, nominal=0.0, prior="normal, 12 kg"),
        ),
        apply=_mass,
    ),
    PhysicsEffect(
        name="motor_gain",
        family="actuation",
        physics="The drive's force per volt is this factor times the manufacturer's figure.",
        parameters=(
            EffectParameter(
                "factor", "", low=0.6, high=1.4, nominal=1.0, prior="normal around 1, standard deviation 0.1"
            ),
        ),
        apply=_motor_gain,
    ),
    PhysicsEffect(
        name="force_ripple",
        family="actuation",
        physics="The magnets of the motor add a force that oscillates four times per turn.",
        parameters=(
            EffectParameter("amplitude", "N", low=0.0, high=60.0, nominal=0.0, prior="half-normal, 12 N"),
            EffectParameter("phase", "rad", low=-3.1416, high=3.1416, nominal=0.0, prior="uniform"),
        ),
        apply=_force_ripple,
    ),
    PhysicsEffect(
        name="current_lag",
        family="actuation",
        physics="The current, and with it the force, follows the voltage with this time constant.",
        parameters=(
            EffectParameter("time", "s", low=0.0, high=0.004, nominal=0.0, prior="half-normal, 0.0015 s"),
        ),
        apply=_current_lag,
    ),
    PhysicsEffect(
        name="supply_sag",
        family="actuation",
        physics="The supply voltage sags under load: at full voltage this share of the force is lost, "
        "and in proportion to the voltage below it.",
        parameters=(EffectParameter("drop", "", low=0.0, high=0.8, nominal=0.0, prior="half-normal, 0.2"),),
        apply=_supply_sag,
    ),
    PhysicsEffect(
        name="voltage_limit",
        family="actuation",
        physics="The drive saturates at this voltage, below the one on its plate.",
        parameters=(
            EffectParameter(
                "voltage", "V", low=1.5, high=10.0, nominal=10.0, prior="10 minus half-normal, 3 V"
            ),
        ),
        apply=_voltage_limit,
    ),
    PhysicsEffect(
        name="delay",
        family="timing",
        physics="The controller's output reaches the drive this much later.",
        parameters=(
            EffectParameter("time", "s", low=0.0, high=0.004, nominal=0.0, prior="half-normal, 0.0015 s"),
        ),
        apply=_delay,
    ),
    PhysicsEffect(
        name="speed_filter",
        family="sensing",
        physics="The drive smooths the speed that it feeds back with this time constant.",
        parameters=(
            EffectParameter("time", "s", low=0.0, high=0.004, nominal=0.0, prior="half-normal, 0.0015 s"),
        ),
        apply=_speed_filter,
    ),
    PhysicsEffect(
        name="encoder_ripple",
        family="sensing",
        physics="The encoder is off its centre: its error has this amplitude and one period per motor turn.",
        parameters=(
            EffectParameter(
                "amplitude", "m", low=0.0, high=1e-4, nominal=0.0, prior="half-normal, 1.5e-05 m"
            ),
            EffectParameter("phase", "rad", low=-3.1416, high=3.1416, nominal=0.0, prior="uniform"),
        ),
        apply=_encoder_ripple,
    ),
    PhysicsEffect(
        name="backlash",
        family="transmission",
        physics="Between two flanks the motor turns without the carriage; the encoder is on the motor's side.",
        parameters=(
            EffectParameter("half_gap", "m", low=0.0, high=5e-4, nominal=0.0, prior="half-normal, 0.0001 m"),
        ),
        apply=_backlash,
    ),
)

CATALOGUE: dict[str, PhysicsEffect] = {effect.name: effect for effect in _LIST}


def world(nominal: Physics, choice: Choice) -> Physics:
    """Return the constants of the axis with these effects."""
    physics = nominal
    for name, values in settings(CATALOGUE.values(), choice).items():
        physics = CATALOGUE[name].apply(physics, **values)
    return physics
