"""Rollouts of a robot: the simulator of a test, its start, its pushes, and the user's own code."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property, lru_cache
from inspect import signature
from pathlib import Path
from threading import Lock
from traceback import extract_tb
from typing import Any
from zlib import crc32

import mujoco
import numpy as np
from numpy.typing import NDArray

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.description import COMMANDS, ParameterTable
from s2r_mujoco.model import FieldChange
from s2r_mujoco.parameters import body_of
from s2r_mujoco.robot import KEPT, Robot, terms
from s2r_mujoco.rollout import Push, Record, Simulator
from s2r_mujoco.start import draw, start_pose
from s2r_spec.backend import LoadedCode, load_code
from s2r_spec.effects import Choice
from s2r_spec.errors import BackendError, S2RError, UsageError


class Running:
    """Runs tests of one robot, one at a time. What a rollout leaves behind is reset before the next one."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._stamps = _stamps(robot)
        self._lock = Lock()
        self._made = lru_cache(maxsize=KEPT)(self._make)

    @cached_property
    def code(self) -> dict[str, LoadedCode]:
        """The user's own code by its name in the robot file. It runs when it is loaded."""
        folder = self.robot.description.path.parent
        return {name: load_code(name, folder) for name in self.robot.code_names}

    def prepare(self, values: Mapping[str, float]) -> None:
        """Load the user's code, compile the model of a test, and parse the conditions of a failure."""
        self.robot.failures.check()
        self.simulator(values)

    def simulator(self, values: Mapping[str, float], added: Choice = (), variant: str = "") -> Simulator:
        """Return the simulator with the fields of a test, and with effects; the last ones are kept."""
        with self._explaining():  # a term of the user's own is called once for its width
            return self._made(tuple(self.robot.changes(values).items()), added, variant)

    @property
    def is_current(self) -> bool:
        """Whether every file is as it was when the robot was read."""
        return _stamps(self.robot) == self._stamps

    def _make(self, changes: tuple[tuple[FieldChange, float], ...], added: Choice, variant: str) -> Simulator:
        if not self.is_current:  # a test with another field would be of another model than those before it
            raise UsageError(
                f"a file of {self.robot.name} has changed since it was read; load the backend again, or begin a new run"
            )
        users = {
            term.name: _function(term.name, self.code[term.name].value)
            for term in self.robot.plan.terms
            if term.name in self.code
        }
        physics = self.robot.physics(added, variant) if added or variant else None
        edit = None if physics is None else physics.edit
        model = self.robot.file.compile(dict(changes), edit=edit)
        simulator = Simulator(model, self.robot.plan, users, physics)
        self.robot.refuse_width(simulator.observer.parts)
        self._try(simulator)
        return simulator

    def _try(self, simulator: Simulator) -> None:
        """Evaluate a policy once whose file does not say how many numbers it takes and returns."""
        policy, observer = self.robot.policy, simulator.observer
        if policy is None or None not in (policy.width, policy.outputs):
            return
        try:
            outputs = policy(np.zeros(observer.width, dtype=np.float32)).size
        except UsageError as error:
            raise UsageError(f"{error}; the observation is {terms(observer.parts)}") from None
        finally:
            policy.reset()
        self.robot.refuse_outputs(outputs)

    def run(
        self,
        values: Mapping[str, float],
        seed: int,
        ticks: int,
        command: Mapping[str, float] | None = None,
        added: Choice = (),
        variant: str = "",
    ) -> Record:
        """Run one test.

        Args:
            values: parameter → value, of every parameter.
            seed: seed of the noise.
            ticks: control ticks to record.
            command: component → value instead of that of the test.
            added: effects.
            variant: name of another simulator of the same physics.

        Raises:
            BackendError: the controller is at fault.
        """
        robot, table = self.robot, self.robot.description.table
        if command is None:
            command = {
                name: values.get(one.parameter, one.value) for name, one in robot.plan.commands.items()
            }
        pushes = [self._push(one, values[name]) for name, one in table.parameters.items() if one.push]
        # An unstable rollout is an answer: no warning of NumPy, and no MUJOCO_LOG.TXT in the user's folder.
        mujoco.set_mju_user_warning(_silent)
        with self._lock, self._explaining(), np.errstate(over="ignore", invalid="ignore"):
            simulator = self.simulator(values, added, variant)
            pose = start_pose(simulator.model, robot.plan, table.start, robot.name)
            position, velocity = draw(simulator.model, robot.plan, table.start, seed)
            simulator.begin(pose + position, velocity, command, robot.plan.key, seed)
            before = _fingerprint(simulator.model) if robot.code_names else 0
            try:
                return self._run(simulator, ticks, pushes)
            finally:
                if before and _fingerprint(simulator.model) != before:
                    self._made.cache_clear()  # the user's code changed the model: the next rollout compiles it anew

    def play(
        self,
        start: tuple[FloatArray, FloatArray],
        targets: FloatArray,
        on: NDArray[np.bool_],
        seed: int,
        added: Choice = (),
        variant: str = "",
        force: FloatArray | None = None,
    ) -> Record:
        """Play (n, joints) targets from a state, (nq,) and (nv,); see :meth:`Simulator.play`."""
        mujoco.set_mju_user_warning(_silent)
        with self._lock, self._explaining(), np.errstate(over="ignore", invalid="ignore"):
            simulator = self.simulator({}, added, variant)
            simulator.begin(*start, dict.fromkeys(COMMANDS, 0.0), self.robot.plan.key, seed)
            return simulator.play(targets, on, force)

    def _run(self, simulator: Simulator, ticks: int, pushes: list[Push]) -> Record:
        policy, name = self.robot.policy, self.robot.description.table.policy
        if self.robot.held:  # no controller: the joints stay at the default pose
            return simulator.play(np.tile(self.robot.plan.pose, (ticks, 1)), np.ones(ticks, dtype=np.bool_))
        if policy is not None:
            policy.reset()
            return simulator.run(policy, ticks, pushes)
        value = self.code[name].value
        function = value() if isinstance(value, type) else value
        return simulator.act(_function(name, getattr(function, "act", function)), ticks, pushes)

    def _push(self, table: ParameterTable, force: float) -> Push:
        step, body = self.robot.plan.step, body_of(self.robot.model, table.push, self.robot.name)
        first = round(table.at / step)
        direction = np.array(table.direction) / np.linalg.norm(table.direction)
        return Push(body, force * direction, first, first + max(1, round(table.lasts / step)))

    @contextmanager
    def _explaining(self) -> Iterator[None]:
        """Name the line of the user's code that raised an error."""
        try:
            yield
        except S2RError:
            raise
        except (Exception, SystemExit) as error:
            own = {str(path) for code in self.code.values() for path in code.files}
            lines = [at for at in extract_tb(error.__traceback__) if at.filename in own]
            if not lines:
                raise
            where = f"{Path(lines[-1].filename).name}, line {lines[-1].lineno}"
            raise BackendError(f"{where}, raised {type(error).__name__}: {error}") from error


