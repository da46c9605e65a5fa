"""Physical constants of the axis.

Figures of the recorded machine: A. Janot, M. Gautier, M. Brunot, "Data set and reference models of EMPS", Workshop on
Nonlinear System Identification Benchmarks, 2019. The nominal axis has no friction.
"""

from __future__ import annotations

from dataclasses import dataclass

RATE = 1000
"""Rate of the controller, of the samples and of the physics [Hz]."""
STEP = 1.0 / RATE
"""Duration of a tick [s]."""
KP = 160.18
"""Position gain: reference speed per position error [1/s]."""
KV = 243.45
"""Speed gain: voltage per speed error [V*s/m]."""
GAIN = 35.15065188
"""The drive's force per volt, from the manufacturer [N/V]."""
VOLTAGE = 10.0
"""Voltage at which the drive saturates [V]."""
MIDDLE = 0.12
"""Middle of the axis [m], whose carriage travels from about 0 to 0.25 m."""
LEAD = 0.02
"""Travel of the carriage per turn of the motor [m]. Our figure: the data set does not give one."""
MOTOR_SHARE = 0.3
"""Share of the moving mass that turns with the motor instead of sliding with the carriage. Our figure."""


@dataclass(frozen=True)
class Physics:
    """The constants that effects change; the defaults are those of the nominal simulator.

    With position q [m], speed v, the drive's force F and mass M the axis obeys
    M dv/dt = F − viscous v − drag v|v| − cable (q − middle) − offset − dry friction.
    """

    mass: float = 95.0
    """Mass of carriage and motor, as effective at the carriage [kg]."""
    gain: float = GAIN
    """The drive's force per volt [N/V]."""
    voltage: float = VOLTAGE
    """Voltage at which the drive saturates [V]."""
    viscous: float = 0.0
    """Coefficient of viscous friction [N*s/m]."""
    viscous_direction: float = 0.0
    """Share by which it is larger in positive motion, and smaller in negative motion."""
    drag: float = 0.0
    """Coefficient of quadratic drag [N*s^2/m^2]."""
    coulomb: float = 0.0
    """Dry friction at any speed [N]."""
    stribeck: float = 0.0
    """Additional dry friction at rest [N], which fades as exp(−(v / stribeck_speed)²)."""
    stribeck_speed: float = 0.02
    """Speed scale of that fading [m/s]."""
    load_friction: float = 0.0
    """Dry friction per force that the screw transmits."""
    offset: float = 0.0
    """Constant force against positive motion [N]."""
    cable: float = 0.0
    """Stiffness of the cable chain, which pulls the carriage towards the middle [N/m]."""
    ripple: float = 0.0
    """Amplitude of the motor's force ripple, with four periods per turn [N]."""
    ripple_phase: float = 0.0
    """Phase of the ripple at q = 0 [rad]."""
    delay: float = 0.0
    """Delay between the controller's output and the drive [s]."""
    jitter: float = 0.0
    """Standard deviation of the delay from tick to tick, as a share of it."""
    lag: float = 0.0
    """Time constant of the drive's current [s]."""
    sag: float = 0.0
    """Share of the force that is lost at full voltage; in proportion to the voltage below it."""
    compliance: float = 0.0
    """Travel of the motor relative to the carriage, per force between them [m/N]."""
    half_gap: float = 0.0
    """Half of the play between carriage and motor [m]."""
    speed_filter: float = 0.0
    """Time constant of the drive's filter for the fed-back speed [s]."""
    encoder_ripple: float = 0.0
    """Amplitude of the encoder's error, with one period per turn [m]."""
    encoder_phase: float = 0.0
    """Phase of that error at q = 0 [rad]."""
