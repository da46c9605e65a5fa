"""HDF5, read by ``h5py`` (the extra ``logs``): each group with times is a topic. Also MATLAB files from version 7.3 on.

A unit is the attribute ``unit`` or ``units`` of a dataset.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.errors import TraceError, shortened
from s2r_spec.logs.library import library
from s2r_spec.logs.table import few, regular
from s2r_spec.logs.topics.arrays import Array, ArrayLog, Asked, as_object, squeezed
from s2r_spec.printable import one_line

_MATLAB = "MATLAB_class"
_OBJECT = "MATLAB_object_decode"


def open_hdf5(path: Path, asked: Asked | None = None) -> ArrayLog:
    """Return the arrays of a file, with the times that the user says.

    Raises:
        TraceError: h5py is not installed, or the file is not HDF5.
    """
    regular(path)
    h5py = library("h5py", "HDF5 files")
    arrays: dict[str, Array] = {}
    objects: dict[str, str] = {}

    def visit(name: str, item: Any) -> None:
        if name.startswith("#refs#") or not isinstance(item, h5py.Dataset):
            return
        if h5py.check_ref_dtype(item.dtype) is h5py.Reference:
            for path, element in _elements(item, name):
                add(path, element)
        elif _OBJECT in item.attrs:
            objects[name.replace("/", ".")] = as_object(_text(item.attrs.get(_MATLAB)))
        else:
            add(name, item)

    def add(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "biufmM":
            turned = _MATLAB in item.attrs  # MATLAB has the samples of a column last
            shape = squeezed(item.shape[::-1] if turned else item.shape)
            unit = item.attrs.get("unit", item.attrs.get("units"))
            arrays[name.replace("/", ".")] = Array(
                shape, partial(_read, h5py, path, item.name, turned), unit if isinstance(unit, str) else None
            )

    with _Errors(path), h5py.File(path) as file:
        file.visititems(visit)
    return ArrayLog(arrays, asked, objects)


def _elements(references: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield (name, item) of what MATLAB's references lead to: elements of a list, or of a field of structures.

    They are numbered from 1, ``list_1`` or ``structures_1.field``.
    """
    few(references.size)
    folder, slash, field = ("", "", name) if _MATLAB in references.attrs else name.rpartition("/")
    for number, one in enumerate(references[()].ravel(), 1):
        if one:
            numbered = f"{folder}_{number}{slash}{field}" if folder else f"{name}_{number}"
            yield numbered, references.file[one]


def _text(attribute: Any) -> str:
    return attribute.decode(errors="replace") if isinstance(attribute, bytes) else str(attribute)


def _read(h5py: Any, path: Path, name: str, turned: bool) -> NDArray[Any]:
    with _Errors(path), h5py.File(path) as file:
        values = np.asarray(file[name][()])
    values = values.T if turned else values
    return values.reshape(squeezed(values.shape))


class _Errors:
    """Turns what h5py raises for a damaged file into a TraceError."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        """Do nothing."""

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        """Raise a TraceError for an error of h5py."""
        if isinstance(error, OSError | RuntimeError | KeyError | ValueError) and not isinstance(
            error, TraceError
        ):
            if isinstance(error, OSError) and error.errno is not None:
                return
            reason = shortened(one_line(str(error)) or type(error).__name__)
            raise TraceError(f"this is not a complete HDF5 file: {reason}") from None