def _fingerprint(model: Any) -> int:
    """Return a checksum of every number of a model; never 0."""
    content = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return crc32(content.tobytes()) + 1


def _function(name: str, value: Any) -> Any:
    """Return a function of the user's; a UsageError if it does not take three arguments."""
    try:
        signature(value).bind(None, None, None)
    except TypeError:
        raise UsageError(f"{name} must be a function of three arguments: (model, data, command)") from None
    except ValueError:  # a function in C does not say
        pass
    return value


def _silent(words: str) -> None:
    """Print nothing; ``data.warning`` counts the warnings."""


LOOPS = 16
"""Budget: robots that a process keeps."""
_KEPT: dict[tuple[Path, str, bool], Running] = {}


def running(path: Path, loop: str = "", held: bool = False) -> Running:
    """Return the rollouts of a robot file, with the keys of another loop, or held in the air.

    It is the same object until a file changes.

    Raises:
        UsageError: a file is missing, or is wrong; see :class:`Robot`.
    """
    key = path.resolve(), loop, held
    kept = _KEPT.get(key)
    if kept is not None and kept.is_current:
        return kept
    for old in [*_KEPT][: len(_KEPT) - LOOPS]:
        del _KEPT[old]
    # MuJoCo keeps meshes and sees a change only by the second.
    mujoco.mj_clearCache(mujoco.mj_getCache())
    _KEPT[key] = Running(Robot(key[0], loop, held))
    return _KEPT[key]


def _stamps(robot: Robot) -> tuple[tuple[int, ...], ...]:
    found = [path.stat() if path.exists() else None for path in robot.files]
    return tuple(() if one is None else (one.st_mtime_ns, one.st_size, one.st_ino) for one in found)
