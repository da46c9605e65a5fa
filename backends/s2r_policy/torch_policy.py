"""Policies in TorchScript files, evaluated on one thread.

A hidden state is an attribute of a module, usually a buffer. Their values in the file are kept, and are set again at
t = 0 of every rollout. Methods of the file such as ``reset_memory`` are not called.
"""

from __future__ import annotations

import copy
import io
import warnings
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from s2r_policy.policy import FloatArray32, digest, refuse_width
from s2r_policy.torch_file import read_archive
from s2r_policy.torch_graph import changes_state, widths
from s2r_spec.errors import UsageError


class TorchScriptPolicy:
    """A policy in a TorchScript file; see :class:`s2r_policy.Policy`."""

    def __init__(self, path: Path) -> None:
        """Open the file.

        Raises:
            UsageError: as :func:`s2r_policy.open_policy`.
        """
        import torch

        self._torch: Any = torch
        content, classes = read_archive(path)
        self.path = path
        self.files = (path,)
        self.metadata: Mapping[str, str] = {}
        self.notes: tuple[str, ...] = ()
        self.digest = digest(self.files, f"torch {torch.__version__}")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # torch.export cannot keep a state
                self._module: Any = torch.jit.load(io.BytesIO(content), map_location="cpu").eval()  # type: ignore[no-untyped-call]
            graph = self._module.inlined_graph
        except Exception as error:
            raise UsageError(
                f"{path}: torch {torch.__version__} cannot load it: {_last_line(error)}"
            ) from None
        self._forward = self._module.forward
        needed = [one.name for one in self._forward.schema.arguments[1:] if not one.has_default_value()]
        if len(needed) != 1:
            raise UsageError(
                f"{path}: the policy has {len(needed)} inputs ({', '.join(needed)}), but only an observation is "
                f"known; export one whose state is a buffer"
            )
        self.recurrent = changes_state(graph)
        self.width, self.outputs = widths(graph, self._module)
        self._places = list(_state(self._module, classes))
        self._initial = [getattr(module, name) for module, name in self._places]
        self._initial = copy.deepcopy(self._initial)  # at once, so that tensors that share memory still do

    def reset(self) -> None:
        """Set every attribute that is no weight to its value in the file."""
        for (module, name), value in zip(self._places, copy.deepcopy(self._initial), strict=True):
            module._c.setattr(name, value)

    def __call__(self, observation: FloatArray32) -> FloatArray32:
        """Return the action (outputs,) for an observation (width,).

        Raises:
            UsageError: the observation has another width, or the file cannot be evaluated.
        """
        torch = self._torch
        refuse_width(self.path, self.width, observation)
        batch = torch.from_numpy(
            np.array(observation[None])
        )  # a copy, because the file may keep it as its state
        threads = torch.get_num_threads()
        try:
            if threads != 1:
                torch.set_num_threads(1)  # every process then computes the same bits
            with torch.inference_mode():
                action = self._forward(batch)
        except Exception as error:
            raise UsageError(
                f"{self.path}: torch cannot evaluate the policy with {observation.size} numbers: {_last_line(error)}"
            ) from None
        finally:
            if threads != 1:
                torch.set_num_threads(threads)
        if isinstance(action, tuple | list) and action:
            action = action[0]
        if not isinstance(action, torch.Tensor) or action.dtype != torch.float32:
            kind = action.dtype if isinstance(action, torch.Tensor) else type(action).__name__
            raise UsageError(
                f"{self.path}: the policy returns {kind}, but an action has 32-bit floats; export it with them"
            )
        result: FloatArray32 = np.array(action.numpy(), np.float32).reshape(-1)
        return result

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the path: another process opens the file again."""
        return type(self), (self.path,)


def _state(module: Any, classes: Mapping[str, tuple[str, ...]]) -> Iterator[tuple[Any, str]]:
    """Yield (module, name) of every attribute that is a value and no weight."""
    import torch

    weights = {weight.data_ptr() for weight in module.parameters()}

    def is_weight(value: Any) -> bool:
        values = value if isinstance(value, list | tuple) else (value,)
        return any(isinstance(one, torch.Tensor) and one.data_ptr() in weights for one in values)

    for one in module.modules():
        for name in classes.get(one._c._type().qualified_name(), ()):
            value = getattr(one, name)
            if not isinstance(value, torch.nn.Module) and not is_weight(value):
                with suppress(RuntimeError):  # a constant, which cannot be set
                    one._c.setattr(name, value)
                    yield one, name


def _last_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1] if lines else type(error).__name__
