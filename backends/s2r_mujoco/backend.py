"""A robot file as a backend: ``robot.toml``, and ``robot.toml:payload=2`` with another default of a parameter."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from math import ceil, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from s2r_mujoco import new
from s2r_mujoco.effects.physics import VARIANTS
from s2r_mujoco.held.player import Player
from s2r_mujoco.held.quality import log_findings
from s2r_mujoco.held.residuals import residuals
from s2r_mujoco.interface.check import loop_findings, torque_is_before
from s2r_mujoco.interface.log import Log
from s2r_mujoco.interface.replay import replayed
from s2r_mujoco.interface.switches import switches
from s2r_mujoco.preflight import findings, trials
from s2r_mujoco.robot import Robot
from s2r_mujoco.rollout import UNSTABLE, Record
from s2r_mujoco.running import Running, running
from s2r_spec.backend import (
    Channel,
    Drawn,
    Effect,
    Finding,
    LoopMistake,
    Needs,
    Parameter,
    Replayed,
    refuse_unknown,
)
from s2r_spec.effects import Choice, Values, as_values, choose, read_options, words
from s2r_spec.errors import TraceError, UsageError, require
from s2r_spec.protocols import PLAYED, PROTOCOL, Protocol, named
from s2r_spec.trace import Trace

if TYPE_CHECKING:
    from s2r_mujoco.pictures import View

_CPU_PER_STEP, _CPU_PER_TICK = 2e-6, 1e-4
"""Budget: time of one core for a physics step, a degree of freedom, and for a control tick [s]; for planning."""
_CAMERA = 4.0
"""Definition: distance of the camera, in distances between the robot's root and its farthest geom."""
_NEAR = 2.6
"""Definition: the same of a camera for small pictures, in which the robot just fits."""


