"""Random quantities of a rollout and their standard deviations: sensors, initial pose, gait phase."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_sim.robot.constants import FloatArray

_DRAWN = (12, 12, 3, 3, 3)
"""Numbers drawn per tick: errors of q, q̇, gyro, attitude, velocity."""
_FIELD = 100.0
"""[m] half the side of the field on which rollouts begin."""
_INSTRUMENTS = {
    **dict.fromkeys(("x", "y", "z", "height"), "capture_position"),
    **dict.fromkeys(("vx", "vy", "vz"), "capture_speed"),
    "foot_position": "foot_position",
    "foot_velocity": "foot_speed",
    "foot_force": "foot_force",
    "tau": "torque",
}
"""Channel → standard deviation of its instrument."""
_AS_STATE = [*range(27, 33), *range(24, 27), *range(24)]
"""Columns of these numbers in the order of ``State.flat``, from ``rpy`` on."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of white normal noise. The rollout's seed alone determines every draw."""

    encoder: float = 0.001
    """[rad] joint angles."""
    joint_speed: float = 0.05
    """[rad/s]"""
    gyro: float = 0.01
    """[rad/s]"""
    attitude: float = 0.002
    """[rad] roll, pitch and yaw."""
    velocity: float = 0.01
    """[m/s] base velocity, world axes; not used where the robot's own estimate is fed back."""
    accelerometer: float = 0.1
    """[m/s²] mean over a tick."""
    initial_height: float = 0.002
    """[m] displacement of the base before the command."""
    initial_attitude: float = 0.01
    """[rad]"""
    initial_joint: float = 0.01
    """[rad]"""
    gait_phase: float = 1.0
    """Fraction of the gait period in which the phase at the command is uniform."""
    capture_position: float = 0.0
    """[m] position and height of the base, by motion capture."""
    capture_speed: float = 0.0
    """[m/s] velocity of the base, likewise."""
    foot_position: float = 0.0
    """[m] positions of the feet, likewise."""
    foot_speed: float = 0.0
    """[m/s] velocities of the feet, likewise."""
    foot_force: float = 0.0
    """[N] forces of force plates."""
    torque: float = 0.0
    """[N m] torques that the drives report."""

    @classmethod
    def off(cls) -> Noise:
        """Return the table of a rollout without randomness."""
        return cls(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Draws:
    """The random numbers of one rollout.

    Attributes:
        phase: gait tick at the command, in [0, period).
        rise: initial rise of the base [m].
        tilt: (3,) initial tilt of the base [rad].
        joints: (12,) initial errors of the joint angles [rad].
        sensors: (ticks, 36) errors of the measured state, in the order of ``State.flat``.
        accelerometer: (ticks, 3) [m/s²].
        ground: position on an uneven ground at which the rollout begins [m].
    """

    phase: int
    rise: float
    tilt: FloatArray
    joints: FloatArray
    sensors: FloatArray
    accelerometer: FloatArray
    ground: tuple[float, float]


def draw(noise: Noise, seed: int, ticks: int, period: int) -> Draws:
    """Draw a rollout's random numbers; a longer rollout starts with those of a shorter one."""
    rng = np.random.default_rng(seed)
    phase = int(rng.uniform() * noise.gait_phase * period) % period
    rise = float(rng.normal()) * noise.initial_height
    tilt = rng.normal(size=3) * noise.initial_attitude
    joints = rng.normal(size=12) * noise.initial_joint
    sensors = sensor_errors(noise, rng, ticks)
    # A second stream: a quantity that was added later must not change the earlier draws.
    rng = np.random.default_rng([seed, 1])
    x, y = rng.uniform(-_FIELD, _FIELD, 2).tolist()
    accelerometer = accelerometer_errors(noise, rng, ticks)
    return Draws(phase, rise, tilt, joints, sensors, accelerometer, (x, y))


def sensor_errors(noise: Noise, rng: np.random.Generator, ticks: int) -> FloatArray:
    """Return (ticks, 36) errors of the measured state, ordered as ``State.flat``; each call continues the stream."""
    scales = (noise.encoder, noise.joint_speed, noise.gyro, noise.attitude, noise.velocity)
    errors = np.zeros((ticks, 36))
    errors[:, 3:] = (rng.normal(size=(ticks, sum(_DRAWN))) * np.repeat(scales, _DRAWN))[:, _AS_STATE]
    return errors


def with_instruments(channels: dict[str, FloatArray], noise: Noise, seed: int) -> dict[str, FloatArray]:
    """Return the channels of a rollout as the instruments of a laboratory measure them."""
    rng = np.random.default_rng([seed, 2])
    measured = dict(channels)
    for name, instrument in _INSTRUMENTS.items():
        deviation = getattr(noise, instrument)
        if deviation:
            measured[name] = channels[name] + deviation * rng.normal(size=channels[name].shape)
    return measured


def accelerometer_errors(noise: Noise, rng: np.random.Generator, ticks: int) -> FloatArray:
    """Return (ticks, 3) errors of the accelerometer [m/s²]; each call continues the stream."""
    return rng.normal(size=(ticks, 3)) * noise.accelerometer
