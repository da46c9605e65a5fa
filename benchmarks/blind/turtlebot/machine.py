"""The real turtlebot of the set: its link, its instruments, and one run of it."""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, pi, sin
from pathlib import Path

import numpy as np
from numpy.random import Generator

from benchmarks.blind.turtlebot.causes import KNOWN, UNKNOWN
from benchmarks.blind.turtlebot.disturbances import TICKS, coloured, messages
from benchmarks.blind.turtlebot.plant import SUB, H, Numbers, advance
from s2r_spec.trace import Trace
from s2r_turtlebot import Constants, command

__all__ = ["KNOWN", "SPEC", "UNKNOWN", "VERSION", "drawn_body", "drawn_nuisance", "drive"]

VERSION = "turtlebot/1"
"""Of this generator; it goes into every label."""
SPEC = Path(__file__).parents[3] / "specs" / "turtlebot.stl"
UNITS = {"x": "m", "y": "m", "heading": "rad", "v": "m/s", "w": "rad/s", "d_goal": "m", "d_obs": "m"}
START = (0.001, 0.001, 0.004)
"""Prior: standard deviation of where the robot is put at first [m, m, rad]."""
BURST = 15
"""Definition: periods for which frames are lost."""


def drawn_body(rng: Generator) -> dict[str, float]:
    """Draw which laws and instruments a machine has, and where and when its effects act."""
    return {
        "place": float(rng.uniform(-0.35, 0.25)),
        "since": float(rng.uniform(0.8, 3.0)),
        "jitter": float(rng.uniform(0.1, 0.4)),
        "gamma": float(rng.integers(2)),
        "grain": float(rng.choice((1, 2, 5))),
        "first_stage": float(rng.choice((1.0, rng.uniform(0.5, 0.8)))),
        "rounding": float(rng.uniform(10.0, 24.0)),
        "out_of_round": float(rng.uniform(0.0, 0.3)),
        "relaxation": float(rng.uniform(0.01, 0.06)),
        "wander": float(rng.uniform(0.0, 0.15)),
        "position_noise": float(np.exp(rng.uniform(np.log(2e-4), np.log(1e-3)))),
        "heading_noise": float(np.exp(rng.uniform(np.log(5e-4), np.log(2e-3)))),
        "fed": float(rng.integers(2)),
        "frame": float(rng.choice((1, 4, 5, 8))),
        "slip_noise": float(rng.uniform(0.08, 0.12)),
        "colour": float(rng.uniform(0.03, 0.1)),
    }


def drawn_nuisance(rng: Generator) -> int:
    """Draw the seed of one run."""
    return int(rng.integers(2**62))


def drive(values: Mapping[str, float], test: Mapping[str, float], nuisance: int) -> Trace:
    """Run one test on a turtlebot with these numbers, known and unknown by name; the others are as in the drawing."""
    p, robot = Numbers(**values), Constants()
    starts, tracker, own, floor, link, camera = (np.random.default_rng([nuisance, k]) for k in range(6))
    logged, seen = (
        rng.normal(size=(TICKS + 1, 3)) * (p.position_noise, p.position_noise, p.heading_noise)
        for rng in (tracker, own)
    )
    lost = np.convolve(camera.random(TICKS) < p.lost_frames * robot.step, np.ones(BURST))[:TICKS] > 0
    newest, slips = messages(link, p), coloured(floor, p)
    state, path = np.zeros(11), np.zeros((SUB * TICKS + 1, 3))
    state[:3] = path[0] = np.array([*robot.start, 0.0]) + starts.normal(size=3) * START
    phase = starts.uniform(-pi, pi)
    ox, oy = test["ox"], test["oy"]
    sent, poses, pose = np.zeros((TICKS, 2)), np.zeros((TICKS + 1, 3)), (*robot.start, 0.0)
    for tick in range(TICKS + 1):
        now = SUB * tick
        poses[tick] = path[now - now % int(p.frame)] + logged[tick]
        if tick == TICKS:
            break
        if not lost[tick]:
            x, y, heading = poses[tick] if p.fed else path[now] + seen[tick]
            pose = estimated(float(x), float(y), float(heading), now * H, phase, p)
        sent[tick] = command(pose, ox, oy, robot)
        advance(state, tick, sent, newest, slips, p, path)
    x, y, heading = poses.T
    v, w = np.vstack([np.zeros((1, 2)), sent]).T
    columns = (x, y, heading, v, w, np.hypot(x - robot.goal[0], y - robot.goal[1]), np.hypot(x - ox, y - oy))
    return Trace(robot.step * np.arange(TICKS + 1.0), dict(zip(UNITS, columns, strict=True)), UNITS)


def estimated(
    x: float, y: float, heading: float, t: float, phase: float, p: Numbers
) -> tuple[float, float, float]:
    """Return the robot's estimate of its pose, from a measured pose [m, m, rad] at a time [s]."""
    wander = 1.0 + p.wander * sin(2.0 * pi * t / 5.0 + phase)
    left = p.position_bias * wander + (p.estimate_jump if x > p.place else 0.0)
    return (
        x + p.lever * cos(heading),
        y + p.lever * sin(heading) + left,
        heading + p.heading_bias * wander + p.heading_drift * t,
    )
