"""The numbers that a predicate compares, as torch tensors."""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from typing import TYPE_CHECKING

import numpy as np

from s2r_spec.base.errors import UsageError
from s2r_spec.lang import formula as f
from s2r_spec.robustness.numbers import ARITHMETIC

if TYPE_CHECKING:
    from torch import Tensor


class TensorValues:
    """Evaluates values to (…, width, n); a value that is constant over time has n = 1.

    Args:
        signals: name → (…, width, n), in the declared unit; at least one.
        params: name → (…, 1, 1), in the declared unit.
    """

    def __init__(self, signals: Mapping[str, Tensor], params: Mapping[str, Tensor]) -> None:
        import torch

        self.torch = torch
        self.signals, self.params = signals, params
        self.like = next(iter(signals.values()))

    def __call__(self, node: f.Value) -> Tensor:
        """Return (…, width, n), or (…, width, 1) of a constant."""
        torch, value = self.torch, self
        match node:
            case f.Number():
                return self.like.new_full((1, 1), node.value)
            case f.SignalValue():
                signal = self.signals[node.name]
                return signal if node.index is None else signal[..., node.index : node.index + 1, :]
            case f.ParamValue():
                return self.params[node.name]
            case f.Initial():
                return value(node.operand)[..., :1]
            case f.Overshoot():
                reference = value(node.reference)
                origin = 0.0 if node.origin is None else value(node.origin)[..., :1]
                ahead = reference[..., :1] >= origin
                beyond = value(node.signal) - reference
                directed: Tensor = torch.where(ahead, beyond, -beyond)
                return directed
            case f.Convert():
                converted: Tensor = node.conversion.plain(value(node.operand))
                return converted
            case f.Arithmetic():
                combined: Tensor = ARITHMETIC[node.operator](value(node.left), value(node.right))
                return combined
            case f.Elementary():
                function = getattr(torch, "neg" if node.function == "minus" else node.function)
                result: Tensor = function(value(node.operand))
                return result
            case f.Extremum():
                fold = torch.minimum if node.function == "min" else torch.maximum
                extreme: Tensor = reduce(fold, map(value, node.operands))
                return extreme
            case f.Norm():
                return self._norm([value(part) for part in node.operands])
            case _:
                raise UsageError(
                    f"`{node.span.text}` ({node.span.place}) has no gradient; evaluate it with numpy"
                )

    def _norm(self, parts: list[Tensor]) -> Tensor:
        shape = np.broadcast_shapes(*(part[..., :1, :].shape for part in parts))
        rows = [part.expand(*shape[:-2], part.shape[-2], shape[-1]) for part in parts]
        # not the root of a sum, which has no gradient at 0
        length: Tensor = self.torch.linalg.vector_norm(self.torch.cat(rows, -2), dim=-2, keepdim=True)
        return length
