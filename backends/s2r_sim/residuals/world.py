"""A recorded motion in a world: its forces by ground, joints, motors and loads, and its expected measurements."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from s2r_sim.controller.estimator import BLEND
from s2r_sim.controller.gains import RATE, Gains
from s2r_sim.parameters import Test
from s2r_sim.plant.physics import USUAL_LOAD, Physics
from s2r_sim.protocols.references import reference
from s2r_sim.residuals.ground import Compliance, ground_compliance
from s2r_sim.residuals.motion import Ground, RecordedMotion, corrected_motion, ground, hann
from s2r_sim.residuals.play import cross_play
from s2r_sim.robot.constants import GRAVITY, FloatArray, Robot
from s2r_sim.robot.rotation import rotate, turned_back

IntArray = NDArray[np.int64]
Protocol = tuple[str, tuple[tuple[str, float], ...]]
"""Name of a protocol, and (name, value) of its parameters."""

_STILL = 0.1
"""[rad/s] below which a joint's dry friction balances any torque up to its own size."""
_STICKS, _SLIDES = 0.06, 0.12
"""[m/s] Below the first speed a foot sticks; above the second it slides with full friction; linear in between."""
_SLIDE_TIME = 0.06
"""[s] averaging time of the sliding speed, against noise and the creep under a first load."""


