"""The axis in motion: controller, drive and carriage, one tick of 1 ms after the other.

Dry friction is a set-valued force: in each tick it takes away as much momentum as
it can, but never reverses the motion, so the carriage really stands still. Steps
of 1 ms are short enough for the rest: the fastest mode of the loop is 19 Hz.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, sin

import numpy as np
from numpy.typing import NDArray

from s2r_emps.laws import RIPPLES, TURN
from s2r_emps.noise import Draws, FloatArray
from s2r_emps.physics import GAIN, KP, KV, MIDDLE, MOTOR_SHARE, STEP, VOLTAGE, Physics

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Record:
    """What the drive logs, (ticks,) each: position [m], speed [m/s], voltage [V], force as it believes [N]."""

    q: FloatArray
    v: FloatArray
    u: FloatArray
    force: FloatArray


def simulate(
    reference: FloatArray, powered: BoolArray, start: tuple[float, float], physics: Physics, draws: Draws
) -> Record:
    """Follow a reference.

    Args:
        reference: (ticks,) position asked for [m].
        powered: (ticks,) bool: whether the drive is on.
        start: position by the encoder [m] and speed [m/s] at the first tick.
        physics: the axis, with the test's payload in its mass.
        draws: of at least as many ticks.
    """
    p = physics
    h, mass, gain, limit = STEP, p.mass, p.gain * draws.gain, p.voltage
    viscous, drag, cable, offset = p.viscous, p.drag, p.cable, p.offset
    coulomb, stribeck, per_speed, screw = p.coulomb, p.stribeck, 1 / p.stribeck_speed, p.load_friction
    dry = bool(coulomb or stribeck or screw)
    ripple, phase, teeth = p.ripple, p.ripple_phase, RIPPLES * TURN
    wobble, turned, sag = p.encoder_ripple, p.encoder_phase, p.sag / VOLTAGE
    follow = 1 - exp(-h / p.lag) if p.lag else 1.0
    behind = p.lag / h * follow  # the current's distance from the voltage, on average over a tick
    smooth = 1 - exp(-h / p.speed_filter) if p.speed_filter else 1.0
    whole = int(p.delay / h + 1e-9)
    part = max(0.0, p.delay / h - whole)
    gap = p.half_gap
    motor = MOTOR_SHARE * p.mass
    carriage = mass - motor
    yields, twist = p.compliance, 0.0

    # Of the motor, on whose shaft the encoder sits. A joint that yields is taken to be in balance at every tick.
    seen, v = start
    q = seen - wobble * sin(TURN * seen + turned)
    ql, vl = q, v  # of the carriage; without play they are one
    seen -= h * v
    speed = v
    current = 0.0
    sent: list[float] = []
    positions: list[float] = []
    speeds: list[float] = []
    exp_, sin_ = exp, sin
    for k, (asked, on, error, push) in enumerate(_ticks(reference, powered, draws)):
        before, seen = seen, q + twist + error
        if wobble:
            seen += wobble * sin_(TURN * q + turned)
        speed += smooth * ((seen - before) / h - speed)
        u = KV * (KP * (asked - seen) - speed) if on else 0.0
        u = limit if u > limit else -limit if u < -limit else u
        positions.append(seen)
        speeds.append(speed)
        sent.append(u)
        if whole or part:
            u = sent[k - whole] if k >= whole else sent[0]
            if part:
                u += part * ((sent[k - whole - 1] if k > whole else sent[0]) - u)
        if behind:
            u, current = u + behind * (current - u), current + follow * (u - current)
        force = gain * u
        if sag:
            force -= force * sag * abs(u)
        if ripple:
            force += ripple * sin_(teeth * q + phase)
        resist = viscous * vl + drag * vl * abs(vl) + cable * (ql - MIDDLE) + offset - push
        brake = 0.0
        if dry:
            brake = coulomb + stribeck * exp_(-((vl * per_speed) ** 2)) + screw * abs(force)
        if not gap:
            new = v + h * (force - resist) / mass
            if dry:
                lost = h * brake / mass
                new = new - lost if new > lost else new + lost if new < -lost else 0.0
            q += h * (v + new) / 2
            twist = yields * (force - motor * (new - v) / h)
            v = vl = new
            ql = q
            continue
        fast, slow = v + h * force / motor, vl - h * resist / carriage
        way = q - ql + h * (fast - slow)
        together = (way >= gap and fast >= slow) or (way <= -gap and fast <= slow)
        if together:  # flanks meet without bouncing
            fast = slow = (motor * fast + carriage * slow) / mass
        if dry:
            lost = h * brake / (mass if together else carriage)
            slow = slow - lost if slow > lost else slow + lost if slow < -lost else 0.0
        if together:
            fast = slow
        q += h * (v + fast) / 2
        ql += h * (vl + slow) / 2
        twist = yields * (force - motor * (fast - v) / h)
        v, vl = fast, slow
        # An impact lies within a tick; the sum of the overlap over ticks would be a spring that is not there.
        if abs(q - ql) > gap:
            over = q - ql - (gap if q > ql else -gap)
            ql += over * motor / mass
            q -= over * carriage / mass
    volts = np.array(sent)
    return Record(np.array(positions), np.array(speeds), volts, GAIN * volts)


def _ticks(
    reference: FloatArray, powered: BoolArray, draws: Draws
) -> Sequence[tuple[float, bool, float, float]]:
    """Return what comes from outside at every tick, as Python's numbers: an array's own are slow one by one."""
    n = reference.size
    return list(
        zip(
            reference.tolist(),
            powered.tolist(),
            draws.encoder[:n].tolist(),
            draws.disturbance[:n].tolist(),
            strict=True,
        )
    )
