"""Python code by the name of its file or module: ``cart.py:Cart``, ``my_robot.cart:Cart``.

A file runs as a script would: modules in its own folder are importable. Its module has a name of its own in
``sys.modules``, so its classes pickle; :func:`pack` tells another process where such modules are. The digest covers the
code that runs: the file, the files of its own folder that it imports, and the versions of packages that these import.
"""

from __future__ import annotations

import importlib
import pickle
import pickletools
import re
import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass
from hashlib import sha256
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import cache_from_source, find_spec, spec_from_file_location
from pathlib import Path
from socket import gethostname
from typing import Any

from s2r_spec.backend.imports import Code, public_names
from s2r_spec.base.errors import UsageError, did_you_mean, one_of, suggest


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
    code = Code.read("" if place.endswith(".py") else module, path, label)
    names = public_names(code.files[path])
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


def read_code(text: str, folder: Path | None = None) -> tuple[str, tuple[Path, ...]]:
    """Return the digest and the files of :func:`load_code`, without running any of them."""
    place, name = _split(text)
    module, path, label = _locate(place, folder or Path())
    code = Code.read("" if place.endswith(".py") else module, path, label)
    return sha256(f"{code.digest} {name}".encode()).hexdigest(), tuple(code.files)


def pack(value: object) -> bytes:
    """Return a pickle that :func:`unpack` reads in another process, with place and digest of each file it needs."""
    data = pickle.dumps(value)
    if not _PLACES:
        return pickle.dumps(({}, {}, data))
    # The names of modules are whole texts in a pickle. Files that are loaded here for something else stay out.
    texts = {
        text
        for _, argument, _ in pickletools.genops(data)
        if isinstance(argument, str)
        for text in argument.split()
    }
    tops = {text.partition(".")[0] for text in texts} & _PLACES.keys()
    files = {module for module, own in _OWN_MODULES.items() if module in texts or own & tops}
    needed = tops | {name for module in files for name in (module, *_OWN_MODULES[module])} & _PLACES.keys()
    digests = {module: _DIGESTS[module] for module in files}
    return pickle.dumps(({name: _PLACES[name] for name in needed}, digests, data))


def unpack(data: bytes) -> Any:
    """Return the object of :func:`pack`; a file with its class runs first, if it has not yet run here.

    Raises:
        UsageError: a file is missing on this computer, or is not the one that was loaded.
    """
    places, digests, value = pickle.loads(data)
    _claim(places)
    for module, digest in digests.items():
        path = places.get(module)
        if path is not None and path.suffix == ".py" and _DIGESTS.get(module) != digest:
            if not path.is_file() or Code.read("", path, str(path)).digest != digest:
                raise UsageError(
                    f"{path} on {gethostname()} is not the file that the run began with; copy it there, with the files "
                    f"that it imports, and install the same versions"
                )
            _DIGESTS[module] = digest
    return pickle.loads(value)


_PLACES: dict[str, Path] = {}
"""Module → the file that it is, or the folder that it is in; for modules that are not on the path of Python."""
_DIGESTS: dict[str, str] = {}
"""Module → digest of its code when it was loaded."""
_OWN_MODULES: dict[str, frozenset[str]] = {}
"""Module → the modules beside its file that it imports."""
_CONTENTS: dict[Path, bytes] = {}
"""File → its content when it was loaded."""


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
    with explaining(label, Path()):
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


def _run(module: str, code: Code, label: str) -> Any:
    """Import a module, again if its code has changed."""
    changed = any(_CONTENTS.get(path, content) != content for path, content in code.files.items())
    if changed or _DIGESTS.get(module) not in (None, code.digest):
        for name, one in list(sys.modules.items()):
            file = getattr(one, "__file__", None)
            if file and Path(file).resolve() in code.files:
                del sys.modules[name]
        for (
            path
        ) in code.files:  # Python does not see a change of the same size within a second of the old bytecode
            with suppress(OSError, NotImplementedError, ValueError):
                Path(cache_from_source(str(path))).unlink(missing_ok=True)
        importlib.invalidate_caches()
    root = str(code.root)
    for name in code.own:
        wanted, loaded = PathFinder.find_spec(name, [root]), getattr(sys.modules.get(name), "__spec__", None)
        if name in sys.stdlib_module_names or (name in sys.modules and _where(loaded) != _where(wanted)):
            raise UsageError(f"{label}: {_clash(name, code.root, _where(loaded) or 'Python itself')}")
    _claim(dict.fromkeys(code.own, code.root))
    # For imports by importlib. The folder is the last one, so that no file of it hides an installed module.
    if code.own and root not in sys.path:
        sys.path.append(root)
    _CONTENTS.update(code.files)
    with explaining(label, next(iter(code.files))):
        found = importlib.import_module(module)
    _DIGESTS[module], _OWN_MODULES[module] = code.digest, code.own
    return found


def _where(spec: ModuleSpec | None) -> Path | None:
    if spec is None:
        return None
    places = (
        [spec.origin] if spec.has_location and spec.origin else [*(spec.submodule_search_locations or ())]
    )
    return Path(places[0]).resolve() if places else None


@contextmanager
def explaining(label: str, path: Path) -> Iterator[None]:
    """Raise one UsageError for whatever the code of a file raises; ``label`` is what it loads, in words."""
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
