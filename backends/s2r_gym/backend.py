"""The `gym` backend: a Gymnasium environment with a policy.

    gym:ID[,policy=FILE][,dt=SECONDS][,NAME=VALUE…]

``gym:Pendulum-v1,policy=pd.py:act`` runs the function ``act(observation)`` of ``pd.py``. The option ``m=1.2`` gives a
twin with another mass.

Channels, with a sample at t = 0 and after every step of the environment:

* ``obs``: the observation, and its columns by name in the environments of :data:`NAMES`;
* ``action``: the action from this sample to the next, after it was limited to the bounds of the environment. Both
  Gymnasium's environments and Stable-Baselines3 limit it so;
* ``reward``: the reward of the step that begins at this sample.

The last sample repeats action and reward, because no step follows. An episode that the environment terminates is a
failure, also where it means success. A truncated one is none; see :func:`s2r_gym.rollout.simulate`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import metadata
from math import ceil
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from s2r_gym.controller import Actions, Controller, digest_of, is_code, open_controller, refuse_misfit, stamp
from s2r_gym.environment import Facts, facts, make, time_step
from s2r_gym.rollout import simulate
from s2r_spec.backend import Channel, Finding, Needs, Option, Parameter, read_code, refuse_unknown
from s2r_spec.effects import read_options
from s2r_spec.errors import UsageError, require
from s2r_spec.trace import Trace

NAMES: Mapping[str, tuple[tuple[str, str], ...]] = {
    "Pendulum": (("cos_theta", ""), ("sin_theta", ""), ("theta_dot", "rad/s")),
    "CartPole": (("x", ""), ("x_dot", ""), ("theta", "rad"), ("theta_dot", "rad/s")),
    "MountainCar": (("position", "m"), ("velocity", "")),
    "MountainCarContinuous": (("position", "m"), ("velocity", "")),
    "Acrobot": (
        ("cos_theta1", ""), ("sin_theta1", ""), ("cos_theta2", ""), ("sin_theta2", ""),
        ("theta1_dot", "rad/s"), ("theta2_dot", "rad/s"),
    ),
}  # fmt: skip
"""Definition: environment → name and unit of each column, from its documentation; "" where it states no unit."""
_OWN = ("policy", "dt")
_NO_POLICY = "{} needs a policy for its rollouts: add the option policy=FILE.py:act, or policy=FILE.onnx"
_CPU_PER_STEP = 1e-4
"""Prior: time of one step with its policy [s], of a MuJoCo environment on a 2-core cloud machine."""
_VERSIONS = ("gymnasium", "numpy", "mujoco", "box2d", "box2d-py")
"""Definition: packages whose version changes the traces."""


@dataclass(frozen=True)
class GymBackend:
    """A Gymnasium environment with a policy; every rollout is a new environment, and depends on test and seed alone.

    Every number of the environment is a parameter: a numeric keyword of ``gymnasium.make``, or a public attribute. The
    specification gives the ranges. Without one, a parameter has the range from half to twice its value.

    Args:
        options: the text after the colon of the name.
        duration: duration of a rollout [s]; 0 for the environment's own time limit.
        declared: parameters of the specification.

    Raises:
        UsageError: the environment, the policy or an option is unknown or wrong.
    """

    options: str = ""
    duration: float = 0.0
    declared: tuple[Parameter, ...] = ()

    deterministic: ClassVar[bool] = True
    example: ClassVar[str] = "Pendulum-v1"
    offered: ClassVar[tuple[Option, ...]] = (
        Option("policy", None, "FILE.py:act, or a file .onnx, .pt (TorchScript) or .zip (Stable-Baselines3)"),
        Option("dt", "stated by the environment", "time of a step [s]; only if the environment states none"),
        Option("NAME", "of the environment", "a keyword of gymnasium.make, or a number of the environment"),
    )

    def __post_init__(self) -> None:
        """Check the options, and complete the duration."""
        require("the backend 'gym' needs", "gymnasium")
        if not self.identifier:
            raise UsageError(
                "the backend 'gym' needs an environment: write gym:Pendulum-v1,policy=FILE.py:act"
            )
        own = self._facts
        _refuse_spaces(self.identifier, own)
        if text := self._settings.get("policy"):
            stamp(text)
            if not is_code(text):
                self._actions()
        limit = None if own.limit is None else own.limit * self.step
        if not self.duration and limit is not None:
            object.__setattr__(self, "duration", limit)
        if own.limit is not None and self.steps > own.limit:
            raise UsageError(
                f"{self.identifier} ends an episode after {own.limit} steps, {limit:g} s, but a rollout has "
                f"{self.duration:g} s; add the option max_episode_steps={self.steps}"
            )

    @property
    def name(self) -> str:
        """Name and options, as in ``--backend``."""
        return f"gym:{self.options}"

    @property
    def identifier(self) -> str:
        """Name of the environment, as ``gymnasium.make`` takes it."""
        return self.options.partition(",")[0].strip()

    @property
    def step(self) -> float:
        """Time of a step [s]."""
        own, text = self._facts.step, self._settings.get("dt")
        if own is not None and text is not None:
            raise UsageError(f"{self.identifier} states its time step, {own:g} s; leave out dt={text}")
        if own is not None:
            return own
        try:
            step = float(text or "")
        except ValueError:
            step = 0.0
        if not 0 < step < float("inf"):
            raise UsageError(
                f"{self.identifier} states no time step (dt or tau); add the option dt=SECONDS, such as dt=0.02"
            )
        return step

    @property
    def steps(self) -> int:
        """Number of steps of a rollout."""
        return ceil(self.duration / self.step - 1e-9)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Observation, its named columns, action and reward."""
        own = self._facts
        names = NAMES.get(own.name, ())
        return (
            Channel("obs", "", "observation", _width(own.observation), tuple(name for name, _ in names)),
            *(Channel(name, unit, f"obs[{k}]") for k, (name, unit) in enumerate(names)),
            Channel("action", "", "action until the next sample, within its bounds", _width(own.action)),
            Channel("reward", "", "reward of the step that begins at the sample"),
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Every number of the environment, with the range and the unit that the specification declares."""
        declared = {one.name: one for one in self.declared}
        return tuple(
            _parameter(name, value, declared.get(name)) for name, value in self._facts.numbers.items()
        )

    @property
    def cost(self) -> float:
        """Expected time of one rollout on one core [s]."""
        return _CPU_PER_STEP * max(self.steps, 1)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the file of the policy does not say."""
        text = self._settings.get("policy", "")
        return () if not text or is_code(text) else self._controller.assumptions

    @property
    def model_hash(self) -> str:
        """Hash of options, policy, versions, and the source of the environment; runs nothing of a Python policy."""
        policy = digest_of(self._settings["policy"]) if "policy" in self._settings else ""
        versions = {name: _version(name) for name in _VERSIONS}
        files = sorted(Path(__file__).parent.glob("*.py"))
        files += [Path(value) for value in self._environment.values()]  # such as xml_file
        sources = [hashlib.sha256(path.read_bytes()).hexdigest() for path in files if path.is_file()]
        settings = [self.identifier, sorted(self._environment.items()), self.step]
        return hashlib.sha256(
            json.dumps([settings, policy, versions, sources, self._facts.digest]).encode()
        ).hexdigest()

    def with_duration(self, seconds: float) -> Self:
        """Return this backend with rollouts of this duration [s].

        Raises:
            UsageError: the environment truncates an episode earlier.
        """
        return replace(self, duration=seconds)

    def for_spec(self, needs: Needs) -> Self:
        """Return this backend with the parameters' ranges of a specification.

        Raises:
            UsageError: there is no policy.
        """
        if "policy" not in self._settings:
            raise UsageError(_NO_POLICY.format(self.name))
        return replace(self, declared=needs.parameters)

    def prepare(self) -> None:
        """Open environment and policy, before the time of a rollout counts."""
        self._actions()

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Run one test.

        Raises:
            UsageError: a parameter is unknown, or the policy does not fit.
            BackendError: the policy raised an error, or gave no action; or the environment truncated the episode.
        """
        refuse_unknown(self.name, self.parameters, params)
        if not self.duration:
            raise UsageError(f"{self.identifier} has no time limit; add the option max_episode_steps=STEPS")
        actions = self._actions()
        environment = make(self.identifier, {**self._environment, **params})
        try:
            columns, failure = simulate(
                environment, actions, self.duration, time_step(environment) or self.step, seed
            )
        finally:
            environment.close()
        for k, (name, _) in enumerate(NAMES.get(self._facts.name, ())):
            columns[name] = columns["obs"][:, k]
        meta: dict[str, Any] = {"params": dict(params), "seed": seed}
        return Trace(
            columns["t"],
            {channel.name: columns[channel.name] for channel in self.channels},
            {channel.name: channel.unit for channel in self.channels},
            meta | ({"failure": failure} if failure else {}),
        )

    def preflight(self, *, run: bool) -> Iterator[Finding]:
        """Yield what environment and policy say; see :class:`s2r_spec.backend.HasPreflight`."""
        own, text = self._facts, self._settings.get("policy", "")
        limit = "no time limit" if own.limit is None else f"at most {own.limit} steps"
        yield Finding("environment", f"{self.identifier}, a step every {1e3 * self.step:g} ms, {limit}")
        if not text:
            yield Finding("policy", _NO_POLICY.format(self.name), "wrong")
            return
        if is_code(text):
            files = ", ".join(path.name for path in read_code(text)[1])
            yield Finding("policy", f"{text}; Python files that run: {files}")
        else:
            size = self._actions().size
            yield Finding("policy", f"{text} takes {_width(own.observation)} numbers, and returns {size}")
        yield from (Finding("policy", words, "note") for words in self.assumptions)
        if not run:
            return
        trace = self.rollout({}, 0)
        rows = [f"{'channel':12}  {'least':>9}  {'greatest':>9}"]
        for channel in self.channels:
            values = trace[channel.name].reshape(len(trace), -1).T
            names = (
                [f"{channel.name}[{k}]" for k in range(len(values))] if len(values) > 1 else [channel.name]
            )
            rows += [f"{n:12}  {x.min():9.3g}  {x.max():9.3g}" for n, x in zip(names, values, strict=True)]
        yield Finding("channels", f"their ranges over {trace.duration:g} s", table=tuple(rows))
        if trace.failure is not None:
            yield Finding(
                "end", f"the environment ends the rollout at {trace.duration:g} s: {trace.failure}", "note"
            )

    @cached_property
    def _settings(self) -> dict[str, str]:
        known = dict.fromkeys([*_OWN, *facts(self.identifier).settings], ())
        return read_options("gym", self.options.partition(",")[2], known)[0]

    @property
    def _environment(self) -> dict[str, str]:
        """Options of the environment: name → text."""
        return {name: text for name, text in self._settings.items() if name not in _OWN}

    @property
    def _facts(self) -> Facts:
        return facts(self.identifier, tuple(sorted(self._environment.items())))

    @property
    def _controller(self) -> Controller:
        if "policy" not in self._settings:
            raise UsageError(_NO_POLICY.format(self.name))
        return open_controller(self._settings["policy"])

    def _actions(self) -> Actions:
        actions = Actions(self._facts.action, self._controller)
        refuse_misfit(self.identifier, _width(self._facts.observation), actions)
        return actions


def _parameter(name: str, value: float, declared: Parameter | None) -> Parameter:
    words = "number of the environment"
    if declared is not None:
        default = min(max(value, declared.low), declared.high)
        return Parameter(name, declared.unit, declared.low, declared.high, default, words)
    low, high = sorted((0.5 * value, 2.0 * value)) if value else (-1.0, 1.0)
    return Parameter(name, "", low, high, value, words)


def _width(space: Any) -> int:
    """Return how many numbers an observation or an action has."""
    return int(np.prod(space.shape))


def _refuse_spaces(identifier: str, own: Facts) -> None:
    """Refuse observations that are no numbers in a row, and actions that are neither these nor one integer."""
    discrete = hasattr(own.observation, "n") or hasattr(own.observation, "low")
    if not discrete or len(own.observation.shape) > 1:
        raise UsageError(
            f"{identifier} observes {own.observation}; only vectors are supported, so add a wrapper such as "
            f"FlattenObservation in an environment of your own"
        )
    if not (hasattr(own.action, "low") or isinstance(getattr(own.action, "n", None), int | np.integer)):
        raise UsageError(f"{identifier} has the actions {own.action}; only Box and Discrete are supported")


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""
