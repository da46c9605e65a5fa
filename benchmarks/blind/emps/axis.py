"""Another axis: the same machine as in s2r_emps, by another code path, for data whose causes are withheld.

Nothing here is shared with the simulator that is under diagnosis but the test
(its reference) and the controller, which is the system under test. What differs:

- Runge-Kutta of fourth order at 0.25 ms instead of steps of 1 ms;
- motor and carriage are two bodies, joined by a stiff spring with damping, with
  a dead zone for play, instead of one body or an inelastic impact;
- dry friction is tanh of the speed, or a bristle that bends before it slides
  (Dahl), instead of a clamp; Stribeck's fall is Lorentzian instead of Gaussian;
- the current answers in second order, the command waits in a queue with jitter,
  the supply is a capacitor behind a resistance, saturation is smooth, ripples
  have a second harmonic, the cable hardens, drag and viscosity are a little lopsided, and the
  screw hardly rubs under a small load;
- the encoder has a resolution; the run-to-run disturbance is a sum of sines.

All rollouts of a batch advance together: every number below is one a rollout.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from math import pi

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.emps.machine import (
    CENTRE,
    STEP,
    SUBSTEPS,
    TICK,
    Machine,
    Nuisance,
    arrivals,
    missing,
    sines,
)

FloatArray = NDArray[np.float64]

KP, KV, GTAU = 160.18, 243.45, 35.15065188
"""The controller's gains, and the force per volt with which the drive reckons."""
_H = STEP
_SCREW = 2 * pi / 0.02
_STIFFNESS, _DAMPING = 4e7, 3.5e4
"""[N/m], [N*s/m] of the drive train: 230 Hz between motor and carriage."""
_QUANTUM = 1e-7
"""[m] of the encoder."""


