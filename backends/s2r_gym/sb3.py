"""The actor of a Stable-Baselines3 zip, from its weights alone.

The zip has ``policy.pth``, a dictionary of tensors, which torch reads without running anything. Its file ``data`` holds
pickles, and is never read. So two facts are unknown, and :attr:`Actor.assumptions` states them: the activation, for
which Stable-Baselines3's default is taken, and whether observations were normalised.
Names of weights: https://stable-baselines3.readthedocs.io (``stable_baselines3/common/policies.py``, ``sac``, ``td3``,
``dqn``).
"""

from __future__ import annotations

import hashlib
import io
import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from s2r_policy.torch_file import EXPANSION
from s2r_spec.errors import UsageError, require

FloatArray32 = NDArray[np.float32]
_WEIGHTS = "policy.pth"


@dataclass(frozen=True)
class Kind:
    """A family of algorithms: pattern of its hidden layers, last layer, activation, and whether it ends with tanh."""

    name: str
    hidden: str
    last: str
    activation: Literal["tanh", "relu"]
    squashed: bool = False


KINDS = (
    Kind("PPO or A2C", r"mlp_extractor\.policy_net\.(\d+)", "action_net", "tanh"),
    Kind("SAC", r"actor\.latent_pi\.(\d+)", "actor.mu", "relu", True),
    Kind("TD3 or DDPG", r"actor\.mu\.(\d+)", "", "relu", True),
    Kind("DQN", r"q_net\.q_net\.(\d+)", "", "relu"),
)
"""Definition: Stable-Baselines3's policies named MlpPolicy, with its default activations."""


@dataclass(frozen=True)
class Actor:
    """A network of dense layers.

    Attributes:
        layers: (weights (outputs, inputs), bias (outputs,)) of every layer.
        kind: its algorithm.
        digest: hash of the weights' file.
    """

    layers: tuple[tuple[FloatArray32, FloatArray32], ...]
    kind: Kind
    digest: str

    @property
    def width(self) -> int:
        """Numbers in an observation."""
        return int(self.layers[0][0].shape[1])

    @property
    def outputs(self) -> int:
        """Numbers in an action, or actions to choose from."""
        return int(self.layers[-1][0].shape[0])

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the weights do not say."""
        return (
            f"the {self.kind.name} policy was trained with {self.kind.activation} between its layers, the default of "
            f"Stable-Baselines3, and without normalised observations; its weights do not say",
        )

    def __call__(self, observation: FloatArray32) -> FloatArray32:
        """Return the action (outputs,) without its noise, in [−1, 1] if the kind is squashed."""
        x = observation
        for number, (weights, bias) in enumerate(self.layers, 1):
            x = weights @ x + bias
            if number < len(self.layers):
                x = np.tanh(x) if self.kind.activation == "tanh" else np.maximum(x, np.float32(0))
        return np.tanh(x) if self.kind.squashed else x


def read_actor(path: Path) -> Actor:
    """Return the actor of a Stable-Baselines3 zip.

    Raises:
        UsageError: it is no such zip, or the weights do not show a network of dense layers.
    """
    require("policies of Stable-Baselines3 need", "torch")
    import torch

    try:
        with zipfile.ZipFile(path) as archive:
            if archive.getinfo(_WEIGHTS).file_size > EXPANSION * path.stat().st_size:
                raise UsageError(
                    f"{path}: {_WEIGHTS} expands too far; save the policy again, or export it as ONNX"
                )
            data = archive.read(_WEIGHTS)
    except KeyError:
        raise UsageError(
            f"{path}: the zip has no {_WEIGHTS}, so it is not of Stable-Baselines3; export the policy as ONNX"
        ) from None
    except (OSError, zipfile.BadZipFile, RuntimeError) as error:
        raise UsageError(f"{path} cannot be read: {error}") from None
    try:
        weights = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception:
        raise UsageError(
            f"{path}: {_WEIGHTS} holds more than tensors, or is damaged; export the policy as ONNX"
        ) from None
    arrays = {
        str(name): value.numpy() for name, value in dict(weights).items() if isinstance(value, torch.Tensor)
    }
    if any("features_extractor." in name for name in arrays):
        raise UsageError(f"{path}: the policy observes pictures; only MlpPolicy is supported")
    return _actor(path, arrays, hashlib.sha256(data).hexdigest())


def _actor(path: Path, arrays: Mapping[str, NDArray[Any]], digest: str) -> Actor:
    for kind in KINDS:
        found = (re.fullmatch(rf"({kind.hidden})\.weight", name) for name in arrays)
        hidden = {int(match[2]): match[1] for match in found if match}
        names = [hidden[number] for number in sorted(hidden)] + ([kind.last] if kind.last else [])
        layers = [
            (arrays[f"{name}.weight"].astype(np.float32), arrays[f"{name}.bias"].astype(np.float32))
            for name in names
            if {f"{name}.weight", f"{name}.bias"} <= arrays.keys()
        ]
        if names and len(layers) == len(names) and _is_chain(layers):
            return Actor(tuple(layers), kind, digest)
    raise UsageError(
        f"{path}: its weights show no MlpPolicy of PPO, A2C, SAC, TD3, DDPG or DQN; export the policy as ONNX"
    )


def _is_chain(layers: Sequence[tuple[FloatArray32, FloatArray32]]) -> bool:
    """Return whether each layer takes as many numbers as the one before gives."""
    sizes = [weights.shape for weights, _ in layers]
    return all(len(size) == 2 for size in sizes) and all(a[0] == b[1] for a, b in pairwise(sizes))
