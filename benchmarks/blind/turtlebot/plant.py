"""The plant: two wheels with speeds of their own, in steps of 1 ms."""

from __future__ import annotations

from math import cos, exp, inf, sin
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SUB = 20
"""Definition: steps of the plant in one period of the controller."""
H = 1e-3
"""Definition: step of the plant [s]."""
AXLE = 0.16
"""Definition: distance between the wheels in the drawing [m], with which the wheels' commands are computed."""
TYRE = 0.033
"""Definition: radius of a wheel [m]; a wheel that is out of round shows once a turn."""
JAM, SHOVE, PATCH = 0.6, 0.2, 0.1
"""Definition: how long a wheel jams [s] and a shove lasts [s], and half the length of a slippery patch [m]."""


class Numbers(NamedTuple):
    """One machine; its defaults are a machine without effects and instruments without errors."""

    # The catalogue's members, in other laws and in the catalogue's units.
    position_bias: float = 0.0
    heading_bias: float = 0.0
    latency: float = 0.0
    speed_limit: float = 1.0
    motor_lag: float = 0.0
    wheel_radius: float = 1.0
    uneven_wheels: float = 0.0
    axle_length: float = 1.0
    turning_slip: float = 0.0
    # A member with another law.
    square_slip: float = 0.0
    """[s²/m²] Share of its speed that a wheel loses, for every square of its speed."""
    acceleration_limit: float = inf
    """[m/s²] of a wheel."""
    turning_delay: float = 0.0
    """[s] of the turning command alone."""
    growing_delay: float = 0.0
    """[s] after 4 s, and in proportion before."""
    weak_wheel: float = 1.0
    """[m/s] Speed limit of the left wheel alone."""
    braking_lag: float = 0.0
    """[s] Time constant of a wheel that slows down."""
    heading_drift: float = 0.0
    """[rad/s] of the robot's estimate of its heading."""
    lever: float = 0.0
    """[m] by which the point that the robot takes for its axle lies ahead of it."""
    weakening: float = 0.0
    """Share of their speed that both wheels have lost after 4 s, and in proportion before."""
    # What the catalogue does not have.
    floor_drift: float = 0.0
    """[m/s] to the left."""
    estimate_jump: float = 0.0
    """[m] to the left, of the robot's estimate of its position past ``place``."""
    lost_frames: float = 0.0
    """[1/s] Rate of bursts of 0.3 s in which the robot keeps its last estimate."""
    wheel_jam: float = 0.0
    """Share of its speed that the right wheel loses, from ``since`` on."""
    heading_step: float = 0.0
    """[rad] by which somebody turns the robot at ``since``."""
    stall: float = 0.0
    """[s] for which both wheels stand, from ``since`` on."""
    shove: float = 0.0
    """[m] by which somebody pushes the robot to the left, from ``since`` on."""
    slippery_patch: float = 0.0
    """Share of their speed that both wheels lose around ``place``."""
    dead_zone: float = 0.0
    """[m/s] A wheel stands if its command is slower."""
    # Which other law.
    place: float = 0.0
    """[m] along x."""
    since: float = 0.0
    """[s]"""
    jitter: float = 0.0
    """Standard deviation of a message's delay, as a share of the delay."""
    gamma: float = 0.0
    """1: delays have a gamma distribution; 0: a uniform one."""
    grain: float = 1.0
    """[ms] Messages arrive at multiples of it."""
    first_stage: float = 1.0
    """Share of the lag in the first of two stages; at 1 the wheels' loop is of first order."""
    rounding: float = 12.0
    """Exponent of the soft limit; a hard limit has infinity."""
    out_of_round: float = 0.0
    """Share of uneven wheels that varies over one turn of a wheel."""
    relaxation: float = 0.03
    """[m] that a tyre rolls until its slip has built up."""
    wander: float = 0.0
    """Share by which a bias of the estimate varies over 5 s."""
    # The instruments and the floor.
    position_noise: float = 0.0
    """[m]"""
    heading_noise: float = 0.0
    """[rad]"""
    fed: float = 0.0
    """1: the robot has its pose from the tracker that is logged; 0: it has an estimate of its own."""
    frame: float = 1.0
    """[ms] between two frames of the tracker."""
    slip_noise: float = 0.0
    """[√s] Standard deviation of the relative error of the wheels' speed, averaged over one second."""
    colour: float = 0.05
    """[s] Time constant of that error."""


