"""The twelve motors: from a command to MuJoCo's actuators, with delay, limits, weakness and backlash."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from s2r_sim.plant.physics import USUAL_LOAD, Physics
from s2r_sim.robot.constants import FloatArray, Robot
from s2r_sim.robot.signals import MotorCommand
from s2r_spec.compiled import compiled


class MotorState(NamedTuple):
    """The motors' state between two physics steps.

    Attributes:
        pending: delayed commands that have not reached the motors, the oldest first.
        play, play_speed: (12,) angle [rad] and speed of every rotor relative to its joint.
        worked: time at the usual load in which the motors would have done as much since the command [s].
        since: time after the command at which ``worked`` was counted [s].
    """

    pending: tuple[MotorCommand, ...]
    play: FloatArray
    play_speed: FloatArray
    worked: float = 0.0
    since: float = 0.0


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
        self._offset = np.tile(physics.encoder_offset, 4)
        self._q, self._dq = data.qpos[7:], data.qvel[6:]
        self._force = data.actuator_force
        gain, bias = model.actuator_gainprm[:, 0], model.actuator_biasprm
        self._actuators = data.ctrl, gain, bias, model.actuator_forcerange
        self.every_step = bool(self._delay or physics.voltage < 1.0 or physics.backlash)
        """Whether :meth:`act` must run at every physics step instead of once a tick."""
        self.reset()

    def reset(self) -> None:
        """Return to the state before the first step."""
        self._driven: FloatArray | None = None
        self.state = MotorState((), np.zeros(12), np.zeros(12))

    @property
    def reported_torque(self) -> FloatArray:
        """(12,) torque that the drives report from their currents [N m], without the torque constant's error.

        While a rotor crosses the gap of its gear, this is the torque on the rotor, and none acts on the joint.
        """
        made = self._force if self._driven is None else self._driven
        return made / self._physics.torque_constant

    def act(self, motors: MotorCommand, elapsed: float) -> None:
        """Set the actuators for the next physics step, ``elapsed`` [s] after the command's step."""
        if self._delay:
            motors = self._delayed(motors)
        physics = self._physics
        strength = physics.strength * physics.torque_constant
        if physics.fade:
            strength *= self._left(max(0.0, elapsed))
        full = strength * self._limit
        _write((*motors, self._offset), strength, full, self._actuators)
        if physics.voltage < 1.0:
            _limit(self._dq, self._actuators[3], physics.voltage, self._top_speed, full)
        if physics.backlash:
            self._cross_the_gap(motors)

    def _left(self, elapsed: float) -> float:
        """Return the part of the strength that is left."""
        if self._physics.fade_by_load:
            elapsed = self._tiring(elapsed)
        return max(0.0, 1.0 - self._physics.fade * elapsed)

    def _tiring(self, elapsed: float) -> float:
        """Return the time in which the motors lose as much at the usual load."""
        reported = self.reported_torque
        load = float(reported @ reported) / USUAL_LOAD
        worked = self.state.worked + load * (elapsed - self.state.since)
        self.state = self.state._replace(worked=worked, since=elapsed)
        share = min(self._physics.fade_by_load, 1.0)
        return (1.0 - share) * elapsed + share * worked

    def _delayed(self, motors: MotorCommand) -> MotorCommand:
        """Return the command of ``_delay`` steps ago.

        In the first steps of the warm-up this is the first one, which lets the robot stand; no rollout begins so early.
        """
        pending = (*self.state.pending, motors)
        self.state = self.state._replace(pending=pending[-self._delay :])
        return pending[0]

    def _cross_the_gap(self, motors: MotorCommand) -> None:
        """Let rotors turn freely between the flanks of their gears, and push only against a flank."""
        physics, gap = self._physics, self._physics.backlash
        play, speed = self.state.play, self.state.play_speed
        # The loop is closed on the rotor's side, at q + play.
        control = self._actuators[0]
        control -= motors.kp * play + motors.kd * speed
        play, speed, self._driven = _cross_gap(
            (self._q, self._dq), self._actuators, (play, speed), gap, physics.armature, physics.timestep
        )
        self.state = self.state._replace(play=play, play_speed=speed)


@compiled
def _write(
    motors: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
    strength: float,
    limit: float,
    actuators: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
) -> None:
    """Write the law ``strength`` (τ_ff + Kp (q_des − q) + Kd (q̇_des − q̇)) within ±``limit`` [N m].

    Args:
        motors: (12,) q_des, q̇_des, Kp, Kd, τ_ff, and the encoders' errors [rad].
        strength: torque that the motors deliver, as a fraction of their command.
        limit: largest torque [N m].
        actuators: as for :func:`_cross_gap`.
    """
    q, dq, kp, kd, tau, offset = motors
    control, gain, bias, within = actuators
    for j in range(12):
        control[j] = tau[j] + kp[j] * q[j] + kd[j] * dq[j] - kp[j] * offset[j]
        gain[j], bias[j, 1], bias[j, 2] = strength, -strength * kp[j], -strength * kd[j]
        within[j, 0], within[j, 1] = -limit, limit


@compiled
def _limit(dq: FloatArray, within: FloatArray, voltage: float, top_speed: float, full: float) -> None:
    """Write (12, 2) the least and the largest torque [N m] at (12,) speeds [rad/s].

    A line over speed, 0 at ``voltage`` times the top speed, limits the driving torque.
    """
    for j in range(dq.shape[0]):
        driving = full * min(max(2.0 * (voltage - abs(dq[j]) / top_speed), 0.0), 1.0)
        within[j, 0] = -(driving if dq[j] < 0.0 else full)
        within[j, 1] = driving if dq[j] > 0.0 else full


@compiled
def _cross_gap(
    motion: tuple[FloatArray, FloatArray],
    actuators: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    rotors: tuple[FloatArray, FloatArray],
    gap: float,
    armature: float,
    dt: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (12,) angle and speed of the rotors a step later, and the torque on them [N m].

    Args:
        motion: (12,) joint angles [rad] and speeds [rad/s].
        actuators: (12,) ``ctrl``, (12,) the first column of ``actuator_gainprm``, (12, 10) ``actuator_biasprm``, and
            (12, 2) the least and the largest torque [N m]. On return the actuators of joints whose rotor pushes
            against no flank give no torque.
        rotors: (12,) angle [rad], within ±gap, and speed [rad/s] of each rotor relative to its joint.
        gap: half of the play of a gear [rad].
        armature: inertia of a rotor, seen at the joint [kg m²].
        dt: duration of the step [s].
    """
    q, dq = motion
    control, gain, bias, within = actuators
    play, speed = rotors
    torque, angles, speeds = np.empty_like(control), np.empty_like(play), np.empty_like(speed)
    for j in range(torque.shape[0]):
        whole = gain[j] * control[j] + bias[j, 1] * q[j] + bias[j, 2] * dq[j]
        torque[j] = min(max(whole, within[j, 0]), within[j, 1])
        pushes = (play[j] >= gap and torque[j] > 0.0) or (play[j] <= -gap and torque[j] < 0.0)
        speeds[j] = 0.0 if pushes else speed[j] + torque[j] / armature * dt
        angles[j] = min(max(play[j] + speeds[j] * dt, -gap), gap)
        if abs(angles[j]) >= gap:
            speeds[j] = 0.0
        if not pushes:
            gain[j] = bias[j, 1] = bias[j, 2] = 0.0
    return angles, speeds, torque
