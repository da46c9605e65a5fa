"""The files and packages that a Python file imports, found in its text; nothing runs."""

from __future__ import annotations

import ast
import sys
import sysconfig
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib import metadata
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

from s2r_spec.base.errors import UsageError

_OWN = __name__.partition(".")[0]


def _root(module: str, path: Path) -> tuple[Path, str | None]:
    """Return the folder whose files are hashed, and the only package of it that is, or None for all."""
    depth = module.count(".") + (path.name == "__init__.py") if module else 0
    root = path.parents[depth]
    installed = {Path(sysconfig.get_path(key)).resolve() for key in ("purelib", "platlib", "stdlib")}
    return root, module.partition(".")[0] if root in installed else None


@dataclass(frozen=True)
class Code:
    """The files of a program, and what it imports.

    Attributes:
        root: folder of its own modules.
        files: path → content of the files that are hashed.
        own: modules in this folder, which is not on the path of Python; none for an installed module.
        packages: packages that are imported from elsewhere, without those of Python itself.
    """

    root: Path
    files: Mapping[Path, bytes]
    own: frozenset[str]
    packages: frozenset[str]

    @classmethod
    def read(cls, module: str, path: Path, label: str) -> Code:
        """Read a file, and every file of its own folder that it imports, directly or not.

        Args:
            module: name of its module, or "" for a file by its path, which runs like a script.
            path: the file.
            label: its name in messages.

        Raises:
            UsageError: a file cannot be read, or is not Python code.
        """
        root, only = _root(module, path)
        files: dict[Path, bytes] = {}
        own: set[str] = set()
        packages: set[str] = set()
        waiting = [path, *(_files(root, module) if module else ())]
        while waiting:
            path = waiting.pop(0)
            if path in files:
                continue
            try:
                files[path] = path.read_bytes()
            except OSError as error:
                raise UsageError(f"{label}: cannot read {path}: {error.strerror or error}") from None
            if path.suffix != ".py":
                continue
            for base, name in _imports(_parse(files[path], path), path, root):
                top = name.partition(".")[0]
                found = _files(base, name) if only in (None, top) or base != root else []
                waiting += found
                if base == root:
                    (own if found else packages).add(top)
        packages -= own | {_OWN} | sys.stdlib_module_names
        return cls(root, files, frozenset() if only else frozenset(own), frozenset(packages))

    @property
    def digest(self) -> str:
        """Hex digest over files and versions; the same wherever the folder is."""
        digest = sha256("\n".join(f"{name} {_version(name)}" for name in sorted(self.packages)).encode())
        for path in sorted(self.files):
            name = path.relative_to(self.root).as_posix()
            digest.update(f"\n{name} {sha256(self.files[path]).hexdigest()}".encode())
        return digest.hexdigest()


def _parse(source: bytes, path: Path) -> ast.Module:
    try:
        return ast.parse(source, str(path))
    except SyntaxError as error:
        raise UsageError(f"{path}:{error.lineno or 1}: {error.msg}; correct this line") from None
    except (ValueError, RecursionError, MemoryError) as error:
        raise UsageError(f"{path} is not Python code: {error or type(error).__name__}") from None


def _imports(tree: ast.Module, path: Path, root: Path) -> Iterator[tuple[Path, str]]:
    """Yield (folder, dotted name) of every module that may be imported from this folder, also inside functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((root, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = path.parents[node.level - 1] if 0 < node.level <= len(path.parents) else root
            if node.level and not base.is_relative_to(root):
                continue  # Python refuses it
            stem = f"{node.module}." if node.module else ""
            yield from ((base, f"{stem}{alias.name}".removesuffix(".*")) for alias in node.names)


def _files(base: Path, name: str) -> list[Path]:
    """Return the files that the import of a dotted name runs; [] if it is not in the folder."""
    found, place = [], base
    for part in name.split("."):
        place /= part
        kinds = (
            place / "__init__.py",
            *(place.with_name(part + end) for end in (".py", *EXTENSION_SUFFIXES)),
        )
        found += [path for path in kinds if path.is_file()][:1]
    return found


def public_names(source: bytes) -> list[str]:
    """Return the public classes and functions of a file."""
    kinds = (ast.ClassDef, ast.FunctionDef)
    return [one.name for one in ast.parse(source).body if isinstance(one, kinds) and one.name[0] != "_"]


@cache
def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        names = sorted({*metadata.packages_distributions().get(package, ())})
        return " ".join(f"{name} {metadata.version(name)}" for name in names)
