"""Runs of a machine: the trot of the specification, and the excitation protocols."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import cos, exp, isfinite, radians, sin, sqrt, tan
from typing import Protocol

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import lfilter

from benchmarks.plants.machine import Machine
from benchmarks.plants.robot import (
    A1,
    CHANNELS,
    FALL,
    RATE,
    Memory,
    MotorCommand,
    RobotState,
    Tick,
    VelocityCommand,
    controller,
    logger,
    reference,
    replay,
    specific_force,
)
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

PERIOD = 200
"""Definition: control ticks of a gait period."""
WARM_UP = 500
"""Definition: control ticks of trotting in place before a run's own gait phase; as many as in the simulator."""
SETTLING = 100
"""Definition: control ticks of trotting in place after that. The robot's own estimate of its velocity starts there."""
HELD = 200
"""Definition: control ticks for which a protocol holds its first pose."""
TOUCH = 1.0
"""Definition: force [N] at which a contact switch closes."""
DISPLACED = 0.005
"""Definition: standard deviation of the joint angles at the start of a protocol [rad]."""
WALK_ONLY = frozenset(
    ("vx_cmd", "vy_cmd", "wz_cmd", "vx_est", "vy_est", "acc_pred", "qp_iterations", "qp_solved", "stance")
)
"""Definition: channels of a trot that a protocol does not have."""
UNITS = {channel.name: channel.unit for channel in CHANNELS}


class Senses(Protocol):
    """The sensors of one run; their noise is drawn once."""

    def read(self, truth: FloatArray, encoders: FloatArray) -> FloatArray:
        """Return (36,) what the robot measures, ordered as ``RobotState.flat``; the velocity has no bias."""
        ...

    def accelerometer(self, ticks: int) -> FloatArray:
        """Return (ticks, 3) errors of the accelerometer [m/s²]."""
        ...

    def instrument(self, ticks: int, width: int, deviation: float) -> FloatArray:
        """Return (ticks, width) errors of the laboratory's instruments, with this standard deviation."""
        ...


class Body(Protocol):
    """Robot and ground of one author."""

    instruments: Mapping[str, float]
    """Channel → standard deviation of the laboratory's instruments, in the channel's unit."""

    def place(self, height: float, q: FloatArray) -> None:
        """Put the robot at rest, level, with its base at this height [m]."""
        ...

    def truth(self) -> FloatArray:
        """Return (36,) the true state, ordered as ``RobotState.flat``."""
        ...

    def encoders(self) -> FloatArray:
        """Return (24,) angles [rad] and speeds [rad/s] that the drives read."""
        ...

    def step(self, motors: MotorCommand) -> None:
        """Run one control tick of 2 ms."""
        ...

    def reported(self) -> FloatArray:
        """Return (12,) torque that the drives report of the last tick [N m]."""
        ...

    def foot_force(self) -> FloatArray:
        """Return (12,) force of the ground on the feet in the last tick [N], world axes."""
        ...


@dataclass(frozen=True)
class Author:
    """What an author wrote: a body, and its sensors.

    Attributes:
        name: name of the plant.
        body: machine, whether a rig holds the base, random numbers → body.
        senses: machine, random numbers, ticks → sensors.
    """

    name: str
    body: Callable[[Machine, bool, Generator], Body]
    senses: Callable[[Machine, Generator, int], Senses]


@dataclass
class _Run:
    """One run as it goes on."""

    machine: Machine
    body: Body
    senses: Senses
    command: VelocityCommand

    def __post_init__(self) -> None:
        self.log = logger(self.command, self.machine["slope.angle"])
        self.truths: list[FloatArray] = []
        self.measured: list[FloatArray] = []
        self.stance: list[tuple[bool, ...]] = []
        self.ticks = 0

    def look(self) -> RobotState:
        """Return what the controller is given."""
        truth = self.body.truth()
        measured = self.senses.read(truth, self.body.encoders())
        self.truths.append(truth)
        self.measured.append(measured.copy())
        measured[6:8] = _distorted(self.machine, measured[6:8], truth[5])
        return RobotState(measured)

    def fallen(self) -> bool:
        """Return whether the base is too low or too tilted at the last look."""
        x, _, z, roll, pitch = self.truths[-1][:5].tolist()
        height = z - tan(radians(self.machine["slope.angle"])) * x
        if not (isfinite(height) and isfinite(roll) and isfinite(pitch)):
            return True
        return height < FALL.height or cos(roll) * cos(pitch) < cos(FALL.tilt)

    def write(self, seen: RobotState, done: Tick) -> None:
        """Log the tick that has just been run."""
        self.ticks += 1
        self.log.write(RobotState(self.truths[-1]), seen, done, self.body.reported(), self.body.foot_force())

    def trace(self, fallen: bool, plant: str, protocol: str | None) -> Trace:
        """Return the trace of what was logged."""
        n = self.ticks
        channels = self.log.channels(self._estimate()[-n:], fallen)
        force = channels["foot_force"].reshape(n, -1)
        channels["contact"] = (force[:, 2::3] > TOUCH).astype(float)
        for name, deviation in self.body.instruments.items():
            values = channels[name]
            errors = self.senses.instrument(n, values.reshape(n, -1).shape[1], deviation * self.machine.noise)
            channels[name] = values + errors.reshape(values.shape)
        meta = {"source": f"twin of an A1, {plant}"} | ({"failure": "fall"} if fallen else {})
        if protocol is not None:
            channels = {name: values for name, values in channels.items() if name not in WALK_ONLY}
            meta["protocol"] = protocol
        return Trace(np.arange(n) / RATE, channels, units={name: UNITS[name] for name in channels}, meta=meta)

    def _estimate(self) -> FloatArray:
        """Return the robot's own estimate of its velocity [m/s], world axes, over settling and run."""
        n = min(len(self.truths), SETTLING + self.ticks)
        truth = RobotState(np.array(self.truths[-n:]).T)
        measured = RobotState(np.array(self.measured[-n:]).T)
        change = np.diff(truth.velocity, axis=1, prepend=truth.velocity[:, :1])
        noise = self.senses.accelerometer(n).T
        force = specific_force(truth.rpy, list(change), noise, np.sin, np.cos)
        own = replay(A1, measured, force, np.array(self.stance[-n:], dtype=float).T)
        own[:, :2] = _distorted(self.machine, own[:, :2].T, measured.rpy[2], np.sin, np.cos).T
        return own


