"""One rollout: model, policy and recorder, from the start pose to the end or to a failure.

A control tick reads ``data`` as ``mj_step`` left it, as deployment scripts do: positions and velocities are those of
the tick, and sensors and site frames those of the physics step before it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from s2r_mujoco import drive
from s2r_mujoco.arrays import FloatArray, Observation
from s2r_mujoco.deploy.record import Term
from s2r_mujoco.effects.loop import Loop
from s2r_mujoco.effects.physics import Physics
from s2r_mujoco.law import kind_of
from s2r_mujoco.observation import Memory, Observer, Parts, UserTerm, sensed
from s2r_mujoco.plan import Plan
from s2r_spec.errors import BackendError, shortened

UNSTABLE = "unstable"
"""Definition: failure of a rollout whose state MuJoCo calls bad (NaN, or beyond ±1e10), or about which it warns."""


class Push(NamedTuple):
    """A constant force on a body: its number, force in world axes [N], first tick and the tick after the last."""

    body: int
    force: FloatArray
    first: int
    end: int


@dataclass(eq=False)
class Record:
    """The samples of a rollout, one row a control tick; ``n`` is the number of ticks.

    Attributes:
        qpos: (n, nq); qvel: (n, nv).
        torque: (n, nv) of the actuators on the degrees of freedom, within the physics step after the sample.
        torque_before: the same, within the physics step before it.
        sensors: (n, nsensordata); observation: (n, width); action: (n, outputs); target: (n, joints or controls).
        command: (3,) the velocity command.
        unstable: whether the last tick is the last finite one.
    """

    qpos: FloatArray
    qvel: FloatArray
    torque: FloatArray
    torque_before: FloatArray
    sensors: FloatArray
    observation: Observation
    action: FloatArray
    target: FloatArray
    command: FloatArray
    unstable: bool = False

    def __len__(self) -> int:
        return len(self.qpos)

    def cut(self, ticks: int) -> Record:
        """Return the first ticks."""
        rows = {
            name: value[:ticks] for name, value in vars(self).items() if name not in ("command", "unstable")
        }
        return Record(**rows, command=self.command, unstable=self.unstable)


Policy = Callable[[Observation], Any]
Act = Callable[[Any, Any, FloatArray], Any]
"""A controller in Python: model, data and command → controls."""


class Simulator:
    """A compiled model with its observer, policy and actuators. A rollout depends on its arguments alone."""

    def __init__(
        self, model: Any, plan: Plan, users: dict[str, UserTerm], physics: Physics | None = None
    ) -> None:
        plan = plan if physics is None else physics.plan(plan)
        drive.prepare_actuators(model, plan)
        if physics is not None:
            physics.change(model, plan)
        self.model, self.plan, self.data = model, plan, mujoco.MjData(model)
        self._positions = np.array(
            [i for i in range(model.nu) if kind_of(model, i) == "position"], dtype=np.intp
        )
        self.memory = Memory(np.zeros(3), np.zeros(len(plan.law.moved)))
        mujoco.mj_forward(model, self.data)
        self.rub = None if physics is None else physics.rubbing(model)
        self.weaken = None if physics is None else physics.sagging(model)
        parts = Parts(plan, model, self.data, self.memory).of(plan.terms, users)
        self.loop = None if physics is None else Loop(physics, model, plan, parts)
        self.observer = Observer(parts, plan, None if self.loop is None else self.loop.observed)
        none = Term("sensor")
        self._sensors = [
            (int(model.sensor_adr[i]), sensed(model, i, none, lambda tick: None))
            for i in range(model.nsensor)
        ]
        self._apply, self._every_step = drive.writer(model, self.data, plan)

    def begin(
        self, qpos: FloatArray, qvel: FloatArray, command: Mapping[str, float], key: int, seed: int = 0
    ) -> None:
        """Reset the state; the seed is that of delays.

        An actuator that the policy leaves alone keeps the keyframe's control, or the start pose.
        """
        mujoco.mj_resetData(self.model, self.data)
        if self.weaken is not None:  # at rest the supply is full
            self.weaken(self.data)
        if key >= 0:
            self.data.ctrl[:] = self.model.key_ctrl[key]
            self.data.act[:] = self.model.key_act[key]
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        self.memory.command[:] = list(command.values())
        self.memory.last_action[:] = 0.0
        mujoco.mj_forward(self.model, self.data)
        if key < 0:
            self.data.ctrl[self._positions] = self.data.actuator_length[self._positions]
        if not self.data.act.any():  # a filtered position target begins at the start pose
            filtered = self._positions[self.model.actuator_actadr[self._positions] >= 0]
            self.data.act[self.model.actuator_actadr[filtered]] = self.data.actuator_length[filtered]
        self.data.ctrl[self.plan.held.joints.actuators] = self.plan.held.pose
        self._seed = seed

    def run(self, policy: Policy, ticks: int, pushes: Sequence[Push] = ()) -> Record:
        """Run a trained policy from the state of :meth:`begin`, and record ``ticks`` control ticks.

        Raises:
            BackendError: the policy returned another width, or a number that is not finite from finite ones.
        """
        law, memory, observe = self.plan.law, self.memory, self.observer.read
        record = self._empty(ticks, self.observer.width, len(law.moved), len(self.plan.joints))
        low_high, pose, last_action = law.clip_action, self.plan.pose, memory.last_action
        if self.loop is not None:
            self.loop.begin(np.where(law.has_target & ~law.speed, self.plan.pose, 0.0), self._seed)
        for tick in range(ticks):
            observation = observe(tick)
            action = policy(observation)
            if not isfinite(action.sum()):
                return self._not_finite(record, tick, observation)
            last_action[:] = action if low_high is None else np.clip(action, *low_high)
            target = law.targets(last_action, pose)
            record.observation[tick], record.action[tick] = observation, action
            self._tick(record, tick, target, pushes, self._apply, last=tick == ticks - 1)
        return self._checked(record)

    def act(self, function: Act, ticks: int, pushes: Sequence[Push] = ()) -> Record:
        """Run a controller in Python, which returns the controls, as :meth:`run` does."""
        nu, data, model, command = self.model.nu, self.data, self.model, self.memory.command
        record = self._empty(ticks, 0, nu, nu)
        if self.loop is not None:
            self.loop.begin(data.ctrl.copy(), self._seed)

        def write(control: FloatArray) -> None:
            data.ctrl[:] = control

        for tick in range(ticks):
            control = _controls(function(model, data, command), nu)
            if not np.isfinite(control).all():
                return self._not_finite(record, tick, None)
            record.action[tick] = control
            self._tick(record, tick, control, pushes, write, last=tick == ticks - 1)
        return self._checked(record)

    def play(self, targets: FloatArray, on: NDArray[np.bool_], force: FloatArray | None = None) -> Record:
        """Play (n, joints) targets without a policy, and record each tick; the motors work where (n,) they are on.

        (n, nv) forces act on the joints beside the motors, and count as theirs.
        """
        record = self._empty(len(targets), 0, 0, len(self.plan.joints))
        if self.loop is not None:
            self.loop.begin(targets[0], self._seed)
        powered = int(self.model.opt.disableflags)
        try:
            for tick, target in enumerate(targets):
                off = 0 if on[tick] else int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
                self.model.opt.disableflags = powered | off
                if force is not None:
                    self.data.qfrc_applied[:] = force[tick]
                self._tick(record, tick, target, (), self._apply, last=tick == len(targets) - 1)
        finally:
            self.model.opt.disableflags = powered
        if force is not None:
            record.torque[:] += force
        return self._checked(record)

    def arriving(self, targets: FloatArray, period: float) -> FloatArray:
        """Return (n, joints) targets of a log as they act on average; a target acts from its tick to the next one."""
        loop = self.loop or Loop(Physics.of(self.model), self.model, self.plan, ())
        return loop.arriving(targets, period)

    def actuated(self, qpos: FloatArray, qvel: FloatArray, target: FloatArray) -> FloatArray:
        """Return (nv,) forces of the actuators in a state under a target."""
        data = self.data
        data.qpos[:], data.qvel[:] = qpos, qvel
        self._apply(target)
        mujoco.mj_fwdPosition(self.model, data)
        mujoco.mj_fwdVelocity(self.model, data)
        mujoco.mj_fwdActuation(self.model, data)
        return np.array(data.qfrc_actuator)

    def _empty(self, ticks: int, width: int, actions: int, targets: int) -> Record:
        model = self.model

        def rows(size: int) -> FloatArray:
            return np.zeros((ticks, size))

        return Record(
            qpos=rows(model.nq),
            qvel=rows(model.nv),
            torque=rows(model.nv),
            torque_before=rows(model.nv),
            sensors=rows(model.nsensordata),
            observation=np.zeros((ticks, width), dtype=np.float32),
            action=rows(actions),
            target=rows(targets),
            command=self.memory.command.copy(),
        )

    def _tick(
        self,
        record: Record,
        tick: int,
        target: FloatArray,
        pushes: Sequence[Push],
        write: drive.Apply,
        last: bool,
    ) -> None:
        """Record the tick, and take its physics steps; after the last tick only one, for its torques."""
        model, data, plan, loop = self.model, self.data, self.plan, self.loop
        for push in pushes:
            data.xfrc_applied[push.body, :3] = 0.0
        for push in pushes:  # several may act on one body
            if push.first <= tick < push.end:
                data.xfrc_applied[push.body, :3] += push.force
        record.qpos[tick], record.qvel[tick] = data.qpos, data.qvel
        record.sensors[tick], record.target[tick] = data.sensordata, target
        record.torque_before[tick] = data.qfrc_actuator
        if loop is not None:
            loop.send(target)
            target = loop.arrived(0)
        if self.rub is not None:
            self.rub(data.qpos)
        write(target)
        if self.weaken is not None:
            self.weaken(data)
        mujoco.mj_step(model, data)
        record.torque[tick] = data.qfrc_actuator
        rest = 0 if last else plan.decimation - 1
        if loop is None and not (self._every_step and write is self._apply):
            mujoco.mj_step(model, data, nstep=rest) if rest else None
            return
        for step in range(1, rest + 1):
            write(target if loop is None else loop.arrived(step))
            if self.weaken is not None:
                self.weaken(data)
            mujoco.mj_step(model, data)

    def _not_finite(self, record: Record, tick: int, observation: Observation | None) -> Record:
        """Return the record up to the last finite state; a BackendError if the controller alone is at fault."""
        good = _good(self.data.qpos[None]) & _good(self.data.qvel[None])
        if good.all() and not self.data.warning.number.any():
            at = tick * self.plan.step
            raise BackendError(f"{self._culprit(observation)} is not finite at t = {at:g} s")
        record.unstable = True
        return self._checked(record.cut(max(tick, 1)))

    def _culprit(self, observation: Observation | None) -> str:
        """Return what is not finite while the state is: a term of the observation, or the controller's output."""
        if observation is not None:
            for part, place in zip(self.observer.parts, self.observer.places, strict=True):
                if not np.isfinite(observation[place]).all():
                    return f"the term {part.name} of the observation"
        return "the output of the controller"

    def _checked(self, record: Record) -> Record:
        """Cut a record where the state is bad, and report MuJoCo's warnings as instability."""
        good = _good(record.qpos) & _good(record.qvel)
        if not good.all():
            record = record.cut(max(int(np.argmin(good)), 1))
            record.unstable = True
        if self.loop is not None:
            self._sense(record)
        record.unstable |= bool(self.data.warning.number.any())
        return record

    def _sense(self, record: Record) -> None:
        """Put into a record what a robot would log."""
        assert self.loop is not None
        record.qpos[:], record.qvel[:] = self.loop.state(record.qpos, record.qvel)
        for first, part in self._sensors:
            place = slice(first, first + part.width)
            rows = np.array([self.loop.measured(part, row) for row in record.sensors[:, place]])
            record.sensors[:, place] = self.loop.received(rows)


def _controls(value: Any, count: int) -> FloatArray:
    """Return (count,) what a controller in Python returned; a BackendError if it is something else."""
    try:
        control = np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        control = np.zeros(0)
    if value is None or control.size != count:
        shown = f"{control.size} numbers" if value is not None and control.size else shortened(repr(value))
        raise BackendError(f"the controller returned {shown}, and the model has {count} actuators")
    return control


def _good(states: FloatArray) -> Any:
    """Return for each row whether MuJoCo would go on from it; NaN is beyond every limit."""
    return (np.abs(states) <= mujoco.mjMAXVAL).all(axis=1)
