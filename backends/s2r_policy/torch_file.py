"""A TorchScript file, read and checked without torch.

A TorchScript file is a zip archive of tensors, of ``data.pkl``, and of source text in ``code/``. PyTorch reads its
pickles by an own reader, which creates no Python objects. The source is TorchScript, which has no files, processes or
imports. But it runs at loading already (``__setstate__``), and a few operators reach outside: ``torch.save`` and
``torch.from_file`` write files, and a class of ``torch.classes`` loads a library. PyTorch's own advice is to trust no
model (https://github.com/pytorch/pytorch/security/policy). So a file with one of these is refused.
"""

from __future__ import annotations

import ast
import io
import re
import zipfile
import zlib
from pathlib import Path

from s2r_spec.errors import UsageError

_WRITES = re.compile(r"(?<!\w)(?:save|from_file)(?!\w)")
_NAMESPACE = re.compile(r"(?<!\w)ops\s*\.\s*(\w+)")
_CLASSES = re.compile(rb"torch\s*\.?\s*classes")
_STANDARD = {"aten", "prim"}
EXPANSION = 10
"""Budget: size of the members of an archive, in sizes of the file; ``torch.jit.save`` compresses nothing."""


def read_archive(path: Path) -> tuple[bytes, dict[str, tuple[str, ...]]]:
    """Return a TorchScript file, and the names of the attributes of every class in it.

    The file is a new archive of exactly the members that were checked, whatever else the bytes on disk hold.

    Raises:
        UsageError: it is a pickle, a damaged archive, or has an operator that reaches outside of the model.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(one.file_size for one in archive.infolist()) > EXPANSION * path.stat().st_size:
                raise UsageError(
                    f"{path}: the archive expands too far; export the policy with torch.jit.save"
                )
            members = [(one.filename, archive.read(one)) for one in archive.infolist()]
    except zipfile.BadZipFile:
        with path.open("rb") as file:
            begins = file.read(4)
        damaged = f"{path}: the TorchScript archive is damaged; copy it again"
        raise UsageError(damaged if begins == b"PK\3\4" else _pickle(path)) from None
    except (OSError, RuntimeError, NotImplementedError, EOFError, zlib.error) as error:
        raise UsageError(f"{path} cannot be read: {error}") from None
    names = [name.partition("/")[2].lower() for name, _ in members]
    if not {"data.pkl", "constants.pkl"} <= {*names} or "model.json" in names or len({*names}) < len(names):
        raise UsageError(_pickle(path))
    checked = io.BytesIO()
    classes: dict[str, tuple[str, ...]] = {}
    with zipfile.ZipFile(checked, "w") as archive:
        for name, content in members:
            if name.lower().endswith(("pkl", ".py")) and _CLASSES.search(content):
                raise UsageError(_outside(path, "torch.classes"))
            if name.lower().endswith(".py"):
                classes |= _attributes(path, name, content)
            archive.writestr(name, content)
    return checked.getvalue(), classes


def _pickle(path: Path) -> str:
    return (
        f"{path}: the file is no TorchScript, but perhaps a pickle, which could run any program when it is read; "
        f"export the policy with torch.jit.save, or as ONNX"
    )


def _outside(path: Path, what: str) -> str:
    return f"{path}: its code uses {what}, which may reach outside of the model; export the policy as ONNX"


def _attributes(path: Path, name: str, content: bytes) -> dict[str, tuple[str, ...]]:
    """Return class → names of its attributes, of one source file of an archive that reaches nowhere outside."""
    module = name.partition("/code/")[2].removesuffix(".py").replace("/", ".")
    try:
        text = content.decode()
        tree = ast.parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise UsageError(
            f"{path}: its code {name} cannot be read; export the policy with a newer torch, or as ONNX"
        ) from None
    outside = [f"torch.{word}" for word in _WRITES.findall(text)]
    outside += [f"ops.{word}" for word in _NAMESPACE.findall(text) if word not in _STANDARD]
    if outside:
        raise UsageError(_outside(path, outside[0]))
    return {
        f"{module}.{node.name}": tuple(
            one.target.id
            for one in node.body
            if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)
        )
        for node in tree.body
        if isinstance(node, ast.ClassDef)
    }