def trot(author: Author, machine: Machine, vd: float, rng: Generator, duration: float = 1.5) -> Trace:
    """Run the specification's test: the forward velocity command [m/s] steps from zero at t = 0."""
    warm = WARM_UP + int(rng.integers(PERIOD)) + SETTLING
    ticks = round(duration * RATE) + 1
    machine = machine.of_today(rng)
    body = author.body(machine, False, rng)
    command = VelocityCommand(vd)
    run = _Run(machine, body, author.senses(machine, rng, warm + ticks), command)
    brain = controller()
    brain.restore(Memory())
    start(body)
    fallen = False
    for tick in range(-warm, ticks):
        seen = run.look()
        run.stance.append(brain.stance)
        fallen = run.fallen()
        done = brain.tick(seen, command if tick >= 0 else VelocityCommand())
        body.step(done.motors)
        if tick < 0 and not fallen:
            continue
        run.write(seen, done)
        if fallen:
            break
    return run.trace(fallen, author.name, None)


def start(body: Body) -> None:
    """Put the robot on its feet, as the trot begins."""
    bend = np.arccos(0.26 / (A1.thigh_length + A1.calf_length))
    body.place(0.28, np.tile([0.0, bend, -2.0 * bend], 4))


def run(
    author: Author, machine: Machine, protocol: str, rng: Generator, amplitude: float = 1.0, gain: float = 1.0
) -> Trace:
    """Run one of the excitation protocols of the A1; in the air the base is fixed and level."""
    made = reference(protocol, amplitude, gain)
    ticks = len(made.q)
    machine = machine.of_today(rng)
    body = author.body(machine, made.held, rng)
    one = _Run(machine, body, author.senses(machine, rng, HELD + ticks), VelocityCommand())
    body.place(made.height, made.q[0] + DISPLACED * rng.normal(size=12))
    ones, none = np.ones(12), np.zeros(12)
    stance = (True,) * 4
    fallen = False
    for tick in range(-HELD, ticks):
        now = max(tick, 0)
        speed = made.dq[now] if tick >= 0 else none
        motors = MotorCommand(made.q[now], speed, made.kp[now] * ones, made.kd[now] * ones, none)
        seen = one.look()
        one.stance.append(stance)
        body.step(motors)
        fallen = not made.held and one.fallen()
        if tick < 0 and not fallen:
            continue
        one.write(seen, Tick(motors, stance, None))
        if fallen:
            break
    return one.trace(fallen, author.name, protocol)


def _distorted(
    machine: Machine,
    velocity: FloatArray,
    yaw: float | FloatArray,
    sine: Callable = sin,
    cosine: Callable = cos,
) -> FloatArray:
    """Return (2, …) a velocity [m/s], world axes, with the errors of scale and bias."""
    scale = machine["velocity_scale.factor"]
    forward, left = machine["velocity_bias.forward"], machine["velocity_bias.left"]
    c, s = cosine(yaw), sine(yaw)
    x, y = velocity
    return np.array([scale * x + c * forward - s * left, scale * y + s * forward + c * left])


def carried(white: FloatArray, time: float) -> FloatArray:
    """Return (ticks, width) of a first-order Gauss–Markov process with unit variance and this correlation time [s].

    ``white`` (ticks, width) is unit normal noise, one sample a control tick.
    """
    keep = exp(-1.0 / (RATE * time))
    drive = sqrt(1.0 - keep**2) * white
    drive[0] = white[0]
    return lfilter([1.0], [1.0, -keep], drive, axis=0)
