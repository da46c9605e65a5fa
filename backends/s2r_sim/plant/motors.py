"""The twelve motors: from a command to what MuJoCo's actuators do, with what real motors add to it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_sim.plant.physics import Physics
from s2r_sim.robot.figures import Robot
from s2r_sim.robot.signals import MotorCommand
from s2r_spec.compiled import compiled

FloatArray = NDArray[np.float64]


class Law(NamedTuple):
    """A motor law, force = control − Kp q − Kd q̇ before strength and limits; each (12,)."""

    control: FloatArray
    kp: FloatArray
    kd: FloatArray


class MotorState(NamedTuple):
    """All that the motors carry from step to step.

    Attributes:
        pending: laws on their way to the motors, the oldest first.
        play, play_speed: (12,) angle [rad] and speed of every rotor relative to its joint.
    """

    pending: tuple[Law, ...]
    play: FloatArray
    play_speed: FloatArray


class Motors:
    """Writes the actuators of a MuJoCo model.

    The law itself runs inside MuJoCo, at every physics step and on the true
    joint state: an affine actuator, force = gain · control − kp q − kd q̇,
    integrated implicitly and clipped.
    """

    def __init__(self, robot: Robot, physics: Physics, model: Any, data: Any) -> None:
        self._physics = physics
        self._limit, self._top_speed = robot.torque_limit, robot.speed_limit
        self._delay = round(physics.latency / physics.timestep)
        self._offset = np.tile(physics.encoder_offset, 4) if any(physics.encoder_offset) else None
        self._q, self._dq = data.qpos[7:], data.qvel[6:]
        self._control, self._force = data.ctrl, data.actuator_force
        self._gain = model.actuator_gainprm[:, 0]
        self._minus_kp, self._minus_kd = model.actuator_biasprm[:, 1], model.actuator_biasprm[:, 2]
        self._range = model.actuator_forcerange
        self.every_step = bool(self._delay or physics.voltage < 1.0 or physics.backlash)
        """Whether the motors must be looked after at every physics step, and not once a tick."""
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._driven: FloatArray | None = None
        self.state = MotorState((), np.zeros(12), np.zeros(12))
        self._gain[:] = 1.0
        self._range[:] = (-self._limit, self._limit)

    @property
    def reported_torque(self) -> FloatArray:
        """(12,) [N m] as the drives report it, from their current: blind to the torque constant's error.

        Also while a rotor crosses the gap of its gear: then its torque turns the rotor, and no joint.
        """
        made = self._force if self._driven is None else self._driven
        return np.array(made) / self._physics.torque_constant

    def law(self, motors: MotorCommand) -> Law:
        """Return τ_ff + Kp (q_des − q) + Kd (q̇_des − q̇) with its constant part summed up."""
        control = motors.tau + motors.kp * motors.q + motors.kd * motors.dq
        if self._offset is not None:
            control -= motors.kp * self._offset
        return Law(control, motors.kp, motors.kd)

    def act(self, law: Law, elapsed: float) -> None:
        """Set the actuators for the next physics step, ``elapsed`` [s] after the command's step."""
        if self._delay:
            law = self._delayed(law)
        physics = self._physics
        strength = physics.strength * max(0.0, 1.0 - physics.fade * max(0.0, elapsed))
        strength *= physics.torque_constant
        control, kp, kd = law
        if strength != 1.0 or physics.fade:
            kp, kd = strength * kp, strength * kd
            self._gain[:] = strength
            self._range[:] = (-strength * self._limit, strength * self._limit)
        np.copyto(self._control, control)
        np.negative(kp, out=self._minus_kp)
        np.negative(kd, out=self._minus_kd)
        if physics.voltage < 1.0:
            self._limit_at_speed(strength)
        if physics.backlash:
            self._cross_the_gap(law, strength)

    def _delayed(self, law: Law) -> Law:
        """Return the law that was given ``_delay`` steps ago.

        Before it there is the first of the warm-up, by which the robot stands; no rollout begins so early.
        """
        pending = (*self.state.pending, law)
        self.state = self.state._replace(pending=pending[-self._delay :])
        return pending[0]

    def _limit_at_speed(self, strength: float) -> None:
        """Torque that drives a joint is limited by a line through no torque at v times the top speed."""
        _limited(self._dq, self._range, self._physics.voltage, self._top_speed, strength * self._limit)

    def _cross_the_gap(self, law: Law, strength: float) -> None:
        """Let rotors turn freely between the flanks of their gears, and push only against a flank."""
        physics, dt = self._physics, self._physics.timestep
        gap = physics.backlash
        _, play, speed = self.state
        # The loop is closed on the rotor's side, at q + play.
        self._control -= law.kp * play + law.kd * speed
        motion = (self._q, self._dq, self._control, self._range)
        actuators = (self._gain, self._minus_kp, self._minus_kd)
        play, speed, self._driven = _crossed(
            *motion, *actuators, play, speed, strength, gap, physics.armature, dt
        )
        self.state = self.state._replace(play=play, play_speed=speed)


@compiled
def _limited(dq: FloatArray, within: FloatArray, voltage: float, top_speed: float, full: float) -> None:
    """Write (12, 2) the least and the largest torque [N m] at (12,) speeds [rad/s]."""
    for j in range(dq.shape[0]):
        driving = full * min(max(2.0 * (voltage - abs(dq[j]) / top_speed), 0.0), 1.0)
        within[j, 0] = -(driving if dq[j] < 0.0 else full)
        within[j, 1] = driving if dq[j] > 0.0 else full


@compiled
def _crossed(
    q: FloatArray,
    dq: FloatArray,
    control: FloatArray,
    within: FloatArray,
    gain: FloatArray,
    minus_kp: FloatArray,
    minus_kd: FloatArray,
    play: FloatArray,
    speed: FloatArray,
    strength: float,
    gap: float,
    armature: float,
    dt: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (12,) angle and speed of rotors a step later, and the torque that drives them.

    Where one is on no flank, the joint loses its actuator.
    """
    now, pace, driven = np.empty_like(play), np.empty_like(speed), np.empty_like(play)
    for j in range(play.shape[0]):
        torque = strength * control[j] + minus_kp[j] * q[j] + minus_kd[j] * dq[j]
        torque = min(max(torque, within[j, 0]), within[j, 1])
        driven[j] = torque
        pushes = (play[j] >= gap and torque > 0.0) or (play[j] <= -gap and torque < 0.0)
        pace[j] = 0.0 if pushes else speed[j] + torque / armature * dt
        now[j] = min(max(play[j] + pace[j] * dt, -gap), gap)
        if abs(now[j]) >= gap:
            pace[j] = 0.0
        gain[j] = strength if pushes else 0.0
        minus_kp[j] = minus_kp[j] if pushes else 0.0
        minus_kd[j] = minus_kd[j] if pushes else 0.0
    return now, pace, driven