@dataclass(frozen=True, eq=False)
class ModelledMotion:
    """Arrays of one row for every tick, as :class:`~s2r_sim.residuals.motion.RecordedMotion`.

    Attributes:
        recorded: the motion by the robot's own sensors and by motion capture.
        gains: gains of the controller.
        bare: the nominal world of the test.
        world: the same world with effects.
        test: the requested test.
        protocol: name and parameters of the protocol; None for a test.
    """

    recorded: RecordedMotion
    gains: Gains
    bare: Physics
    world: Physics
    test: Test
    protocol: Protocol | None = None

    @property
    def robot(self) -> Robot:
        """The nominal robot, which is also the controller's model."""
        return self.recorded.robot

    @property
    def ground(self) -> Ground:
        """Ground of the world."""
        return ground(self.moved, self.world.slope)

    @cached_property
    def moved(self) -> RecordedMotion:
        """The true motion, if the world's sensors had reported the record."""
        motion = corrected_motion(self.recorded, self.world.encoder_offset, self.world.attitude_bias)
        if self._gears is None:
            return motion
        play, rate, _ = self._gears
        return motion.less(q=play, dq=rate)

    @cached_property
    def _gears(self) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Play, its rate and the joints' torque by :func:`cross_play`; None without backlash or recorded torque."""
        log, world = self.recorded, self.world
        if not world.backlash or "tau" not in log.trace.channels:
            return None
        turns = world.torque_constant * log.at("tau")
        return cross_play(turns, log.dt, self._steps, world.backlash, world.armature)

    @cached_property
    def loaded(self) -> Robot:
        """The robot with the world's payloads."""
        return self.robot.loaded(self.world.payloads, self.world.com_shift)

    @cached_property
    def needed(self) -> FloatArray:
        """(n − 1, 18) force that the motion required: base wrench in base axes [N], [N m]; joint torques [N m]."""
        log = self.moved
        needed = log.needed.copy()
        _, speeds_up = log.twist
        needed[:, 6:] += self.world.armature * speeds_up[:, 6:]
        if self.loaded != self.robot:
            needed[:, :6] += log.base_needs(self.loaded.base) - log.base_needs(self.robot.base)
        return needed

    @cached_property
    def joints(self) -> FloatArray:
        """(n − 1, 12) torque that the joints' motion requires minus that of ground, motors and friction [N m]."""
        log, world = self.moved, self.world
        speed = log.mid("dq")
        _, ground = self.forces
        driven = world.torque_constant * log.at("tau") if self._gears is None else self._gears[2]
        lacks = self.needed[:, 6:] + world.damping * speed - ground - driven
        held = np.sign(lacks) * np.maximum(0.0, np.abs(lacks) - world.dry_friction)
        return np.where(np.abs(speed) > _STILL, lacks + world.dry_friction * np.sign(speed), held)

    @cached_property
    def forces(self) -> tuple[FloatArray, FloatArray]:
        """(n − 1, 6) wrench on the base and (n − 1, 12) torque on the joints, from ground and grass."""
        base, joints = self.ground.forces
        if not self.world.drag:
            return base, joints
        held = self.moved.pushed(self._drag)
        return base + held[0], joints + held[1]

    @cached_property
    def _drag(self) -> FloatArray:
        """(n − 1, 4, 3) drag on low feet, base axes [N]."""
        log = self.moved
        place, _, _ = log.feet
        rise = np.array([-self.ground.rise, 0.0, 1.0])
        base = np.column_stack([log.mid(name) for name in ("x", "y", "z")]) @ rise
        height = base[:, None] + np.einsum("i,nij,nkj->nk", rise, log.attitude, place)
        low = (height < self.world.drag_height)[:, :, None]
        return -self.world.drag * log.foot_speed * low

    @cached_property
    def push(self) -> FloatArray:
        """(n − 1, 3) force on the base that the test declares, base axes [N]."""
        log = self.moved
        if not self.test.push:
            return np.zeros((len(log.dt), 3))
        force = np.array([self.test.push_force(time) for time in log.trace.times[:-1].tolist()])
        heading = log.at("yaw") + np.radians(self.test.push_towards)
        world = np.column_stack((force * np.cos(heading), force * np.sin(heading), np.zeros_like(force)))
        return np.einsum("nji,nj->ni", log.attitude, world)

    @cached_property
    def strength(self) -> FloatArray:
        """(n − 1,) torque that motors deliver, as a fraction of their command."""
        elapsed = np.maximum(self.recorded.trace.times[:-1], 0.0)
        share = min(self.world.fade_by_load, 1.0)
        if share and "tau" in self.recorded.trace.channels:
            load = (self.recorded.at("tau") ** 2).sum(axis=1) / USUAL_LOAD
            worked = np.concatenate([[0.0], np.cumsum(load[:-1] * np.diff(elapsed))])
            elapsed = (1.0 - share) * elapsed + share * worked
        return self.world.strength * np.maximum(0.0, 1.0 - self.world.fade * elapsed)

    @cached_property
    def delivered(self) -> FloatArray:
        """(n − 1, 12) torque that the motors should report [N m], with latency and limits."""
        log = self.recorded
        kp, kd = self._joint_gains
        commanded, tick = log.at("tau_cmd"), self._given
        low, high = self._limits
        # The motors report the last step of a tick: its law, with the joints of that step.
        law, last = tick[:, -1], (tick.shape[1] - 1) / tick.shape[1]
        moved, turned = (
            log.at(name) + last * np.diff(log.trace[name], axis=0) - log.at(name)[law] for name in ("q", "dq")
        )
        return self.strength[:, None] * np.clip(
            commanded[law] - kp[law] * moved - kd[law] * turned, low, high
        )

    @property
    def _joint_gains(self) -> tuple[FloatArray, FloatArray]:
        """(n − 1, 12) stiffness [N m/rad] and (n − 1, 1) damping [N m s/rad] of the joints."""
        log, gains = self.recorded, self.gains
        if self.protocol is None:
            swings = 1.0 - np.repeat(log.at("stance"), 3, axis=1)
            return gains.kp_joint_swing * swings, np.full((len(swings), 1), gains.kd_joint)
        name, values = self.protocol
        played = reference(name, **dict(values))
        rows = np.clip(np.round(log.trace.times[:-1] * RATE).astype(int), 0, len(played.kp) - 1)
        return np.repeat(played.kp[rows, None], 12, axis=1), played.kd[rows, None]

    @cached_property
    def _given(self) -> IntArray:
        """(n − 1, steps) the tick whose law is in force in each of the steps of physics in a tick."""
        log, world, steps = self.recorded, self.world, self._steps
        middles = log.trace.times[:-1, None] + log.dt[:, None] * (np.arange(steps) + 0.5) / steps
        ticks: IntArray = np.searchsorted(log.trace.times, middles - world.latency, side="right") - 1
        return np.clip(ticks, 0, None)

    @property
    def _steps(self) -> int:
        return max(1, round(float(np.median(self.recorded.dt)) / self.world.timestep))

    @cached_property
    def _limits(self) -> tuple[FloatArray, FloatArray]:
        """(n − 1, 12) least and largest torque of the motors [N m]."""
        speed, limit, voltage = self.recorded.mid("dq"), self.robot.torque_limit, self.world.voltage
        low, high = np.full_like(speed, -limit), np.full_like(speed, limit)
        if voltage < 1.0:
            driving = limit * np.clip(2.0 * (voltage - np.abs(speed) / self.robot.speed_limit), 0.0, 1.0)
            low, high = np.where(speed < 0, -driving, low), np.where(speed > 0, driving, high)
        return low, high

    @cached_property
    def follows(self) -> FloatArray:
        """(n − 1, 3) expected acceleration after the QP's prediction, forward, left, up [m/s²].

        The QP predicts with its own mass and frame. In the world, motors deliver a fraction of the forces, the
        mass is that of the loaded robot, and a misaligned IMU tilts the frame.
        """
        log, gravity = self.recorded, np.array([0.0, 0.0, GRAVITY])
        felt = log.at("acc_pred") + gravity
        if any(self.world.attitude_bias):
            level = np.zeros(len(log.dt))
            roll, pitch = (
                log.mid(name) if name in log.trace.channels else level for name in ("roll", "pitch")
            )
            by_roll, by_pitch = np.radians(self.world.attitude_bias)
            in_base = turned_back(roll, pitch, 0.0, felt.T, np.sin, np.cos)
            felt = np.column_stack(rotate(roll - by_roll, pitch - by_pitch, 0.0, in_base, np.sin, np.cos))
        part = self.strength * self.world.torque_constant * self.robot.mass / self.loaded.mass
        return part[:, None] * felt - gravity

    @cached_property
    def estimated(self) -> FloatArray:
        """(n − 1, 2) expected velocity estimate of the robot, forward and left [m/s]."""
        log, world = self.recorded, self.world
        roll, pitch = np.radians(world.attitude_bias)
        # A misaligned IMU counts a part of gravity as acceleration, until leg odometry corrects the estimate.
        leak = GRAVITY * BLEND * np.array([np.sin(pitch), -np.sin(roll)])
        true = np.column_stack([log.at(name) for name in ("vx", "vy")])
        return world.velocity_scale * (true + leak) + np.array(world.velocity_bias)

    @cached_property
    def grips(self) -> FloatArray:
        """(n − 1, 4) friction force minus its limit [N]; below the limit only as far as the foot slides."""
        log = self.recorded
        force, normal = self._pressed
        held = np.linalg.norm(force - normal[..., None] * self.ground.normal, axis=-1)
        over = held - self.world.friction * normal
        weights, touches = hann(log.trace.times, _SLIDE_TIME), log.touches[..., np.newaxis]
        steadily = convolve1d(touches * self.slides, weights, axis=0)
        steadily /= np.maximum(convolve1d(touches, weights, axis=0), 1e-9)
        speed = np.linalg.norm(steadily, axis=-1)
        used_up = np.clip((speed - _STICKS) / (_SLIDES - _STICKS), 0.0, 1.0)
        return log.touches * np.where(over < 0.0, used_up * over, over)

    @cached_property
    def slides(self) -> FloatArray:
        """(n − 1, 4, 3) velocity of contact points along the ground, minus the creep under the recorded force [m/s]."""
        speed, normal = self.ground.contact_speed, self.ground.normal
        along = speed - (speed @ normal)[..., np.newaxis] * normal
        if "foot_force" in self.recorded.trace.channels:
            along = along - self.creeps
        return along

    @cached_property
    def below(self) -> FloatArray:
        """(n − 1, 4) penetration of each ball foot into the world's ground, minus the expected sinkage [m]."""
        x, _, z = np.moveaxis(self.recorded.mid("foot_position").reshape(-1, 4, 3), -1, 0)
        below: FloatArray = self.robot.foot_radius - (z - self.ground.rise * x) * self.ground.normal[2]
        if "foot_force" in self.recorded.trace.channels:
            below = below - self.sinks
        return below

    @cached_property
    def sinks(self) -> FloatArray:
        """(n − 1, 4) expected sinkage of the feet minus that on nominal ground [m]."""
        _, normal = self._pressed
        here, bare = self._grounds
        return here.depth_under(normal) - bare.depth_under(normal)

    @cached_property
    def creeps(self) -> FloatArray:
        """(n − 1, 4, 3) expected creep velocity of loaded feet minus that on nominal ground, world axes [m/s]."""
        force, normal = self._pressed
        here, bare = self._grounds
        more = here.creep_under(normal) - bare.creep_under(normal)
        # The creep of a foot is opposite to the ground's tangential force on it.
        return -more[..., None] * (force - normal[..., None] * self.ground.normal)

    @cached_property
    def _pressed(self) -> tuple[FloatArray, FloatArray]:
        """(n − 1, 4, 3) ground on feet, world axes, and (n − 1, 4) its normal part [N]."""
        force = self.recorded.at("foot_force").reshape(-1, 4, 3)
        return force, force @ self.ground.normal

    @property
    def _grounds(self) -> tuple[Compliance, Compliance]:
        here, bare = (
            ground_compliance(self.robot, one.impratio, one.sink) for one in (self.world, self.bare)
        )
        return here, bare
