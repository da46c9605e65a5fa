"""Kinematics and inverse dynamics of a recorded motion, over whole arrays: the quantities that depend on no world.

A diagnosis computes residuals of one trace in many worlds. The quantities here depend only on the robot, its sensors'
errors and the slope. They are computed once for each of these.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, lru_cache
from math import radians, tan
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from s2r_sim.residuals.ground import Footing, footing
from s2r_sim.robot import pinocchio_model
from s2r_sim.robot.constants import GRAVITY, LEGS, FloatArray, Inertia, Robot
from s2r_sim.robot.leg_kinematics import foot_motion
from s2r_spec.trace import Trace


class RecordedMotion:
    """A recorded motion and its kinematics, which depend on the robot's geometry and not on the world.

    Arrays have one row per tick, the interval between two samples. The state at the midpoint of a tick is the mean
    of the two samples. Built once per trace: :func:`recorded_motion`.
    """

    def __init__(self, trace: Trace, robot: Robot) -> None:
        self.trace, self.robot = trace, robot
        self.dt: FloatArray = np.diff(trace.times)

    def at(self, name: str) -> FloatArray:
        """Return (n − 1, …): a channel at the beginning of every tick."""
        return self.trace[name][:-1]

    def mid(self, name: str) -> FloatArray:
        """Return (n − 1, …): a channel at the midpoint of every tick."""
        return _midpoints(self.trace[name])

    def rate(self, values: FloatArray) -> FloatArray:
        """Return (n − 1, …): the change over every tick, per second."""
        return np.diff(values, axis=0) / self.dt.reshape(-1, *[1] * (values.ndim - 1))

    @cached_property
    def velocity(self) -> FloatArray:
        """(n, 3) velocity of the base at the samples, world axes [m/s]."""
        vx, vy, yaw = (self.trace[name] for name in ("vx", "vy", "yaw"))
        c, s = np.cos(yaw), np.sin(yaw)
        return np.column_stack((c * vx - s * vy, s * vx + c * vy, self.trace["vz"]))

    @cached_property
    def attitude(self) -> FloatArray:
        """(n − 1, 3, 3) rotation from base axes to world axes, at the midpoint of every tick."""
        return _attitude(*(self.mid(name) for name in ("roll", "pitch", "yaw"))).as_matrix()

    @cached_property
    def feet(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(n − 1, 4, 3) ball centres [m] and (n − 1, 4, 3, 3) Jacobians of balls and of shanks' spins.

        In base axes and relative to the base; columns of a Jacobian are hip, thigh and calf.
        """
        q, unit = self.mid("q").T, np.eye(3)
        place, slide, spin = [], [], []
        for i, leg in enumerate(LEGS):
            joints = q[3 * i : 3 * i + 3]
            columns = [foot_motion(self.robot, leg, joints, one, np.sin, np.cos) for one in unit]
            place.append(_stack(columns[0].position, joints.shape[1]))
            slide.append(np.stack([_stack(c.velocity, joints.shape[1]) for c in columns], -1))
            spin.append(np.stack([_stack(c.spin, joints.shape[1]) for c in columns], -1))
        return np.stack(place, 1), np.stack(slide, 1), np.stack(spin, 1)

    @cached_property
    def foot_speed(self) -> FloatArray:
        """(n − 1, 4, 3) velocity of the ball centres, base axes [m/s]: measured from outside, else from the joints."""
        if "foot_velocity" not in self.trace.channels:
            return self._foot_speed_by_joints
        measured = self.mid("foot_velocity").reshape(-1, 4, 3)
        speed = np.einsum("nji,nkj->nki", self.attitude, measured)
        known = np.isfinite(speed)
        return speed if known.all() else np.where(known, speed, self._foot_speed_by_joints)

    @cached_property
    def _foot_speed_by_joints(self) -> FloatArray:
        """(n − 1, 4, 3) the same, from the motion of base and joints."""
        place, slide, _ = self.feet
        own = (slide @ self.mid("dq").reshape(-1, 4, 3, 1))[..., 0] + np.cross(
            self.mid("omega")[:, None], place
        )
        base = np.einsum("nji,nj->ni", self.attitude, _midpoints(self.velocity))
        return own + base[:, None]

    @cached_property
    def shank_spin(self) -> FloatArray:
        """(n − 1, 4, 3) angular velocity of the shanks, base axes [rad/s]."""
        _, _, spin = self.feet
        return (spin @ self.mid("dq").reshape(-1, 4, 3, 1))[..., 0] + self.mid("omega")[:, None]

    @cached_property
    def touches(self) -> FloatArray:
        """(n − 1, 4) 1 where a foot is on the ground at both ends of the tick."""
        contact = self.trace["contact"]
        return np.minimum(contact[1:], contact[:-1])

    @cached_property
    def footing(self) -> Footing:
        """Footholds with recorded positions: a missing sample must not spoil the others."""
        place = self.mid("foot_position").reshape(-1, 4, 3)
        known = np.isfinite(place).all(axis=-1)
        if "foot_force" in self.trace.channels:
            known &= np.isfinite(self.at("foot_force")).reshape(-1, 4, 3).all(axis=-1)
        x, y, _ = np.moveaxis(place, -1, 0)
        return footing(np.where(known, self.touches, 0.0), x, y)

    @cached_property
    def foot_force(self) -> FloatArray:
        """(n − 1, 4, 3) ground on feet, base axes [N]."""
        world = self.at("foot_force").reshape(-1, 4, 3)
        return np.einsum("nji,nkj->nki", self.attitude, world)

    def pushed(self, force: FloatArray, arm: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return (n − 1, 6) wrench on the base and (n − 1, 12) torque on the joints of (n − 1, 4, 3) forces on feet.

        In base axes; they act at the balls' centres, or (n − 1, 3) ``arm`` [m] from there.
        """
        place, slide, spin = self.feet
        torque = np.cross(place, force)
        joints = np.einsum("nkij,nki->nkj", slide, force)
        if arm is not None:
            turn = np.cross(arm[:, None], force)
            torque = torque + turn
            joints = joints + np.einsum("nkij,nki->nkj", spin, turn)
        return np.hstack((force.sum(1), torque.sum(1))), joints.reshape(-1, 12)

    @cached_property
    def twist(self) -> tuple[FloatArray, FloatArray]:
        """Velocity at the midpoint of every tick, and its time derivative, each (n − 1, 18).

        Base twist in base axes, then joint velocities.
        """
        trace = self.trace
        samples = _attitude(*(trace[name] for name in ("roll", "pitch", "yaw")))
        twist = np.hstack((samples.inv().apply(self.velocity), trace["omega"], trace["dq"]))
        return _midpoints(twist), self.rate(twist)

    @cached_property
    def needed(self) -> FloatArray:
        """(n − 1, 18) generalized force that the motion required of the nominal robot, without rotors.

        Wrench on the base in base axes [N], [N m], torque on joints [N m].
        """
        place = np.column_stack([self.mid(name) for name in ("x", "y", "z")])
        turn = _attitude(*(self.mid(name) for name in ("roll", "pitch", "yaw"))).as_quat()
        q = np.hstack((place, turn, self.mid("q")))
        model = _model(self.robot)
        data = model.createData()
        return np.array([pin.rnea(model, data, *row) for row in zip(q, *self.twist, strict=True)])

    def base_needs(self, inertia: Inertia) -> FloatArray:
        """Return (n − 1, 6) the wrench that moves a body fixed to the base, base axes [N], [N m].

        The Newton–Euler equations about the base's origin.
        """
        moves, speeds_up = self.twist
        spin, turned = moves[:, 3:6], speeds_up[:, 3:6]
        gravity = GRAVITY * self.attitude[:, 2]
        lifted = speeds_up[:, :3] + np.cross(spin, moves[:, :3]) + gravity
        com = np.array(inertia.com)
        about = inertia.tensor + inertia.mass * (com @ com * np.eye(3) - np.outer(com, com))
        force = inertia.mass * (lifted + np.cross(turned, com) + np.cross(spin, np.cross(spin, com)))
        torque = turned @ about + np.cross(spin, spin @ about) + inertia.mass * np.cross(com, lifted)
        return np.hstack((force, torque))

    def less(self, **errors: FloatArray) -> RecordedMotion:
        """Return the motion with these errors subtracted from its channels; a channel without a record is skipped."""
        channels = self.trace.channels
        truer = {name: channels[name] - error for name, error in errors.items() if name in channels}
        return RecordedMotion(replace(self.trace, channels={**channels, **truer}), self.robot)


class Ground:
    """Kinematics of a recorded motion relative to the sloped ground."""

    def __init__(self, motion: RecordedMotion, slope: float) -> None:
        self.motion = motion
        self.rise = tan(radians(slope))
        """Rise of the ground per metre."""

    @cached_property
    def normal(self) -> FloatArray:
        """(3,) the ground's normal, world axes."""
        return np.array([-self.rise, 0.0, 1.0]) / np.hypot(1.0, self.rise)

    @cached_property
    def arm(self) -> FloatArray:
        """(n − 1, 3) vector from a ball's centre to its contact point with the ground, base axes [m]."""
        return -self.motion.robot.foot_radius * (self.normal @ self.motion.attitude)

    @cached_property
    def contact_speed(self) -> FloatArray:
        """(n − 1, 4, 3) velocity of each ball's material point at ``arm``, world axes [m/s]."""
        own = self.motion.foot_speed + np.cross(self.motion.shank_spin, self.arm[:, None])
        return np.einsum("nij,nkj->nki", self.motion.attitude, own)

    @cached_property
    def forces(self) -> tuple[FloatArray, FloatArray]:
        """(n − 1, 6) wrench on the base (force, torque) and (n − 1, 12) torque on the joints, of the ground."""
        return self.motion.pushed(self.motion.foot_force, self.arm)


def hann(times: FloatArray, width: float) -> FloatArray:
    """Return Hann weights over ``width`` [s]: an odd number of them, at least three, with sum 1."""
    period = float(np.median(np.diff(times))) if times.size > 1 else width
    weights: FloatArray = np.hanning(2 * max(1, round(width / period / 2)) + 3)[1:-1]
    weights /= weights.sum()
    return weights


recorded_motion = lru_cache(maxsize=2)(RecordedMotion)
"""The motion of a trace and a robot; the cache returns the same object for the last traces."""
ground = lru_cache(maxsize=4)(Ground)
"""A motion on a slope [deg]."""
_model = lru_cache(maxsize=8)(pinocchio_model.build)


@lru_cache(maxsize=4)
def corrected_motion(
    motion: RecordedMotion, encoder_offset: tuple[float, float, float], attitude_bias: tuple[float, float]
) -> RecordedMotion:
    """Return the motion that sensors with these errors [rad], [deg] report as the recorded one; cached."""
    errors: dict[str, FloatArray] = {}
    if any(encoder_offset):
        errors["q"] = np.tile(encoder_offset, 4)
    for name, angle in zip(("roll", "pitch"), np.radians(attitude_bias), strict=True):
        if angle:
            errors[name] = angle
    return motion.less(**errors) if errors else motion


def _midpoints(values: FloatArray) -> FloatArray:
    return (values[1:] + values[:-1]) / 2


def _attitude(roll: FloatArray, pitch: FloatArray, yaw: FloatArray) -> Any:
    return Rotation.from_euler("ZYX", np.column_stack((yaw, pitch, roll)))


def _stack(vector: tuple[Any, Any, Any], n: int) -> FloatArray:
    return np.stack([np.broadcast_to(part, n) for part in vector], -1)
