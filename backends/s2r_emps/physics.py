"""Everything physical about the axis that a number can change.

Figures of the recorded machine: A. Janot, M. Gautier, M. Brunot, "Data set and
reference models of EMPS", Workshop on Nonlinear System Identification
Benchmarks, 2019. The nominal axis has no friction at all.
"""

from __future__ import annotations

from dataclasses import dataclass

RATE = 1000
"""[Hz] of the controller, of the samples and of the physics."""
STEP = 1.0 / RATE
"""[s]"""
KP = 160.18
"""[1/s] position gain: speed asked for per position error."""
KV = 243.45
"""[V*s/m] speed gain: voltage per speed error."""
GAIN = 35.15065188
"""[N/V] the drive's force per volt, as the manufacturer gives it."""
VOLTAGE = 10.0
"""[V] at which the drive saturates."""
MIDDLE = 0.12
"""[m] of the axis, whose carriage travels from about 0 to 0.25 m."""
LEAD = 0.02
"""[m] travel of the carriage per turn of the motor. Our figure: the data set does not give one."""
MOTOR_SHARE = 0.3
"""Of the moving mass, what turns with the motor rather than sliding with the carriage. Our figure."""


@dataclass(frozen=True)
class Physics:
    """The table that effects change; its defaults are the nominal simulator.

    With position q [m], speed v, the drive's force F and mass M the axis obeys
    M dv/dt = F − viscous v − drag v|v| − cable (q − middle) − offset − dry friction.
    """

    mass: float = 95.0
    """[kg] carriage and motor, as felt at the carriage."""
    gain: float = GAIN
    """[N/V]"""
    voltage: float = VOLTAGE
    """[V] at which the drive saturates."""
    viscous: float = 0.0
    """[N*s/m]"""
    drag: float = 0.0
    """[N*s^2/m^2]"""
    coulomb: float = 0.0
    """[N] dry friction at any speed."""
    stribeck: float = 0.0
    """[N] dry friction on top of it at rest, which fades as exp(−(v / stribeck_speed)²)."""
    stribeck_speed: float = 0.02
    """[m/s]"""
    load_friction: float = 0.0
    """Dry friction per force that the screw transmits."""
    offset: float = 0.0
    """[N] constant force against positive motion."""
    cable: float = 0.0
    """[N/m] stiffness of what pulls the carriage towards the middle."""
    ripple: float = 0.0
    """[N] amplitude of the motor's force over its position, four times a turn."""
    ripple_phase: float = 0.0
    """[rad] of it at q = 0."""
    delay: float = 0.0
    """[s] between the controller's output and the drive."""
    lag: float = 0.0
    """[s] time constant of the drive's current."""
    sag: float = 0.0
    """Part of the force that is lost at full voltage; in proportion to the voltage below it."""
    compliance: float = 0.0
    """[m/N] by which the motor turns further than the carriage moves, per force between them."""
    half_gap: float = 0.0
    """[m] by which the carriage can be away from the middle of the play between it and the motor."""
    speed_filter: float = 0.0
    """[s] time constant with which the drive smooths the speed it feeds back."""
    encoder_ripple: float = 0.0
    """[m] amplitude of the encoder's error, once a turn."""
    encoder_phase: float = 0.0
    """[rad] of it at q = 0."""
