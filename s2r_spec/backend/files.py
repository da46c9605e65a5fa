"""Python code by the name of its file or module: ``cart.py:Cart``, ``my_robot.cart:Cart``.

A file runs as a script would: modules in its own folder are importable. Its module has a name of its own in
``sys.modules``, so its classes pickle; :func:`pack` tells another process where such modules are. The digest covers the
code that runs: the file, the files of its own folder that it imports, and the versions of packages that these import.
"""

from __future__ import annotations

import ast
import importlib
import pickle
import re
import sys
import sysconfig
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib import metadata
from importlib.machinery import EXTENSION_SUFFIXES, ModuleSpec, PathFinder
from importlib.util import find_spec, spec_from_file_location
from pathlib import Path
from typing import Any

from s2r_spec.base.errors import UsageError, did_you_mean, one_of, suggest

_OWN = __name__.partition(".")[0]


@dataclass(frozen=True)
class LoadedCode:
    """An object of a Python file or module.

    Attributes:
        value: the object.
        digest: hex digest over its name, its file, every file of the same folder that this imports, directly or not,
            and the versions of the distributions that these files import.
        files: these files, its own first.
    """

    value: Any
    digest: str
    files: tuple[Path, ...]


def load_code(text: str, folder: Path | None = None) -> LoadedCode:
    """Load an object by ``PATH.py:NAME`` or ``module:NAME``; the file runs once per process, unless it changes.

    Args:
        text: the file or the module, and the object's name in it, which may have dots.
        folder: folder of a relative path, and of modules that are not installed; the current one by default.

    Raises:
        UsageError: there is no such file, module or name; the code cannot be read or raises an error; it needs a
            package that is not installed; or it imports a file whose name another loaded module has.
    """
    place, name = _split(text)
    module, path, label = _locate(place, folder or Path())
    code = _Code.read(module, path, label)
    names = _public(code.files[path])
    if not name:
        raise UsageError(
            f"{label} needs the name of an object in it: write {place}:NAME; it has {one_of(names)}"
        )
    value: Any = _run(module, code, label)
    for part in name.split("."):
        if not hasattr(value, part):
            raise UsageError(f"{label} has no {name!r}{suggest(name, names)} it has {one_of(names)}")
        value = getattr(value, part)
    digest = sha256(f"{code.digest} {name}".encode()).hexdigest()
    return LoadedCode(value, digest, tuple(code.files))


def pack(value: object) -> bytes:
    """Return a pickle that :func:`unpack` reads in another process, with the places of files that were loaded here."""
    return pickle.dumps((dict(_PLACES), pickle.dumps(value)))


def unpack(data: bytes) -> Any:
    """Return the object of :func:`pack`; a file with its class runs first, if it has not yet run here."""
    places, value = pickle.loads(data)
    _claim(places)
    return pickle.loads(value)


_PLACES: dict[str, Path] = {}
"""Module → the file that it is, or the folder that it is in; for modules that are not on the path of Python."""
_DIGESTS: dict[str, str] = {}
"""Module → digest of its code when it was loaded."""


class _Finder:
    """Finds the modules in :data:`_PLACES`, before any other of the same name."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        place = _PLACES.get(name)
        if place is None:
            return None
        return (
            spec_from_file_location(name, place)
            if place.is_file()
            else PathFinder.find_spec(name, [str(place)])
        )


_CODE = r"((?:[A-Za-z]:[\\/])?[^:]*\.py|\w+(?:\.\w+)*)(?::([\w.]*))?"
"""Definition: PATH.py:NAME or module:NAME."""


def split_options(text: str) -> tuple[str, str]:
    """Return ``PATH.py:NAME`` and the options of ``PATH.py:NAME:OPTIONS``; the same of a module."""
    match = re.fullmatch(rf"(?s)(?P<code>{_CODE})(?::(?P<options>.*))?", text)
    return (match["code"], match["options"] or "") if match else (text, "")


def names_code(text: str) -> bool:
    """Return whether a text names a Python file, or an object in a module that is there; imports nothing."""
    match = re.fullmatch(_CODE, split_options(text)[0])
    if match is None or match[1].endswith(".py"):
        return match is not None
    top, places = match[1].partition(".")[0], (None, [str(Path())])
    return match[2] is not None and (
        top in sys.modules or any(PathFinder.find_spec(top, place) is not None for place in places)
    )


def _split(text: str) -> tuple[str, str]:
    place, _, name = text.rpartition(":")
    return (text, "") if name.endswith(".py") else (place, name) if place else (text, "")


def _locate(place: str, folder: Path) -> tuple[str, Path, str]:
    """Return the module's name, its file, and its name for messages."""
    if place.endswith(".py"):
        path = (folder / place).resolve()
        if not path.is_file():
            near = [one.name for one in path.parent.glob("*.py")]
            raise UsageError(
                f"no file {place} in {folder.absolute()}{suggest(path.name, near)} "
                f"give its path, or start s2r in its folder"
            )
        stem = re.sub(r"\W", "_", path.stem, flags=re.ASCII)
        module = f"{stem}_{sha256(str(path).encode()).hexdigest()[:12]}"
        _claim({module: path})
        return module, path, place
    if not re.fullmatch(r"\w+(\.\w+)*", place):
        raise UsageError(
            f"{place!r} is neither a Python file nor a module: write PATH.py:NAME or module:NAME"
        )
    top = place.partition(".")[0]
    label = f"the module {place}"
    if top not in sys.modules and find_spec(top) is None and PathFinder.find_spec(top, [str(folder)]):
        _claim({top: folder.resolve()})
    found = None
    with _explaining(label, Path()):
        try:
            found = find_spec(place) if top in sys.modules or find_spec(top) else None
        except ModuleNotFoundError as error:
            if error.name != place:
                raise
    if found is None or found.origin is None or not Path(found.origin).is_file():
        raise UsageError(
            f"no module {place!r} with Python code; install it, or write PATH.py:NAME for a file"
        )
    return place, Path(found.origin).resolve(), label