@dataclass(frozen=True)
class RobotBackend:
    """A robot from its MuJoCo model, its policy and its deploy file; see ``docs/how-to/policies.md``.

    Args:
        text: path of the robot file; ``NAME=VALUE`` after a colon replaces the default of a parameter.
        duration: duration of a rollout [s]; 0 for that of the file.
        wanted: parameters of a specification, whose ranges count where no file states one.
        added: effects; more follow from ``EFFECT.PARAMETER=VALUE`` after the colon.
        variant: name of another simulator of the same physics (:meth:`variants`).
        loop_keys: keys of a robot file, in TOML, that replace those of the file: the loop of a machine with a mistake.
        torque_before: whether a trace has the torques of the physics step before the sample, not after it.
    """

    text: str
    duration: float = 0.0
    wanted: tuple[Parameter, ...] = field(default=(), repr=False)
    added: Choice = ()
    variant: str = field(default="", repr=False)
    loop_keys: str = field(default="", repr=False)
    torque_before: bool = field(default=False, repr=False)
    deterministic: bool = field(default=True, init=False)

    def __post_init__(self) -> None:
        """Read the files, and round the duration up to whole control periods."""
        duration = self.duration or self._robot.description.table.duration
        object.__setattr__(self, "duration", self._ticks(duration) * self._robot.plan.step)
        _ = self._defaults

    def __getstate__(self) -> dict[str, Any]:
        """Pickle the declaration alone; another process reads the files again."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

    draft, problem = staticmethod(new.draft), staticmethod(new.problem)

    @property
    def name(self) -> str:
        """Name as in ``--backend``, with the effects."""
        parts = [self._parts[1], *words(self.added)]
        return ":".join(filter(None, (self._parts[0], ",".join(filter(None, parts)))))

    @cached_property
    def _running(self) -> Running:
        return running(Path(self._parts[0]), self.loop_keys)

    @property
    def _robot(self) -> Robot:
        return self._running.robot

    @property
    def _parts(self) -> tuple[str, str]:
        """The path, and the options after the colon."""
        match = re.fullmatch(r"(?s)(.*\.toml)(?::(.*))?", self.text)
        if match is None:
            raise UsageError(f"{self.text!r} is not the path of a robot file, which ends in .toml")
        return match[1], match[2] or ""

    @cached_property
    def _defaults(self) -> dict[str, float]:
        """Parameter → its default, with the options after the colon."""
        own = {name: one.declared.default for name, one in self._robot.parameters.items()}
        return own | {name: self._checked(name, value) for name, value in self._options[0].items()}

    @cached_property
    def _options(self) -> tuple[dict[str, str], Choice]:
        """The parameters and the effects after the colon."""
        text, known = self._parts[1], dict.fromkeys(self._robot.parameters, ())
        catalogue = self._robot.catalogue if "." in text else ()
        return read_options(self._robot.name, text, known, catalogue)

    @cached_property
    def _choice(self) -> Choice:
        """The effects of the file, those after the colon, and those added; a later value replaces an earlier one."""
        choice, robot = self._robot.stated, self._robot
        for more in (self._options[1], self.added):
            choice = choose(robot.name, robot.catalogue, choice, as_values(more)) if more else choice
        return choice

    def effects(self) -> tuple[Effect, ...]:
        """Return the catalogue; see ``docs/how-to/policies.md``."""
        return self._robot.catalogue

    def chosen(self) -> Values:
        """Return effect → parameter → value of the effects of this backend."""
        return as_values(self._choice)

    def with_effects(self, values: Values) -> Self:
        """Return this robot with effects: ``{"dry_friction": {"knee": 1.0}}``.

        Raises:
            UsageError: an effect or a parameter is unknown, or a value out of range.
        """
        return replace(self, added=choose(self._robot.name, self._robot.catalogue, self.added, values))

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The channels of a trace."""
        return self._robot.channels

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters of a test. One whose range no file states has that of the specification."""
        wanted, found = {one.name: one for one in self.wanted}, []
        for name, one in self._robot.parameters.items():
            declared = replace(one.declared, default=self._defaults[name])
            if not one.limited:
                other, ends = wanted.get(name), [declared.default]
                ends += [] if other is None else [_in(declared, other, x) for x in (other.low, other.high)]
                declared = replace(declared, low=min(ends), high=max(ends))
            found.append(declared)
        return tuple(found)

    @property
    def cost(self) -> float:
        """Expected time of one rollout on one core [s]."""
        plan, model = self._robot.plan, self._robot.model
        return self._ticks(self.duration) * (_CPU_PER_TICK + _CPU_PER_STEP * model.nv * plan.decimation)

    @cached_property
    def model_hash(self) -> str:
        """Hash of the robot file, of every file that it names or includes, of versions and of this package."""
        own = repr(sorted(self._defaults.items())) + repr(self._choice or "") + self.variant
        return self._robot.digest(own + self.loop_keys + "torque before" * self.torque_before)

    def with_duration(self, seconds: float) -> Self:
        """Return this backend with rollouts of this duration [s], rounded up to whole control periods."""
        return replace(self, duration=seconds)

    def for_spec(self, needs: Needs) -> Self:
        """Return this backend with the ranges of a specification, where no file states one.

        Raises:
            UsageError: an option gives another default to a parameter that the specification sweeps.
        """
        swept = {one.name for one in needs.parameters}
        for name, value in self._defaults.items():
            if name in swept and value != self._robot.parameters[name].declared.default:
                raise UsageError(
                    f"{self.name}: the option {name} has no effect, since the specification sweeps {name}; "
                    f"leave it out here or there"
                )
        return replace(self, wanted=needs.parameters)

    def prepare(self) -> None:
        """Compile the model, load the policy and parse the conditions of a failure."""
        self._running.prepare(self._defaults)

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Run one test; samples every control period from t = 0 to ``duration`` inclusive.

        A failure of the robot file, a state that is not finite, or a warning of MuJoCo ends the trace and sets
        ``meta["failure"]``.

        Raises:
            UsageError: a parameter is unknown or out of range.
            BackendError: the controller is at fault.
        """
        return self._rolled(params, seed)[1]

    def _rolled(self, params: Mapping[str, float], seed: int) -> tuple[Record, Trace]:
        """Return the record of a test, and its trace, which a failure ends."""
        refuse_unknown(self.name, self.parameters, params)
        test = self._defaults | {name: self._checked(name, value) for name, value in params.items()}
        ticks = self._ticks(self.duration) + 1
        record = self._running.run(test, seed, ticks, added=self._choice, variant=self.variant)
        logged = replace(record, torque=record.torque_before) if self.torque_before else record
        return record, self._trace(self._robot, logged, {"params": test, "seed": seed})

    def render(self, params: Mapping[str, float], seed: int, path: str | Path) -> Trace:
        """Run one test and draw it: eight tiles over the rollout (.png, .jpg) or a short video (.gif, .webp).

        Raises:
            UsageError: as :meth:`rollout`; or pictures cannot be drawn on this machine.
        """
        from s2r_mujoco.pictures import TILES, draw

        record, trace = self._rolled(params, seed)
        tiles = np.linspace(0, len(trace) - 1, TILES[0] * TILES[1]).round().astype(int)
        model, view = self._scene(params)
        rate = 1.0 / self._robot.plan.step
        draw(model, record.qpos[: len(trace)], tiles.tolist(), rate, view, Path(path))
        return trace

    def draw_trace(
        self, trace: Trace, params: Mapping[str, float], times: Sequence[float], beside: Trace
    ) -> Drawn:
        """Draw a trace at times [s]; what it lacks is as in a simulated one. See :class:`HasTracePictures`."""
        from s2r_mujoco.pictures import frames, positions_of

        positions, missing = positions_of(self._robot, trace, times, beside)
        model, view = self._scene(params)
        view = replace(view, distance=_NEAR * self._robot.reach, shadows=False)
        return Drawn(np.array([*frames(model, positions, view)]), missing)

    def _scene(self, params: Mapping[str, float]) -> tuple[Any, View]:
        """Return the model of a test with its pictures, and the camera."""
        from s2r_mujoco.pictures import View

        robot = self._robot
        model = robot.file.compile(robot.changes(self._defaults | dict(params)), pictures=True)
        return model, View(_CAMERA * robot.reach, 0.3 * robot.reach, max(robot.plan.root, 0))

    def preflight(self, *, run: bool) -> Iterator[Finding]:
        """Yield what the files say together, and what is wrong with it; see :class:`s2r_spec.backend.HasPreflight`."""
        yield from findings(self._robot, self.parameters)
        if run:
            yield from trials(self._running, self.parameters)

    def variants(self) -> dict[str, Self]:
        """Return name → this robot with another time step or contact model, each as plausible."""
        touches = self._robot.plan.root >= 0
        return {
            name: replace(self, variant=name)
            for name, changes in VARIANTS.items()
            if touches or "softness" not in changes
        }

    def write_found(
        self, values: Values, folder: Path, mistakes: Sequence[LoopMistake] = ()
    ) -> list[Finding]:
        """Write this robot with effects and mistakes as files; see :class:`s2r_spec.backend.WritesFound`.

        Raises:
            UsageError: the folder is there already, or cannot be written.
        """
        require("robot files with what was found need", "tomlkit")
        from s2r_mujoco.found.write import write

        return write(self._robot, self.with_effects(values)._choice, mistakes, folder)

    def loop(self, trace: Trace) -> Iterator[Finding]:
        """Yield what a log says of the control loop of the files; see :class:`s2r_spec.backend.HasLoop`."""
        if self._robot.held or trace.meta.get(PROTOCOL):
            yield from log_findings(self._player, trace)
        else:
            yield from loop_findings(self._robot, trace)

    @cached_property
    def _player(self) -> Player:
        """The robot without its policy, held in the air."""
        mine = self._running
        held = mine if mine.robot.held else running(Path(self._parts[0]), held=True)
        return Player(held, self.cost / self.duration)

    def protocols(self) -> tuple[Protocol, ...]:
        """Return the protocols of the held robot; none if its joints are not driven to positions."""
        return self._player.protocols() if self._is_driven else ()

    @property
    def _is_driven(self) -> bool:
        """Whether all joints of the files are driven to positions, so that the robot moves without its policy."""
        law = self._robot.plan.law
        return bool((law.has_target & ~law.speed).all())

    def run(self, protocol: str, params: Mapping[str, float], seed: int) -> Trace:
        """Run a protocol on the held robot; see :class:`s2r_spec.protocols.HasProtocols`."""
        named(self.protocols(), protocol, self.name)
        motion, values = self._player.motion(protocol, params)
        record = self._player.run(motion, seed, self._choice, self.variant)
        return self._trace(self._player.robot, record, {PROTOCOL: protocol, "params": values, "seed": seed})

    def playable(self, protocol: str, params: Mapping[str, float]) -> Trace:
        """Return the references of a protocol for the robot's own joint controller."""
        return self._player.playable(protocol, params)

    def play(self, inputs: Trace, params: Mapping[str, float], seed: int) -> Trace:
        """Play the ``target`` of a log, or else its ``tau``, on the held robot, from the log's first positions."""
        refuse_unknown(self.name, self.parameters, params)
        record = self._player.replay(inputs, seed, self._choice, self.variant)
        facts = {PROTOCOL: PLAYED, "params": dict(params), "seed": seed}
        trace = self._trace(self._player.robot, record, facts)
        return trace if "target" in inputs.channels else trace.only(trace.channels.keys() - {"target"})

    def residuals(self, trace: Trace, params: Mapping[str, float] | None = None) -> Trace:
        """Return the torques that the model does not explain; see :mod:`s2r_mujoco.held.residuals`.

        Raises:
            TraceError: the trace is of a test with a policy, whose contacts no log has; or it lacks channels.
        """
        if not (self._robot.held or trace.meta.get(PROTOCOL)):
            raise TraceError("forces of contacts are unknown in a test, so only a held robot has residuals")
        if "target" in trace.channels and not self._is_driven:
            raise TraceError(
                "the files drive the joints to no positions, so nothing is known of the actuators"
            )
        return residuals(self._player, trace, params or {}, self._choice)

    def replayed(self, traces: Sequence[Trace]) -> Replayed | None:
        """Return which loop recordings show, by the policy on their state; see :mod:`s2r_mujoco.interface.replay`."""
        return None if self._robot.held else replayed(self._logs(traces))

    def _logs(self, traces: Sequence[Trace]) -> list[Log]:
        return [Log(self._robot, trace) for trace in traces]

    def as_logged(self, traces: Sequence[Trace]) -> Self:
        """Return this robot with the torques of the physics step before a sample, where recordings have these."""
        return self if self._robot.held else replace(self, torque_before=torque_is_before(self._logs(traces)))

    def mistakes(self) -> dict[LoopMistake, Self]:
        """Return the mistakes that the files make possible, and for each this robot with that loop."""
        found = [] if self._robot.held else [one.mistake for one in switches(self._robot)]
        return {one: self.with_mistakes([one]) for one in found}

    def with_mistakes(self, mistakes: Sequence[LoopMistake]) -> Self:
        """Return this robot with the loop of the last of these mistakes."""
        return replace(self, loop_keys=mistakes[-1].keys) if mistakes else self

    def _trace(self, robot: Robot, record: Record, facts: dict[str, Any]) -> Trace:
        """Return the trace of a record up to its first failure."""
        meta: dict[str, Any] = {"backend": self.name, "model_hash": self.model_hash, **facts}
        if record.unstable:
            meta["failure"] = UNSTABLE
        trace = robot.trace(record, meta)
        failure = robot.failures.first(trace)
        if failure is None:
            return trace
        name, last = failure
        cut = {key: values[: last + 1] for key, values in trace.channels.items()}
        return Trace(trace.times[: last + 1], cut, trace.units, meta | {"failure": name})

    def _ticks(self, seconds: float) -> int:
        return ceil(seconds / self._robot.plan.step - 1e-9)

    def _checked(self, name: str, value: Any) -> float:
        one = self._robot.parameters[name]
        if one.limited:
            return one.declared.check(value)
        number = replace(one.declared, low=-np.inf, high=np.inf).check(value)
        if not isfinite(number):
            raise UsageError(f"{self._robot.name}: {name} = {value!r} is not a finite number")
        return number


def _in(declared: Parameter, other: Parameter, value: float) -> float:
    """Return a value of the specification in the unit of the robot file."""
    free = replace(declared, low=-np.inf, high=np.inf)
    return free.check(f"{value!r} {other.unit}" if other.unit and declared.unit else value)
