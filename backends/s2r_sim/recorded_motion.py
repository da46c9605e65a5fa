"""A recorded motion put through the laws of motion, tick by tick, over whole arrays."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from s2r_sim import pinocchio_model, terrain
from s2r_sim.figures import LEGS, Robot
from s2r_sim.leg_kinematics import foot_motion
from s2r_sim.parameters import Test
from s2r_sim.settings import Settings
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

_STICKS = 0.05
"""[rad/s] below which dry friction is not fully built up."""


class Motion:
    """A recorded motion, and what several residuals need of it; arrays of one row for every tick.

    A tick goes from one sample to the next. State in the middle of it is the mean of both.
    """

    def __init__(self, trace: Trace, settings: Settings, test: Test) -> None:
        self.trace, self.test, self.gains = trace, test, settings.gains
        self.physics = test.world(settings.physics)
        self.robot = settings.robot.loaded(self.physics.payloads, self.physics.com_shift)
        self.dt: FloatArray = np.diff(trace.times)

    def at(self, name: str) -> FloatArray:
        """Return (n − 1, …): a channel at the beginning of every tick."""
        return self.trace[name][:-1]

    def mid(self, name: str) -> FloatArray:
        """Return (n − 1, …): a channel in the middle of every tick."""
        values = self.trace[name]
        middle: FloatArray = (values[1:] + values[:-1]) / 2
        return middle

    def rate(self, values: FloatArray) -> FloatArray:
        """Return (n − 1, …): the change over every tick, per second."""
        change: FloatArray = np.diff(values, axis=0) / self.dt.reshape(-1, *[1] * (values.ndim - 1))
        return change

    @cached_property
    def velocity(self) -> FloatArray:
        """(n, 3) of the base at the samples, world axes [m/s]."""
        vx, vy, yaw = (self.trace[name] for name in ("vx", "vy", "yaw"))
        c, s = np.cos(yaw), np.sin(yaw)
        return np.column_stack((c * vx - s * vy, s * vx + c * vy, self.trace["vz"]))

    @cached_property
    def attitude(self) -> Any:
        """Base axes to world axes, in the middle of every tick."""
        return _attitude(*(self.mid(name) for name in ("roll", "pitch", "yaw")))

    @cached_property
    def push(self) -> FloatArray:
        """(n − 1, 3) force on the base that the test declares, base axes [N]."""
        force = np.array([self.test.push_force(time) for time in self.trace.times[:-1].tolist()])
        heading = self.at("yaw") + np.radians(self.test.push_towards)
        world = np.column_stack((force * np.cos(heading), force * np.sin(heading), np.zeros_like(force)))
        turned: FloatArray = self.attitude.inv().apply(world)
        return turned

    @cached_property
    def normal(self) -> FloatArray:
        """(3,) the ground's normal."""
        slope = terrain.mean_height(self.physics, 1.0)
        across: FloatArray = np.array([-slope, 0.0, 1.0]) / np.hypot(1.0, slope)
        return across

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
    def contact_arm(self) -> FloatArray:
        """(n − 1, 3) from a ball's centre to where it touches the ground, base axes [m]."""
        arm: FloatArray = self.attitude.inv().apply(-self.robot.foot_radius * self.normal)
        return arm

    @cached_property
    def contact_speed(self) -> FloatArray:
        """(n − 1, 4, 3) velocity of what would touch the ground, world axes [m/s]."""
        place, slide, spin = self.feet
        speeds = self.mid("dq").reshape(-1, 4, 3, 1)
        omega = self.mid("omega")[:, None]
        arm = self.contact_arm[:, None]
        own = (slide @ speeds)[..., 0] + np.cross(omega, place)
        own = own + np.cross((spin @ speeds)[..., 0] + omega, arm)
        turned = np.einsum("nij,nkj->nki", self.attitude.as_matrix(), own)
        middle: FloatArray = (self.velocity[1:] + self.velocity[:-1])[:, None] / 2 + turned
        return middle

    @cached_property
    def touches(self) -> FloatArray:
        """(n − 1, 4) 1 where a foot is on the ground at both ends of the tick."""
        contact = self.trace["contact"]
        both: FloatArray = np.minimum(contact[1:], contact[:-1])
        return both

    @cached_property
    def forces(self) -> tuple[FloatArray, FloatArray]:
        """(n − 1, 6) wrench on the base (force, torque) and (n − 1, 12) torque on the joints, of the ground."""
        place, slide, spin = self.feet
        world = self.at("foot_force").reshape(-1, 4, 3)
        force = np.einsum("nji,nkj->nki", self.attitude.as_matrix(), world)
        arm = np.broadcast_to(self.contact_arm[:, None], force.shape)
        turn = np.cross(arm, force)
        torque = np.cross(place, force) + turn
        joints = np.einsum("nkij,nki->nkj", slide, force) + np.einsum("nkij,nki->nkj", spin, turn)
        return np.hstack((force.sum(1), torque.sum(1))), joints.reshape(-1, 12)

    @cached_property
    def needed(self) -> FloatArray:
        """(n − 1, 18) what the motion took: wrench on the base in base axes [N], [N m], torque on joints [N m]."""
        trace = self.trace
        samples = _attitude(*(trace[name] for name in ("roll", "pitch", "yaw")))
        twist = np.hstack((samples.inv().apply(self.velocity), trace["omega"], trace["dq"]))
        middle = (twist[1:] + twist[:-1]) / 2
        place = np.column_stack([self.mid(name) for name in ("x", "y", "z")])
        q = np.hstack((place, self.attitude.as_quat(), self.mid("q")))
        model = _model(self.robot, self.physics.armature)
        data = model.createData()
        rows = zip(q, middle, self.rate(twist), strict=True)
        torque: FloatArray = np.array([pin.rnea(model, data, *row) for row in rows])
        return torque

    @cached_property
    def friction(self) -> FloatArray:
        """(n − 1, 12) of the nominal gears [N m]."""
        speed = self.mid("dq")
        rubbed: FloatArray = self.physics.damping * speed + self.physics.dry_friction * np.tanh(
            speed / _STICKS
        )
        return rubbed


@lru_cache(maxsize=8)
def _model(robot: Robot, armature: float) -> Any:
    return pinocchio_model.build(robot, armature)


def _attitude(roll: FloatArray, pitch: FloatArray, yaw: FloatArray) -> Any:
    return Rotation.from_euler("ZYX", np.column_stack((yaw, pitch, roll)))


def _stack(vector: tuple[Any, Any, Any], n: int) -> FloatArray:
    """Return (n, 3) of three arrays or numbers."""
    return np.stack([np.broadcast_to(part, n) for part in vector], -1)