@njit(cache=True)
def _kept(time):
    """Return the share of a difference that is left after one step."""
    return exp(-H / time) if time > 1e-6 else 0.0


@njit(cache=True)
def _wheel(left, command, t, stages, p):
    """Advance the loop of one wheel; return its speed [m/s] for a command [m/s]."""
    if abs(command) < p.dead_zone or p.since <= t < p.since + p.stall:
        command = 0.0
    limit = min(p.speed_limit, p.weak_wheel) if left else p.speed_limit
    command = command / (1.0 + abs(command / limit) ** p.rounding) ** (1.0 / p.rounding)
    extra = p.braking_lag if abs(command) < abs(stages[1]) else 0.0
    stages[0] = command + _kept(p.first_stage * p.motor_lag + extra) * (stages[0] - command)
    wanted = stages[0] + _kept((1.0 - p.first_stage) * p.motor_lag) * (stages[1] - stages[0])
    most = p.acceleration_limit * H
    stages[1] += min(max(wanted - stages[1], -most), most)
    jammed = not left and p.since <= t < p.since + JAM
    return stages[1] * (1.0 - p.wheel_jam) if jammed else stages[1]


@njit(cache=True)
def _rolled(left, speed, t, x, turned, p):
    """Return the speed of one wheel over the ground [m/s]."""
    share = p.uneven_wheels * (1.0 + p.out_of_round * sin(turned))
    ground = speed * p.wheel_radius * exp(-share if left else share)
    ground *= 1.0 - p.weakening * min(t / 4.0, 1.0)
    if abs(x - p.place) < PATCH:
        ground *= 1.0 - p.slippery_patch
    return ground * (1.0 - min(p.square_slip * ground * ground, 0.5))


@njit(cache=True)
def advance(state, tick, sent, newest, slips, p, path):
    """Advance the plant over one period of the controller.

    Args:
        state: (11,) x, y, heading, two stages of the right wheel's loop and of the left one's, the turned angles of
            both wheels [rad], and the speeds with which their tyres slip [m/s]; changed.
        tick: number of the period.
        sent: (ticks, 2) commanded speed [m/s] and turning rate [rad/s].
        newest: (2, steps) number of the newest message for either at the wheels, −1 before the first.
        slips: (2, steps) relative error of the speed, error of the turning rate [rad/s].
        p: the machine.
        path: (steps + 1, 3) pose after every step; changed.
    """
    ground = np.zeros(2)
    for step in range(SUB * tick, SUB * (tick + 1)):
        t = step * H
        v = sent[newest[0, step], 0] if newest[0, step] >= 0 else 0.0
        w = sent[newest[1, step], 1] if newest[1, step] >= 0 else 0.0
        for i in range(2):
            command = v + (0.5 - i) * AXLE * w
            speed = _wheel(i == 1, command, t, state[3 + 2 * i : 5 + 2 * i], p)
            state[7 + i] += H * speed / TYRE
            ground[i] = _rolled(i == 1, speed, t, state[0], state[7 + i], p)
        middle = 0.5 * (ground[0] + ground[1])
        grown = 1.0 - exp(-H * abs(middle) / p.relaxation)
        rate = (ground[0] - ground[1]) / AXLE
        for i in range(2):
            state[9 + i] += grown * (abs(ground[i]) - state[9 + i])
            ground[i] = middle + (ground[i] - middle) / (1.0 + p.turning_slip * state[9 + i])
        # The contact of a wide wheel moves outwards in a sharp turn, so that the axle's error grows with the rate.
        axle = AXLE * (1.0 + (p.axle_length - 1.0) * (0.85 + 0.3 * abs(rate) / (1.0 + abs(rate))))
        forward = 0.5 * (ground[0] + ground[1]) * (1.0 + slips[0, step])
        turn = H * ((ground[0] - ground[1]) / axle + slips[1, step])
        if t <= p.since < t + H:
            turn += p.heading_step
        aside = p.floor_drift + (p.shove / SHOVE if p.since <= t < p.since + SHOVE else 0.0)
        state[0] += H * forward * cos(state[2] + 0.5 * turn)
        state[1] += H * (forward * sin(state[2] + 0.5 * turn) + aside)
        state[2] += turn
        path[step + 1] = state[:3]
