"""The observation of a policy, term by term.

The values of all terms stand in one vector x; then, as Isaac Lab does, each is clipped and scaled, and joins its
history. A history begins filled with the first observation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import cos, pi, sin
from typing import Any, Literal

import mujoco
import numpy as np

from s2r_mujoco import joints as joint_order
from s2r_mujoco.arrays import FloatArray, IntArray, Observation
from s2r_mujoco.deploy.record import TERMS, Term
from s2r_mujoco.plan import Plan
from s2r_spec.errors import BackendError, UsageError, did_you_mean, one_of, shortened, suggest

Read = Callable[[int], Any]
"""The value of a term at a control tick, from its number."""
UserTerm = Callable[[Any, Any, FloatArray], Any]
"""A user's own term: a function of model, data and command."""


@dataclass
class Memory:
    """What a rollout remembers between two ticks: the command, and the last action."""

    command: FloatArray
    last_action: FloatArray


Senses = Literal["vector", "angular", "position", "other", "known"]
"""What a term is to an error of sensing: a vector or an angular velocity in axes of the IMU, positions of joints,
another measurement, or something that the controller knows by itself."""


@dataclass(frozen=True)
class Part:
    """A term with its width and its reader, and what it senses; ``dof`` has the joints of positions."""

    term: Term
    width: int
    read: Read
    senses: Senses = "other"
    dof: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    @property
    def name(self) -> str:
        """Name of the term, or of its sensor."""
        return self.term.sensor or self.term.name


def phases(term: Term, step: float) -> Read:
    """Return the reader of a phase: sines and cosines of every start plus 2π f t."""
    start, rate = term.start or (0.0,), 2.0 * pi * term.frequency * step
    functions = [{"sin": sin, "cos": cos}[part] for part in term.parts or ("sin", "cos")]

    def read(tick: int) -> list[float]:
        return [function(one + rate * tick) for function in functions for one in start]

    return read


