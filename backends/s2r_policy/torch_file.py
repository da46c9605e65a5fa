"""Whether a TorchScript file is safe to load, found without torch.

A TorchScript file is a zip archive of tensors, of ``data.pkl``, and of source text in ``code/``. PyTorch reads its
pickles by an own reader, which creates no Python objects. The source is TorchScript, which has no files, processes or
imports. But it runs at loading already (``__setstate__``), and two operators write files: ``torch.save`` and
``torch.from_file``. PyTorch's own advice is to trust no model (https://github.com/pytorch/pytorch/security/policy).
"""

from __future__ import annotations

import ast
import re
import zipfile
from pathlib import Path

from s2r_spec.errors import UsageError

_WRITES = re.compile(r"(?<!\w)(?:save|from_file)(?!\w)")
_NAMESPACE = re.compile(r"(?<!\w)ops\s*\.\s*(\w+)")
_CLASSES = re.compile(r"(?<!\w)torch\s*\.\s*classes(?!\w)")
_STANDARD = {"aten", "prim", "quantized"}


def read_classes(path: Path) -> dict[str, tuple[str, ...]]:
    """Return the names of the attributes of every class of a TorchScript file.

    Raises:
        UsageError: it is a pickle, a damaged archive, or has an operator that reaches outside of the model.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            names = {member.filename.partition("/")[2].lower() for member in members}
            if not {"data.pkl", "constants.pkl"} <= names or "model.json" in names:
                raise UsageError(_pickle(path))
            sources = {
                one.filename: archive.read(one).decode()
                for one in members
                if one.filename.lower().endswith(".py")
            }
    except zipfile.BadZipFile:
        with path.open("rb") as file:
            begins = file.read(4)
        damaged = f"{path}: the TorchScript archive is damaged; copy it again"
        raise UsageError(damaged if begins == b"PK\3\4" else _pickle(path)) from None
    except (OSError, UnicodeDecodeError, RuntimeError, NotImplementedError) as error:
        raise UsageError(f"{path} cannot be read: {error}") from None
    classes: dict[str, tuple[str, ...]] = {}
    for name, text in sources.items():
        _refuse_outside(path, text)
        classes |= _attributes(path, name, text)
    return classes


def _pickle(path: Path) -> str:
    return (
        f"{path}: the file is no TorchScript, but perhaps a pickle, which could run any program when it is read; "
        f"export the policy with torch.jit.save, or as ONNX"
    )


def _refuse_outside(path: Path, text: str) -> None:
    """Refuse source text with a word that could reach outside of the model."""
    outside = [f"torch.{word}" for word in _WRITES.findall(text)]
    outside += [f"ops.{name}" for name in _NAMESPACE.findall(text) if name not in _STANDARD]
    outside += ["torch.classes"] if _CLASSES.search(text) else []
    if outside:
        raise UsageError(
            f"{path}: its code uses {outside[0]}, which may reach outside of the model; export the policy as ONNX"
        )


def _attributes(path: Path, name: str, text: str) -> dict[str, tuple[str, ...]]:
    """Return class → names of its attributes, of one source file of an archive."""
    module = name.partition("/code/")[2].removesuffix(".py").replace("/", ".")
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError, RecursionError):
        raise UsageError(
            f"{path}: its code {name} cannot be read; export the policy with a newer torch, or as ONNX"
        ) from None
    return {
        f"{module}.{node.name}": tuple(
            one.target.id
            for one in node.body
            if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)
        )
        for node in tree.body
        if isinstance(node, ast.ClassDef)
    }
