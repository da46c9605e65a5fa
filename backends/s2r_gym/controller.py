"""Policies of every form, as functions from an observation to an action."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_policy import ONNX, TORCHSCRIPT, open_policy
from s2r_spec.backend import load_code, read_code
from s2r_spec.errors import BackendError, UsageError

Act = Callable[[Any], Any]
FloatArray = NDArray[np.float64]
_SB3 = ".zip"
_FORMS = "FILE.py:act, or a file .onnx, .pt (TorchScript) or .zip (Stable-Baselines3)"


@dataclass(frozen=True)
class Controller:
    """A policy.

    Attributes:
        name: its name in the options.
        begin: returns the function of one rollout, with its state at the beginning.
        digest: hash of the policy.
        network: whether its actions are a network's outputs, of which the largest is a discrete action.
        squashed: whether its actions lie in [−1, 1], and mean the whole range of the environment.
        width: numbers in an observation; None if unknown.
        outputs: numbers in an action; None if unknown.
        assumptions: what its file does not say.
    """

    name: str
    begin: Callable[[], Act]
    digest: str
    network: bool = False
    squashed: bool = False
    width: int | None = None
    outputs: int | None = None
    assumptions: tuple[str, ...] = ()


def is_code(text: str) -> bool:
    """Return whether a policy is Python code."""
    return Path(text).suffix.lower() not in (*ONNX, *TORCHSCRIPT, _SB3)


def stamp(text: str) -> str:
    """Return a text that changes with a policy's file; runs nothing of it.

    Raises:
        UsageError: the file is missing, or of another form.
    """
    if not is_code(text):
        try:
            found = Path(text).stat()
        except OSError as error:
            raise UsageError(f"the policy {text} cannot be read: {error.strerror or error}") from None
        return f"{found.st_mtime_ns} {found.st_size}"
    if ":" not in text or text.endswith(".py"):
        raise UsageError(f"the policy {text!r} must be {_FORMS}")
    return read_code(text)[0]


def digest_of(text: str) -> str:
    """Return the hash of a policy; a Python file does not run.

    Raises:
        UsageError: as :func:`open_controller`.
    """
    return stamp(text) if is_code(text) else open_controller(text).digest


def open_controller(text: str) -> Controller:
    """Open a policy, once in a process unless its file changes; a Python file runs now.

    Raises:
        UsageError: the file is missing or wrong.
    """
    return _open(text, stamp(text))


@lru_cache(maxsize=8)
def _open(text: str, _: str) -> Controller:
    path = Path(text)
    ending = path.suffix.lower()
    if ending == _SB3:
        from s2r_gym.sb3 import read_actor

        actor = read_actor(path)
        return Controller(
            text, lambda: _float32(actor), actor.digest, True, actor.kind.squashed, actor.width, actor.outputs,
            actor.assumptions,
        )  # fmt: skip
    if ending in ONNX + TORCHSCRIPT:
        policy = open_policy(path)

        def begin() -> Act:
            policy.reset()
            return _float32(policy)

        return Controller(
            text,
            begin,
            policy.digest,
            True,
            width=policy.width,
            outputs=policy.outputs,
            assumptions=policy.notes,
        )
    code = load_code(text)
    return Controller(text, lambda: _begin(text, code.value), code.digest)


def _float32(policy: Act) -> Act:
    return lambda observation: policy(np.asarray(observation, np.float32).reshape(-1))


def _begin(text: str, value: Any) -> Act:
    """Return the function of a rollout: that of a new object of a class, else of the object or function itself."""
    if isinstance(value, type):
        value = value()
    elif callable(reset := getattr(value, "reset", None)):
        reset()
    act = getattr(value, "act", value)
    if not callable(act):
        raise UsageError(
            f"the policy {text} is a value of type {type(value).__name__}; name a function act(observation), or a "
            f"class with a method act"
        )
    return act  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Actions:
    """The actions of an environment: what a policy returns, as ``step`` takes it.

    Args:
        space: Box or Discrete space of Gymnasium.
        controller: the policy.
    """

    space: Any
    controller: Controller

    @cached_property
    def is_discrete(self) -> bool:
        """Whether an action is one of a few numbers."""
        return hasattr(self.space, "n")

    @cached_property
    def size(self) -> int:
        """Numbers that a policy returns: those of an action, or one for each discrete action of a network."""
        return int(self.space.n) if self.is_discrete else int(np.prod(self.space.shape))

    @cached_property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest action of a Box (size,)."""
        return self.space.low.astype(np.float64).reshape(-1), self.space.high.astype(np.float64).reshape(-1)

    def read(self, raw: Any, time: float) -> tuple[Any, FloatArray]:
        """Return the action for ``step``, and the same as (n,) numbers.

        An action outside the bounds of a Box becomes the nearest inside, as Stable-Baselines3 does it.

        Raises:
            BackendError: it has another size, is not finite, or is no action of a discrete space.
        """
        try:
            values = np.asarray(raw, np.float64).reshape(-1)
        except (TypeError, ValueError):
            raise BackendError(f"{self._gave(repr(raw), time)}, which is no action") from None
        if not np.isfinite(values).all():
            raise BackendError(f"{self._gave(str(values.tolist()), time)}, which is not finite")
        if self.is_discrete:
            return self._choose(values, time)
        if values.size != self.size:
            raise BackendError(f"{self._gave(f'{values.size} numbers', time)}, but an action has {self.size}")
        low, high = self.bounds
        if self.controller.squashed:
            values = low + 0.5 * (values + 1.0) * (high - low)
        action = np.minimum(np.maximum(values, low), high).astype(self.space.dtype)
        return action.reshape(self.space.shape), action.astype(np.float64)

    def _choose(self, values: FloatArray, time: float) -> tuple[int, FloatArray]:
        first, count = int(self.space.start), int(self.space.n)
        if self.controller.network and values.size == count:
            values = np.array([first + int(np.argmax(values))], np.float64)
        if values.size != 1 or values[0] not in range(first, first + count):
            numbers = ", ".join(f"{value:g}" for value in values)
            raise BackendError(
                f"{self._gave(numbers, time)}; an action is an integer from {first} to {first + count - 1}"
            )
        return int(values[0]), values

    def _gave(self, what: str, time: float) -> str:
        return f"the policy {self.controller.name} gave {what} at {time:g} s"


def refuse_misfit(identifier: str, width: int, actions: Actions) -> None:
    """Refuse a network that has another width than the environment.

    Raises:
        UsageError: its observation or its action has another width.
    """
    policy = actions.controller
    if policy.width not in (None, width):
        raise UsageError(
            f"the policy {policy.name} takes {policy.width} numbers, but {identifier} observes {width}"
        )
    if policy.outputs not in (None, actions.size) and policy.network:
        kind = "discrete actions" if actions.is_discrete else "numbers in an action"
        raise UsageError(
            f"the policy {policy.name} returns {policy.outputs} numbers, but {identifier} has {actions.size} {kind}"
        )
