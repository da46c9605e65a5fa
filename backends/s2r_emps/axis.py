"""Simulate the axis: controller, drive and carriage, in ticks of 1 ms.

Dry friction is a set-valued force. In each tick it removes as much momentum as it can and never reverses the motion,
so the carriage comes to a complete rest. A step of 1 ms is short enough for the other forces: the fastest mode of the
loop is 19 Hz.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_emps.laws import RIPPLES, TURN
from s2r_emps.noise import Draws, FloatArray
from s2r_emps.physics import GAIN, KP, KV, MIDDLE, MOTOR_SHARE, STEP, VOLTAGE, Physics
from s2r_spec.compiled import compiled

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class DriveCommand:
    """What the controller does, (ticks,) each.

    Attributes:
        reference: reference position [m].
        closed: whether the controller closes its loop.
        voltage: voltage [V] where it does not; 0 where the drive is off.
    """

    reference: FloatArray
    closed: BoolArray
    voltage: FloatArray

    @classmethod
    def following(cls, reference: FloatArray, powered: BoolArray) -> DriveCommand:
        """Return the command that follows a reference where the drive is on."""
        return cls(reference, powered, np.zeros(reference.size))


@dataclass(frozen=True, eq=False)
class DriveLog:
    """The drive's log, (ticks,) each: position [m], speed [m/s], voltage [V], and nominal force [N]."""

    q: FloatArray
    v: FloatArray
    u: FloatArray
    force: FloatArray

    def part(self, first: int) -> DriveLog:
        """Return the record from this tick on."""
        return DriveLog(self.q[first:], self.v[first:], self.u[first:], self.force[first:])


class _Constants(NamedTuple):
    """The constants of a tick: fields of :class:`~s2r_emps.physics.Physics`, and values that follow from them."""

    mass: float
    viscous: float
    viscous_direction: float
    drag: float
    cable: float
    offset: float
    coulomb: float
    stribeck: float
    load_friction: float
    ripple: float
    ripple_phase: float
    encoder_ripple: float
    encoder_phase: float
    half_gap: float
    compliance: float
    voltage: float
    motor: float
    gain: float
    per_speed: float
    sag: float
    follow: float
    """Step of the drive's current towards its voltage in one tick, as a share of their difference."""
    behind: float
    """Mean lag of the current behind the voltage in one tick, as a share of their difference."""
    smooth: float
    position_gain: float
    speed_gain: float


_OF_PHYSICS = _Constants._fields[:16]


def simulate(
    command: DriveCommand, start: tuple[float, float], physics: Physics, draws: Draws, stiffness: float = 1.0
) -> DriveLog:
    """Simulate the axis under its controller.

    Args:
        command: what the controller does in every tick.
        start: encoder position [m] and speed [m/s] at the first tick.
        physics: the axis, with the test's payload in its mass.
        draws: random numbers of at least as many ticks.
        stiffness: factor on the controller's stiffness KP · KV; its damping KV follows the square root.
    """
    p, h, n = physics, STEP, command.reference.size
    follow = 1 - exp(-h / p.lag) if p.lag else 1.0
    constants = _Constants(
        **{name: float(getattr(p, name)) for name in _OF_PHYSICS},
        motor=float(MOTOR_SHARE * p.mass),
        gain=float(p.gain * draws.gain),
        per_speed=1.0 / p.stribeck_speed,
        sag=float(p.sag / VOLTAGE),
        follow=float(follow),
        behind=float(p.lag / h * follow),
        smooth=float(1 - exp(-h / p.speed_filter) if p.speed_filter else 1.0),
        position_gain=KP * sqrt(stiffness),
        speed_gain=KV * sqrt(stiffness),
    )
    q, speed, volts = _ticks(
        np.ascontiguousarray(command.reference, dtype=np.float64),
        np.ascontiguousarray(command.closed, dtype=np.bool_),
        np.ascontiguousarray(command.voltage, dtype=np.float64),
        (float(start[0]), float(start[1])),
        (np.ascontiguousarray(draws.encoder[:n]), np.ascontiguousarray(draws.disturbance[:n])),
        _delays(n, physics, draws),
        constants,
    )
    return DriveLog(q, speed, volts, GAIN * volts)


