"""One episode of an environment under a policy."""

from __future__ import annotations

import traceback
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_gym.controller import Act, Actions
from s2r_spec.errors import BackendError, S2RError

FloatArray = NDArray[np.float64]


def simulate(
    environment: Any, actions: Actions, duration: float, step: float, seed: int
) -> tuple[dict[str, FloatArray], str]:
    """Run one episode from a seed.

    Args:
        environment: a new environment.
        actions: its actions and the policy.
        duration: time until the last sample [s], rounded up to a whole step.
        step: time of a step [s].
        seed: seed of the environment and of its actions.

    Returns:
        The columns ``t`` (n,) [s], ``obs`` (n, width), ``action`` (n, size) and ``reward`` (n,), with (n,) for a width
        of 1; and the word for a failure: "terminated" if the environment ended the episode, else "".

    Raises:
        BackendError: the policy raised an error or gave no action, or the environment truncated the episode earlier.
    """
    observation, _ = environment.reset(seed=seed)
    environment.action_space.seed(seed)
    act = actions.controller.begin()
    steps = ceil(duration / step - 1e-9)
    observed = [_flat(observation)]
    taken: list[FloatArray] = []
    rewards: list[float] = []
    terminated = False
    while len(rewards) < steps and not terminated:
        time = len(rewards) * step
        action, numbers = actions.read(_ask(act, observation, actions.controller.name, time), time)
        observation, reward, terminated, truncated, _ = environment.step(action)
        observed.append(_flat(observation))
        taken.append(numbers)
        rewards.append(float(reward))
        if truncated and not terminated and len(rewards) < steps:
            raise BackendError(
                f"the environment truncated the episode at {len(rewards) * step:g} s of {duration:g} s; "
                f"shorten the windows of the spec"
            )
    columns = {
        "t": step * np.arange(len(observed), dtype=np.float64),
        "obs": _narrow(observed),
        "action": _narrow([*taken, taken[-1]]),
        "reward": np.array([*rewards, rewards[-1]]),
    }
    return columns, "terminated" if terminated else ""


def _ask(act: Act, observation: Any, name: str, time: float) -> Any:
    """Return what a policy returns; whatever it raises becomes one sentence with its line."""
    try:
        return act(observation)
    except S2RError:
        raise
    except (Exception, SystemExit) as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        raise BackendError(
            f"the policy {name} raised {type(error).__name__} at {time:g} s, in line {last.lineno} of "
            f"{last.filename}: {error}"
        ) from None


def _flat(values: Any) -> FloatArray:
    return np.array(values, np.float64).reshape(-1)


def _narrow(rows: list[FloatArray]) -> FloatArray:
    """Return rows as (n, width), or as (n,) for a width of 1."""
    table = np.array(rows)
    return table[:, 0] if table.shape[1] == 1 else table