class Parts:
    """Makes the parts of an observation for one model and its data."""

    def __init__(self, plan: Plan, model: Any, data: Any, memory: Memory) -> None:
        self._plan, self._model, self._data, self._memory = plan, model, data, memory
        self._user: dict[str, UserTerm] = {}

    def of(self, terms: Sequence[Term], users: dict[str, UserTerm]) -> tuple[Part, ...]:
        """Return the parts of these terms; ``users`` has the function of each term of the user's own.

        Raises:
            UsageError: there is no such term, sensor or site.
        """
        self._user = users
        return tuple(self._part(term) for term in terms)

    def _part(self, term: Term) -> Part:
        if term.name == "sensor":
            return self._sensor(term)
        if term.name == "phase":
            parts, start = term.parts or ("sin", "cos"), term.start or (0.0,)
            return Part(term, len(parts) * len(start), phases(term, self._plan.step), "known")
        if term.name in self._user:
            return self._own(term)
        if term.name in ("base_lin_vel", "base_ang_vel", "projected_gravity"):
            return Part(term, 3, self._base(term), "angular" if term.name == "base_ang_vel" else "vector")
        positions, velocities = self._data.qpos, self._data.qvel
        qpos, dof = self._joints(term)
        n, pose = len(qpos), self._plan.home[qpos]
        readers: dict[str, tuple[int, Read]] = {
            "joint_pos": (n, lambda tick: positions[qpos]),
            "joint_pos_rel": (n, lambda tick: positions[qpos] - pose),
            "joint_vel": (n, lambda tick: velocities[dof]),
            "joint_vel_rel": (n, lambda tick: velocities[dof]),
            "last_action": (self._memory.last_action.size, lambda tick: self._memory.last_action),
            "velocity_commands": (3, lambda tick: self._memory.command),
        }
        if term.name not in readers:
            sensors = [self._model.sensor(i).name for i in range(self._model.nsensor)]
            close = (
                f'; write {{ sensor = "{term.name}" }}'
                if term.name in sensors
                else did_you_mean(term.name, TERMS)
            )
            known = one_of(set(TERMS) - {"phase", "sensor"})
            raise UsageError(
                f"{term.source}: there is no term {term.name!r}{close}; possible terms are {known}, a phase, a "
                f"sensor, and file.py:function"
            )
        senses: dict[str, Senses] = {
            "joint_pos": "position", "joint_pos_rel": "position", "last_action": "known", "velocity_commands": "known"
        }  # fmt: skip
        return Part(term, *readers[term.name], senses.get(term.name, "other"), dof)

    def _joints(self, term: Term) -> tuple[IntArray, IntArray]:
        """Return the indices of positions and velocities that a joint term reads."""
        if term.names:
            joints = joint_order.named(
                self._model, joint_order.by_patterns(self._model, term.names, term.source)
            )
            return joints.qpos, joints.dof
        chosen = np.array(term.joints or range(len(self._plan.joints)), dtype=np.intp)
        return self._plan.joints.qpos[chosen], self._plan.joints.dof[chosen]

    def _sensor(self, term: Term) -> Part:
        model = self._model
        names = [model.sensor(i).name for i in range(model.nsensor)]
        if term.sensor not in names:
            raise UsageError(
                f"{term.source}: the model has no sensor {term.sensor!r}{suggest(term.sensor, names)} "
                f"it has {one_of(filter(None, names))}"
            )
        sensor = names.index(term.sensor)
        first, width = int(model.sensor_adr[sensor]), int(model.sensor_dim[sensor])
        values = self._data.sensordata[first : first + width]
        if term.frame == "body":
            return sensed(model, sensor, term, lambda tick: values)
        if term.frame != "world" or width != 3 or model.sensor_objtype[sensor] != mujoco.mjtObj.mjOBJ_SITE:
            raise UsageError(
                f'{term.source}: a sensor of three numbers at a site has frame = "body" or "world", not {term.frame!r}'
            )
        matrix = self._data.site_xmat[int(model.sensor_objid[sensor])].reshape(3, 3)
        return sensed(model, sensor, term, lambda tick: matrix @ values)

    def _own(self, term: Term) -> Part:
        function, model, data, memory = self._user[term.name], self._model, self._data, self._memory
        width = int(np.size(function(model, data, memory.command)))

        def read(tick: int) -> FloatArray:
            value = function(model, data, memory.command)
            try:
                numbers = np.asarray(value, dtype=np.float64).ravel()
            except (TypeError, ValueError):
                numbers = np.zeros(0)
            if numbers.size != width or not width:
                raise BackendError(
                    f"{term.source}: {term.name} returned {shortened(repr(value))}; it must return numbers, as many at "
                    f"every tick"
                )
            return numbers

        return Part(term, width, read)

    def _base(self, term: Term) -> Read:
        site = self._site(term)
        if site >= 0:
            return self._at_site(term, site)
        if self._plan.root < 0:
            raise UsageError(
                f"{term.source}: {term.name} needs a body with a free joint, and the model has none; "
                f"add <freejoint/> to its base in the XML file"
            )
        first = int(self._model.body_jntadr[self._plan.root])
        position, velocity = int(self._model.jnt_qposadr[first]), int(self._model.jnt_dofadr[first])
        quaternion = self._data.qpos[position + 3 : position + 7]
        # MuJoCo keeps the linear velocity of a free joint in world axes, and the angular one in body axes.
        linear = self._data.qvel[velocity : velocity + 3]
        angular = self._data.qvel[velocity + 3 : velocity + 6]
        flat = np.zeros(9)
        matrix, world = flat.reshape(3, 3), term.frame == "world"

        def rotated(value: FloatArray, back: bool) -> Read:
            def read(tick: int) -> FloatArray:
                mujoco.mju_quat2Mat(flat, quaternion)
                return value @ matrix if back else matrix @ value

            return read

        if term.name == "projected_gravity":
            return rotated(down(self._model), back=True)
        if term.name == "base_ang_vel":
            return rotated(angular, back=False) if world else lambda tick: angular
        return (lambda tick: linear) if world else rotated(linear, back=True)

    def _at_site(self, term: Term, site: int) -> Read:
        model, data, velocity = self._model, self._data, np.zeros(6)
        if term.name == "projected_gravity":
            below, matrix = down(model), data.site_xmat[site].reshape(3, 3)
            return lambda tick: below @ matrix
        half = slice(0, 3) if term.name == "base_ang_vel" else slice(3, 6)

        def read(tick: int) -> FloatArray:
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, velocity, 1)
            return velocity[half]

        return read

    def _site(self, term: Term) -> int:
        if term.frame in ("body", "world"):
            return -1
        sites = [self._model.site(i).name for i in range(self._model.nsite)]
        if term.frame not in sites:
            raise UsageError(
                f"{term.source}: frame = {term.frame!r} is not body, world or a site{suggest(term.frame, sites)} "
                f"sites are {one_of(filter(None, sites))}"
            )
        return sites.index(term.frame)


