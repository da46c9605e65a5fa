"""Protocols of a held robot: motions of all joints that are driven to positions, from the ranges of the joints.

    joint_sine   c + A (½ (f₀/f) sin ∫2πf + ½ sin 2πf₀gt)   f: from f₀ to the rate, in proportion to time
    steps        c, c + S, c, c − S, …                       every second joint later by half a step
    hold         five poses between c − A and c + A          each a second of motion and a second of rest
    coast        c + A s, motors off after 0.5 s             the joints fall to rest

c is the default pose, moved into the middle three fifths of the range. A is the least of two fifths of the range, and
of what 30 % of the joint's torque accelerates. S is also at most what 30 % of the torque does to the gain.

Units: rad and m, s, Hz. Shapes: n ticks, k joints in the order of the model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from s2r_mujoco.arrays import FloatArray
from s2r_spec.backend import Parameter
from s2r_spec.protocols import Protocol

PART = 0.4
"""Definition: largest amplitude, as a part of a joint's range."""
LOAD = 0.3
"""Definition: part of a joint's torque that the motion itself may take; the rest is for gravity and friction."""
SLOW = 0.25
"""Definition: lowest frequency of a sine [Hz]."""
GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0
"""Definition: turns between the phases of one joint and the next, so that no two move alike."""
FREE = {True: 0.25, False: np.pi}
"""Definition: range of a joint without limits, if it slides [m], and else [rad]."""
STEP, POSES, MOVE, ON = 1.0, (0.0, 1.0, -1.0, 0.5, -0.5), 1.0, 0.5
"""Definition: time of a step [s]; poses of ``hold`` in amplitudes, and time of a move [s]; time before the fall [s]."""


@dataclass(frozen=True)
class Motion:
    """Targets at every control tick: (n, k) positions, and (n,) whether the motors are on."""

    targets: FloatArray
    on: NDArray[np.bool_]


@dataclass(frozen=True)
class Reach:
    """How far each joint may move: (k,) its middle c, its range, its torque, its inertia and its gain kp."""

    middle: FloatArray
    span: FloatArray
    torque: FloatArray
    inertia: FloatArray
    stiffness: FloatArray

    @classmethod
    def of(
        cls, pose: FloatArray, low: FloatArray, high: FloatArray, scales: tuple[FloatArray, FloatArray, FloatArray],
        slides: NDArray[np.bool_],
    ) -> Reach:  # fmt: skip
        """Return the reach of joints at (k,) a default pose; ``scales`` are torque, inertia and gain."""
        free = np.where(slides, FREE[True], FREE[False])
        low, high = (
            np.where(np.isfinite(low), low, pose - free / 2.0),
            np.where(np.isfinite(high), high, pose + free / 2.0),
        )
        span = high - low
        middle = np.clip(pose, low + span / 5.0, high - span / 5.0)
        inside = np.minimum(span * PART, np.minimum(middle - low, high - middle) * 0.9)
        return cls(middle, inside, *scales)

    @cached_property
    def swing(self) -> FloatArray:
        """(k,) A: amplitude of a slow motion."""
        return np.minimum(self.span, LOAD * self.torque / (self.inertia * (2.0 * np.pi * 2.0 * SLOW) ** 2))

    @cached_property
    def step(self) -> FloatArray:
        """(k,) S: size of a step."""
        return np.minimum(self.swing, LOAD * self.torque / np.maximum(self.stiffness, 1e-9))


_AMPLITUDE = Parameter("amplitude", "", 0.25, 1.0, 1.0, "part of the largest motion")
_RATE = Parameter("rate", "Hz", 0.5, 5.0, 3.0, "highest frequency")
_HELD = "Hold the robot in the air by its base, with room around every joint."


def protocols(cost: float) -> tuple[Protocol, ...]:
    """Return the protocols; ``cost`` is the time of one core for a second of simulation [s]."""
    rows = (
        ("joint_sine", "Every joint follows a slow and a rising sine.", 10.0, "", (_AMPLITUDE, _RATE)),
        ("steps", "Every joint steps up and down.", 8.0, "", (_AMPLITUDE,)),
        ("hold", "The joints move to five poses and rest in each.", 10.0, "", (_AMPLITUDE,)),
        ("coast", "The joints are lifted, and then the motors are switched off.", 2.5,
         "joints without torque fall to their stops", (_AMPLITUDE,)),
    )  # fmt: skip
    return tuple(
        Protocol(name, f"{_HELD} {words}", "air", duration, cost * duration, risk, parameters)
        for name, words, duration, risk, parameters in rows
    )


def motion(name: str, values: Mapping[str, float], duration: float, step: float, reach: Reach) -> Motion:
    """Return the targets of a protocol, one row every ``step`` [s] from 0 to its duration."""
    t = step * np.arange(round(duration / step) + 1, dtype=np.float64)
    joints, size = np.arange(reach.middle.size, dtype=np.float64), values["amplitude"]
    on = np.ones(t.size, dtype=bool)
    if name == "joint_sine":
        shape = reach.swing * _sines(t, duration, values["rate"], joints)
    elif name == "steps":
        place = np.floor(t[:, None] / STEP - 0.5 * (joints % 2)).astype(int) % 4
        shape = (
            reach.step * np.array([0.0, 1.0, 0.0, -1.0])[place] * (t[:, None] >= STEP / 2.0 * (joints % 2))
        )
    elif name == "hold":
        shape = reach.swing * _poses(t)[:, None] * np.where(joints % 2, -1.0, 1.0)
    else:
        shape = np.broadcast_to(reach.swing * np.cos(2.0 * np.pi * GOLDEN * joints), (t.size, joints.size))
        on = t < ON
    return Motion(reach.middle + size * shape, on)


def _sines(t: FloatArray, duration: float, rate: float, joints: FloatArray) -> FloatArray:
    """Return (n, k) sums of two sines; the amplitude of the rising one falls, so that its speed stays."""
    frequency = SLOW + (rate - SLOW) * t / duration
    angle = 2.0 * np.pi * (SLOW * t + (rate - SLOW) * t**2 / (2.0 * duration))
    turns = 2.0 * np.pi * GOLDEN * joints
    rising = (SLOW / frequency)[:, None] * np.sin(angle[:, None] + turns)
    slow = np.sin(2.0 * np.pi * SLOW * (1.0 + joints % 3 / 3.0) * t[:, None] + 2.0 * turns)
    ramp = np.clip(np.minimum(t, duration - t) / MOVE, 0.0, 1.0)[:, None]
    return np.asarray(0.5 * ramp * (rising + slow))


def _poses(t: FloatArray) -> FloatArray:
    """Return (n,) the pose in amplitudes: from each to the next by a cubic, then at rest."""
    place = np.minimum((t / (2.0 * MOVE)).astype(int), len(POSES) - 1)
    poses = np.array([0.0, *POSES])
    part = np.clip(t / MOVE - 2.0 * place, 0.0, 1.0)
    before, after = poses[place], poses[place + 1]
    return np.asarray(before + (after - before) * part**2 * (3.0 - 2.0 * part))