def _delays(ticks: int, physics: Physics, draws: Draws) -> FloatArray:
    """Return (ticks,) how many ticks ago the drive's command was sent, at least 0; empty without a delay."""
    p = physics
    if not p.delay:
        return np.empty(0)
    delays = np.full(ticks, p.delay / STEP)
    return delays * np.maximum(0.0, 1.0 + p.jitter * draws.delay[:ticks]) if p.jitter else delays


@compiled
def _ticks(
    reference: FloatArray,
    closed: BoolArray,
    voltage: FloatArray,
    start: tuple[float, float],
    noise: tuple[FloatArray, FloatArray],
    delays: FloatArray,
    p: _Constants,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (ticks,) the encoder position [m], the fed-back speed [m/s] and the commanded voltage [V]."""
    h, carriage, teeth, n = STEP, p.mass - p.motor, RIPPLES * TURN, reference.size
    dry = p.coulomb != 0.0 or p.stribeck != 0.0 or p.load_friction != 0.0
    errors, pushes = noise
    measured, v = start
    positions, speeds, sent = np.empty(n), np.empty(n), np.empty(n)

    # Position of the motor, on whose shaft the encoder sits. An elastic joint is in equilibrium at every tick.
    q = measured - p.encoder_ripple * sin(TURN * measured + p.encoder_phase)
    ql, vl = q, v  # of the carriage; equal to the motor's without play
    measured -= h * v
    speed, current, twist = v, 0.0, 0.0
    for k in range(n):
        before, measured = measured, q + twist + errors[k]
        if p.encoder_ripple != 0.0:
            measured += p.encoder_ripple * sin(TURN * q + p.encoder_phase)
        speed += p.smooth * ((measured - before) / h - speed)
        u = p.speed_gain * (p.position_gain * (reference[k] - measured) - speed) if closed[k] else voltage[k]
        u = p.voltage if u > p.voltage else -p.voltage if u < -p.voltage else u
        positions[k], speeds[k], sent[k] = measured, speed, u
        if delays.size:
            # The voltage is zero until the first command arrives.
            whole = int(delays[k] + 1e-9)
            u = sent[k - whole] if k >= whole else 0.0
            part = delays[k] - whole
            if part > 0.0:
                u += part * ((sent[k - whole - 1] if k > whole else 0.0) - u)
        if p.behind != 0.0:
            u, current = u + p.behind * (current - u), current + p.follow * (u - current)
        force = p.gain * u
        if p.sag != 0.0:
            force -= force * p.sag * abs(u)
        if p.ripple != 0.0:
            force += p.ripple * sin(teeth * q + p.ripple_phase)
        resist = (
            p.viscous * (vl + p.viscous_direction * abs(vl))
            + p.drag * vl * abs(vl)
            + p.cable * (ql - MIDDLE)
            + p.offset
            - pushes[k]
        )
        brake = 0.0
        if dry:
            fading = vl * p.per_speed
            brake = p.coulomb + p.stribeck * exp(-(fading * fading)) + p.load_friction * abs(force)
        if p.half_gap == 0.0:
            new = v + h * (force - resist) / p.mass
            if dry:
                lost = h * brake / p.mass
                new = new - lost if new > lost else new + lost if new < -lost else 0.0
            q += h * (v + new) / 2
            twist = p.compliance * (force - p.motor * (new - v) / h)
            v = vl = new
            ql = q
            continue
        fast, slow = v + h * force / p.motor, vl - h * resist / carriage
        way = q - ql + h * (fast - slow)
        together = (way >= p.half_gap and fast >= slow) or (way <= -p.half_gap and fast <= slow)
        if together:  # the flanks meet without bouncing
            fast = slow = (p.motor * fast + carriage * slow) / p.mass
        if dry:
            lost = h * brake / (p.mass if together else carriage)
            slow = slow - lost if slow > lost else slow + lost if slow < -lost else 0.0
        if together:
            fast = slow
        q += h * (v + fast) / 2
        ql += h * (vl + slow) / 2
        twist = p.compliance * (force - p.motor * (fast - v) / h)
        v, vl = fast, slow
        # An impact ends within a tick: an overlap that remains over ticks would act as a spring.
        if abs(q - ql) > p.half_gap:
            over = q - ql - (p.half_gap if q > ql else -p.half_gap)
            ql += over * p.motor / p.mass
            q -= over * carriage / p.mass
    return positions, speeds, sent