def _root(module: str, path: Path) -> tuple[Path, str | None]:
    """Return the folder whose files are hashed, and the only package of it that is, or None for all."""
    depth = 0 if _PLACES.get(module) == path else module.count(".") + (path.name == "__init__.py")
    root = path.parents[depth]
    installed = {Path(sysconfig.get_path(key)).resolve() for key in ("purelib", "platlib", "stdlib")}
    return root, module.partition(".")[0] if root in installed else None


@dataclass(frozen=True)
class _Code:
    """The files of a program: path → content, its modules of the own folder, and the packages that it imports."""

    root: Path
    files: Mapping[Path, bytes]
    own: frozenset[str]
    packages: frozenset[str]

    @classmethod
    def read(cls, module: str, path: Path, label: str) -> _Code:
        root, only = _root(module, path)
        files: dict[Path, bytes] = {}
        own: set[str] = set()
        packages: set[str] = set()
        waiting = [path, *_files(root, module)]
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
        return cls(root, files, frozenset(own), frozenset(packages - own - {_OWN} - sys.stdlib_module_names))

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


def _public(source: bytes) -> list[str]:
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


def _claim(places: Mapping[str, Path]) -> None:
    """Make modules importable from these places; refuse one that another place has, by a UsageError."""
    if _Finder not in sys.meta_path:
        sys.meta_path.insert(0, _Finder)
    for name, place in places.items():
        if name not in _PLACES:
            _PLACES[name] = place
        elif _PLACES[name] != place:
            raise UsageError(_clash(name, place, _PLACES[name]))


def _clash(name: str, place: Path, other: object) -> str:
    return (
        f"the module {name!r} of {place} cannot be loaded, because one of the same name is loaded from {other}; "
        f"rename one of them"
    )


def _run(module: str, code: _Code, label: str) -> Any:
    """Import a module, again if its code has changed."""
    if _DIGESTS.get(module) not in (None, code.digest):
        for name, one in list(sys.modules.items()):
            file = getattr(one, "__file__", None)
            if file and Path(file).resolve() in code.files:
                del sys.modules[name]
        importlib.invalidate_caches()
    root = str(code.root)
    for name in code.own:
        wanted, loaded = PathFinder.find_spec(name, [root]), getattr(sys.modules.get(name), "__spec__", None)
        if name in sys.modules and _where(loaded) != _where(wanted):
            raise UsageError(f"{label}: {_clash(name, code.root, _where(loaded) or 'Python itself')}")
    _claim(dict.fromkeys(code.own, code.root))
    if root not in sys.path:
        sys.path.append(
            root
        )  # for imports by importlib; last, so that no file of it hides an installed module
    with _explaining(label, next(iter(code.files))):
        found = importlib.import_module(module)
    _DIGESTS[module] = code.digest
    return found


def _where(spec: ModuleSpec | None) -> Path | None:
    if spec is None:
        return None
    places = (
        [spec.origin] if spec.has_location and spec.origin else [*(spec.submodule_search_locations or ())]
    )
    return Path(places[0]).resolve() if places else None


@contextmanager
def _explaining(label: str, path: Path) -> Iterator[None]:
    """Raise one UsageError for whatever the code of a file raises while it is loaded."""
    try:
        with redirect_stdout(sys.stderr):  # what it prints must not be among the lines of --json
            yield
    except (KeyboardInterrupt, UsageError):
        raise
    except BaseException as error:
        if isinstance(error, ModuleNotFoundError) and error.name and "." not in error.name:
            near = did_you_mean(error.name, [one.stem for one in path.parent.glob("*.py")])
            raise UsageError(
                f"{label} imports {error.name!r}, which is neither installed nor in its folder{near}; "
                f"install its package, or correct the name"
            ) from None
        lines = [at.lineno for at in traceback.extract_tb(error.__traceback__) if at.filename == str(path)]
        where = f", line {lines[-1]}" if lines else ""
        raise UsageError(f"{label} cannot be loaded{where}: {type(error).__name__}: {error}") from None