def down(model: Any) -> FloatArray:
    """Return (3,) the direction of gravity."""
    length = float(np.linalg.norm(model.opt.gravity))
    return np.asarray(model.opt.gravity / length) if length else np.array([0.0, 0.0, -1.0])


_SENSES: dict[Any, Senses] = {
    mujoco.mjtSensor.mjSENS_GYRO: "angular", mujoco.mjtSensor.mjSENS_VELOCIMETER: "vector",
    mujoco.mjtSensor.mjSENS_ACCELEROMETER: "vector", mujoco.mjtSensor.mjSENS_JOINTPOS: "position",
}  # fmt: skip
"""Definition: type of a sensor → what it is to an error of sensing."""


def sensed(model: Any, sensor: int, term: Term, read: Read) -> Part:
    """Return the part of a sensor of the model."""
    senses = _SENSES.get(mujoco.mjtSensor(int(model.sensor_type[sensor])), "other")
    joint = int(model.sensor_objid[sensor]) if senses == "position" else 0
    dof = model.jnt_dofadr[[joint]].astype(np.intp) if model.njnt else np.zeros(0, dtype=np.intp)
    return Part(term, int(model.sensor_dim[sensor]), read, senses, dof)


class Observer:
    """Gives the observation of every control tick of one rollout after the other."""

    def __init__(
        self, parts: tuple[Part, ...], plan: Plan, sense: Callable[[FloatArray], FloatArray] | None = None
    ) -> None:
        self.parts, self._sense = parts, sense
        ends = np.cumsum([0, *(part.width for part in parts)])
        self._slices = [
            (slice(a, b), part.read) for a, b, part in zip(ends[:-1], ends[1:], parts, strict=True)
        ]
        self._values = np.zeros(int(ends[-1]))
        self._component = self._components(ends)
        self._late = np.repeat([part.term.late for part in parts], [part.width for part in parts]).astype(int)
        self._past: list[FloatArray] = []
        self._scale = self._across(lambda term: term.scale, 1.0)
        self._first = self._limits(lambda term: term.clip if term.clip_first else None)
        self._last = self._limits(lambda term: term.clip if not term.clip_first else None)
        self._whole, self._from_zero = plan.observation_clip, plan.history_start == "zero"
        self._order = self._history_order(plan)
        self._history = np.zeros((max((part.term.history for part in parts), default=1), self._values.size))

    @property
    def width(self) -> int:
        """Numbers in an observation, with histories."""
        return self._values.size if self._order is None else self._order.size

    @property
    def places(self) -> tuple[IntArray, ...]:
        """For each term, the indices of its newest value in an observation."""
        found = []
        for where, _ in self._slices:
            newest = np.arange(where.start, where.stop)
            if self._order is not None:
                newest = newest + (len(self._history) - 1) * self._values.size
                position = np.argsort(self._order)
                newest = position[np.searchsorted(self._order[position], newest)]
            found.append(newest.astype(np.intp))
        return tuple(found)

    def read(self, tick: int) -> Observation:
        """Return (width,) the observation at a control tick; tick 0 begins a rollout."""
        values = self._values
        for where, read in self._slices:
            values[where] = read(tick)
        if self._sense is not None:
            values = self._sense(values)
        if self._component is not None:
            values = values[self._component]
        if self._late.any():
            self._past = [*([] if tick == 0 else self._past[-self._late.max() :]), values.copy()]
            newest = len(self._past) - 1
            values = np.stack(self._past)[np.maximum(newest - self._late, 0), np.arange(values.size)]
        scaled = values if self._first is None else np.clip(values, *self._first)
        scaled = scaled * self._scale
        if self._last is not None:
            scaled = np.clip(scaled, *self._last)
        if self._whole is not None:
            scaled = np.clip(scaled, *self._whole)
        if self._order is None:
            return scaled.astype(np.float32)
        history = self._history
        if tick == 0:
            history[:] = 0.0 if self._from_zero else scaled
            history[-1] = scaled
        else:
            history[:-1] = history[1:]
            history[-1] = scaled
        return history.ravel()[self._order].astype(np.float32)

    def _components(self, ends: IntArray) -> IntArray | None:
        """Return the index of what each component holds, where a term has another order; None where none has."""
        if not any(part.term.order for part in self.parts):
            return None
        found = []
        for part, first in zip(self.parts, ends[:-1].tolist(), strict=True):
            order = part.term.order or tuple(range(part.width))
            if len(order) != part.width or max(order) >= part.width:
                raise UsageError(
                    f"{part.term.source}: order needs {part.width} numbers from 0 to {part.width - 1}, one for each "
                    f"component of {part.name}"
                )
            found.append(first + np.array(order, dtype=np.intp))
        return np.concatenate(found)

    def _across(self, choose: Callable[[Term], tuple[float, ...]], default: float) -> FloatArray:
        """Return one number for each component."""
        found = []
        for part in self.parts:
            own = choose(part.term) or (default,)
            if len(own) not in (1, part.width):
                raise UsageError(
                    f"{part.term.source}: the scale has {len(own)} numbers, and the term {part.term.name} {part.width}"
                )
            found.append(np.broadcast_to(own, part.width))
        return np.concatenate(found) if found else np.zeros(0)

    def _limits(
        self, choose: Callable[[Term], tuple[float, float] | None]
    ) -> tuple[FloatArray, FloatArray] | None:
        if not any(choose(part.term) for part in self.parts):
            return None
        low = self._across(lambda term: (choose(term) or (-np.inf, np.inf))[:1], -np.inf)
        return low, self._across(lambda term: (choose(term) or (-np.inf, np.inf))[1:], np.inf)

    def _history_order(self, plan: Plan) -> IntArray | None:
        """Return the indices into the history, oldest row first, in the order of the policy; None without history."""
        lengths = [part.term.history for part in self.parts]
        if all(length == 1 for length in lengths):
            return None
        depth, width = max(lengths), self._values.size
        index = np.arange(depth * width).reshape(depth, width)
        if plan.history_by == "time":
            if len(set(lengths)) > 1:
                raise UsageError(
                    f"{self.parts[0].term.source}: a history by time needs the same length in every term, "
                    f"and there are {one_of(map(str, set(lengths)))}"
                )
            newest_first = self.parts[0].term.newest_first
            return (index[::-1] if newest_first else index).ravel().astype(np.intp)
        blocks = []
        for (where, _), part in zip(self._slices, self.parts, strict=True):
            rows = index[depth - part.term.history :, where]
            blocks.append((rows[::-1] if part.term.newest_first else rows).ravel())
        return np.concatenate(blocks).astype(np.intp)