def run(
    machines: Sequence[Machine],
    payloads: Sequence[float],
    references: FloatArray,
    powered: NDArray[np.bool_],
    nuisances: Sequence[Nuisance],
    stiffness: float = 1.0,
) -> dict[str, FloatArray]:
    """Run all rollouts at once.

    Args:
        machines: one a rollout.
        payloads: one a rollout [kg].
        references: (rollouts, ticks) position asked for [m].
        powered: (rollouts, ticks) whether the drive is on.
        nuisances: one a rollout.
        stiffness: factor on the controller's stiffness; its damping follows the square root.

    Returns:
        What the drive logs, (rollouts, ticks) each: q, v, u.
    """
    count, ticks = references.shape
    kp, kv = KP * stiffness**0.5, KV * stiffness**0.5
    p = {f.name: np.array([getattr(m, f.name) for m in machines], dtype=np.float64) for f in fields(Machine)}
    worn = np.array([n.friction for n in nuisances])
    for name in ("viscous", "coulomb", "stribeck", "quadratic", "load_friction"):
        p[name] = p[name] * worn
    load = np.array(payloads) + np.array([n.payload for n in nuisances])
    motor = p["motor_share"] * p["mass"]
    hanging = np.maximum(p["flexible"], 1e-3)
    carriage = p["mass"] - motor + load - np.where(p["flexible"] > 0, hanging, 0.0)
    spring = np.where(p["flexible"] > 0, hanging * (2 * pi * p["frequency"]) ** 2, 0.0)
    dash = 2 * 0.04 * np.sqrt(spring * hanging)
    gain = GTAU * p["gain"] * np.array([n.gain for n in nuisances])
    pushes = np.stack([sines(np.random.default_rng([n.seed, 0]), ticks * SUBSTEPS) for n in nuisances])
    errors = np.stack([np.random.default_rng([n.seed, 1]).normal(size=ticks) for n in nuisances]) * 1.7e-7
    late = np.stack(
        [
            arrivals(np.random.default_rng([n.seed, 2]), ticks, m)
            for n, m in zip(nuisances, machines, strict=True)
        ]
    )
    missed = np.stack(
        [
            missing(np.random.default_rng([n.seed, 3]), ticks, m)
            for n, m in zip(nuisances, machines, strict=True)
        ]
    )

    def encoder(q: FloatArray) -> FloatArray:
        turn = _SCREW * q + p["encoder_phase"]
        return q + p["encoder_ripple"] * (np.sin(turn) + 0.15 * np.sin(2 * turn + 1.0))

    first = references[:, 0] + np.array([n.start for n in nuisances])
    begin = first - (encoder(first) - first)
    state = np.stack([begin, np.zeros(count), begin, np.zeros(count), begin, np.zeros(count)])
    fast = np.zeros(count)  # of the current
    current = np.zeros(count)
    charge = np.ones(count)  # of the supply
    bent = np.zeros(count)  # of the bristle, as a share of where it slides
    slip = np.zeros(count)
    seen = encoder(begin)
    speed = half = np.zeros(count)
    lag_keep = np.where(p["lag"] > 0, np.exp(-2 * _H / np.maximum(p["lag"], 1e-9)), 0.0)
    lag_rate = np.where(p["lag"] > 0, 2 * _H / np.maximum(p["lag"], 1e-9), 0.0)
    # Two stages that together hold a ramp back as long as one stage of this time constant would.
    wait = 0.5 / np.expm1(np.minimum(TICK / np.maximum(p["speed_filter"], 1e-9), 50.0))
    filter_keep = wait / (1 + wait)
    charge_keep = np.exp(-_H / p["supply_time"])
    u = np.zeros(count)
    sent = np.zeros((ticks, count))
    logs = {name: np.zeros((count, ticks)) for name in ("q", "v", "u")}
    rows = np.arange(count)

    for k in range(ticks):
        before = seen
        seen = np.round((encoder(state[0]) + slip + errors[:, k]) / _QUANTUM) * _QUANTUM
        raw = (seen - before) / TICK if k else np.zeros(count)
        half = filter_keep * half + (1 - filter_keep) * raw
        speed = filter_keep * speed + (1 - filter_keep) * half
        wanted = kv * (kp * (references[:, k] - seen) - speed)
        wanted = wanted / (1 + np.abs(wanted / p["limit"]) ** 12) ** (1 / 12)
        u = np.where(missed[:, k], u, np.where(powered[:, k], wanted, 0.0))
        sent[k] = u
        logs["q"][:, k], logs["v"][:, k], logs["u"][:, k] = seen, speed, u
        for j in range(SUBSTEPS):
            step = k * SUBSTEPS + j
            time = step * _H
            command = np.where(late[:, step] < 0, 0.0, sent[late[:, step], rows])
            # Critically damped, exactly over the substep; without a lag it follows at once.
            off, rate = current - command, fast
            mixed = rate + 2 / np.maximum(p["lag"], 1e-9) * off
            current = command + lag_keep * (off + mixed * _H * (lag_rate > 0))
            fast = np.where(p["lag"] > 0, lag_keep * (rate - lag_rate * mixed), 0.0)
            charge = (
                1
                - p["sag"] * np.abs(current) / 10
                + charge_keep * (charge - 1 + p["sag"] * np.abs(current) / 10)
            )
            middle = state[0] + state[1] * _H / 2
            turn = 4 * _SCREW * middle + p["force_phase"]
            force = gain * current * charge * (1 + p["lopsided_gain"] * np.sign(current))
            force = force + p["force_ripple"] * (np.sin(turn) + 0.15 * np.sin(2 * turn + 0.5))
            outside = pushes[:, step] + p["gust"] * ((time >= p["since"]) & (time < p["since"] + 0.3))
            level = (
                p["coulomb"]
                + p["load_friction"] * force * force / (np.abs(force) + 8.0)
                + p["brake"] * (time >= p["since"])
            )
            level = level + p["graded"] * np.maximum(0.0, state[2] - 0.02)
            level = level + p["sticking"] * np.exp(-(((state[2] - p["place"]) / 0.004) ** 2))
            thick = p["viscous"] + p["warming"] * np.exp(-3 * time)

            def slope(
                s: FloatArray,
                force: FloatArray = force,
                outside: FloatArray = outside,
                level: FloatArray = level,
                thick: FloatArray = thick,
                bent: FloatArray = bent,
            ) -> FloatArray:
                qm, vm, ql, vl, qp, vp = s
                apart = qm - ql
                pressed = apart - np.clip(apart, -p["half_gap"], p["half_gap"])
                touch = (np.abs(apart) >= p["half_gap"]) & (apart != 0)
                joint = _STIFFNESS * pressed + _DAMPING * (vm - vl) * touch
                size = np.abs(vl)
                holding = level + p["stribeck"] / (1 + (vl / p["stribeck_speed"]) ** 2)
                holding = holding + p["root_stribeck"] * np.exp(-np.sqrt(size / 0.05))
                shape = np.where(
                    p["bristle"] > 0,
                    np.clip(bent + 300.0 * vl * (1 - bent * bent), -1.2, 1.2),
                    np.tanh(vl / p["creep"]),
                )
                side = 1 + p["lopsided"] * np.tanh(vl / 0.01)
                x = ql - CENTRE
                resist = side * (thick + p["quadratic"] * np.sqrt(vl * vl + 1e-6)) * vl + holding * shape
                resist = (
                    resist + p["cubic"] * vl**3 + p["thinning"] * (size / 0.1) ** 0.4 * np.tanh(vl / 0.002)
                )
                resist = (
                    resist
                    + p["offset"]
                    + p["cable"] * x * (1 + 8 * x * x)
                    + p["one_sided"] * np.maximum(0.0, x)
                )
                away = (ql - p["place"]) / 0.005
                resist = resist + p["bump"] * 1.65 * away * np.exp(-away * away / 2)
                hang = spring * (ql - qp) + dash * (vl - vp)
                return np.stack(
                    [
                        vm,
                        (force - joint) / motor,
                        vl,
                        (joint - resist + outside - hang) / carriage,
                        vp,
                        hang / hanging,
                    ]
                )

            k1 = slope(state)
            k2 = slope(state + _H / 2 * k1)
            k3 = slope(state + _H / 2 * k2)
            k4 = slope(state + _H * k3)
            earlier = state[2]
            state = state + _H / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            vl = state[3]
            ahead = np.sign(vl)
            bent = ahead + (bent - ahead) * np.exp(-np.abs(vl) * _H / p["presliding"])
            slip = slip + p["slipped"] * ((earlier < p["place"]) & (state[2] >= p["place"]))
    return logs
