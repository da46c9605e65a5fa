"""The contents of an ONNX file that decide whether it is safe to open, read without onnxruntime.

An ONNX file is a protocol buffer (https://protobuf.dev/programming-guides/encoding) with the messages of
https://github.com/onnx/onnx/blob/main/onnx/onnx.proto, whose field numbers stand in ``_CHILDREN`` and ``_read_node``.
Tensors are skipped, so the time does not grow with the weights.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath, PureWindowsPath

from s2r_spec.errors import UsageError

STANDARD_DOMAINS = frozenset({"", "ai.onnx", "ai.onnx.ml", "ai.onnx.training", "com.microsoft"})
"""Definition: domains of the operators that onnxruntime brings along."""

# Message → number of a field → message in it.
_CHILDREN = {
    "model": {7: "graph", 8: "opset", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node", 9: "opset", 11: "attribute"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {13: "location"},
}


class DamagedError(Exception):
    """The bytes are no protocol buffer, or only the beginning of one."""


@dataclass
class Contents:
    """What an ONNX file uses.

    Attributes:
        opset: version of the standard operators; 0 if the file does not say.
        operators: (domain, name) of every operator, also in functions and branches.
        functions: (domain, name) of every function that the file defines.
        locations: paths of external data, as the file writes them.
        graphs: number of graphs.
    """

    opset: int = 0
    operators: set[tuple[str, str]] = field(default_factory=set)
    functions: set[tuple[str, str]] = field(default_factory=set)
    locations: set[str] = field(default_factory=set)
    graphs: int = 0


def read_contents(data: bytes) -> Contents:
    """Return what a file uses.

    Raises:
        DamagedError: it is not an ONNX file.
    """
    found = Contents()
    try:
        _read("model", memoryview(data), found)
    except (IndexError, UnicodeDecodeError, RecursionError) as error:
        raise DamagedError from error
    if not found.graphs:
        raise DamagedError
    return found


def external_files(path: Path, locations: set[str]) -> tuple[Path, ...]:
    """Return the files of external data, sorted.

    Raises:
        UsageError: one is missing, or lies outside the folder of the model, also by a symbolic link.
    """
    folder = path.parent.resolve()
    found = []
    for location in sorted(locations):
        file = path.parent / location
        absolute = PurePosixPath(location).is_absolute() or PureWindowsPath(location).drive
        parts = {*PurePosixPath(location).parts, *PureWindowsPath(location).parts}
        # A star begins a place in memory, for onnxruntime.
        if absolute or "*" in location or ".." in parts or not file.resolve().is_relative_to(folder):
            raise UsageError(
                f"{path}: its external data {location!r} lie outside the folder of the model; "
                f"export the model as a single file"
            )
        if not file.is_file():
            raise UsageError(
                f"{path}: the file {location!r} with its weights is missing; copy it beside the model"
            )
        found.append(file)
    return tuple(found)


def _read(message: str, data: memoryview, found: Contents) -> None:
    """Read a message and those in it into ``found``."""
    own: dict[int, str] = {}
    version = 0
    for number, value in _fields(data):
        if isinstance(value, int):
            version = value if number == 2 else version
            continue
        if number in (1, 2, 4, 7, 10) and message in ("opset", "function", "node", "location"):
            own[number] = "" if _CHILDREN.get(message, {}).get(number) else str(value, "utf-8")
        if child := _CHILDREN.get(message, {}).get(number):
            _read(child, value, found)
    if message == "graph":
        found.graphs += 1
    elif message == "node":
        found.operators.add((own.get(7, ""), own.get(4, "")))
    elif message == "function":
        found.functions.add((own.get(10, ""), own.get(1, "")))
    elif message == "location" and own.get(1) == "location":
        found.locations.add(own.get(2, ""))
    elif message == "opset" and own.get(1, "") in ("", "ai.onnx"):
        found.opset = max(found.opset, version)


def _fields(data: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Yield number and value of every field that is an integer or bytes."""
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        kind = key & 7
        if kind == 0:
            value, at = _varint(data, at)
            yield key >> 3, value
        elif kind == 2:
            size, at = _varint(data, at)
            if at + size > len(data):
                raise DamagedError
            yield key >> 3, data[at : at + size]
            at += size
        elif kind in (1, 5):
            at += 8 if kind == 1 else 4
        else:
            raise DamagedError
    if at > len(data):
        raise DamagedError


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """Return an integer of seven bits a byte, and the place after it."""
    value = shift = 0
    while True:
        byte = data[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at
        if shift > 63:
            raise DamagedError
