"""Trained policies as functions: ONNX and TorchScript files of strangers, opened safely."""

from __future__ import annotations

from pathlib import Path

from s2r_policy.policy import FloatArray32 as FloatArray32
from s2r_policy.policy import Policy as Policy
from s2r_spec.errors import UsageError, require

ONNX = (".onnx",)
"""Definition: endings of ONNX files."""
TORCHSCRIPT = (".pt", ".pth", ".jit")
"""Definition: endings of TorchScript files, and of pickles, which are refused."""


def open_policy(path: Path) -> Policy:
    """Open a trained policy.

    An ONNX file cannot run code: its operators are those of onnxruntime, and its data lie in its own folder. A
    TorchScript file contains code of a language without files or processes, but for a few operators; a file with one
    of these is refused before it is loaded. Pickles are never read.

    Raises:
        UsageError: the file is missing or damaged, or it is no policy that can run here; the message says what to do.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in ONNX + TORCHSCRIPT:
        raise UsageError(
            f"{path}: a policy ends in .onnx, or in .pt, .pth or .jit for TorchScript; export it as ONNX"
        )
    if not path.is_file():
        raise UsageError(f"{path}: there is no such file")
    if path.stat().st_size == 0:
        raise UsageError(f"{path}: the file is empty; copy it again")
    if ending in ONNX:
        require("policies in ONNX files need", "onnxruntime")
        from s2r_policy.onnx_policy import OnnxPolicy

        return OnnxPolicy(path)
    require("policies in TorchScript files need", "torch")
    from s2r_policy.torch_policy import TorchScriptPolicy

    return TorchScriptPolicy(path)
