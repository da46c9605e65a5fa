"""MATLAB's ``.mat``: variables and structures with times are topics. Files from version 7.3 on are HDF5.

A text ``unit`` or ``units`` in a structure is the unit of its arrays.
An object, such as a ``timeseries`` or a table, cannot be read: MATLAB stores it in a form of its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from s2r_spec.base.errors import TraceError
from s2r_spec.logs.library import reason_of
from s2r_spec.logs.options import TimeOptions
from s2r_spec.logs.table import check_file
from s2r_spec.logs.topics import arrays as named
from s2r_spec.logs.topics.arrays import Array, ArrayLog, is_unit_path, squeeze
from s2r_spec.logs.topics.hdf5 import open_hdf5

_HDF5 = b"\x89HDF\r\n\x1a\n"
_BLOCK = 512
"""Definition: bytes before the HDF5 part of a MATLAB file."""


def open_matlab(path: Path, options: TimeOptions | None = None) -> ArrayLog:
    """Return the arrays of a file, with the times that the user says.

    Raises:
        TraceError: the file is not a MATLAB file, or has no arrays with times.
    """
    check_file(path)
    with path.open("rb") as stream:
        start = stream.read(_BLOCK + len(_HDF5))
    if start[_BLOCK:] == _HDF5 or start.startswith(_HDF5):
        return open_hdf5(path, options)
    from scipy.io import loadmat

    try:
        content = loadmat(path, simplify_cells=True, verify_compressed_data_integrity=True)
    except OSError as error:
        if error.errno is not None:
            raise
        raise TraceError(f"this is not a MATLAB file: {reason_of(error)}") from None
    except Exception as error:  # SciPy lets errors of struct, zlib and numpy through
        raise TraceError(f"this is not a complete MATLAB file: {reason_of(error)}") from None
    variables = {name: value for name, value in content.items() if not name.startswith("__")}
    leaves = dict(_leaves(variables, ""))
    texts = {path: leaf for path, leaf in leaves.items() if isinstance(leaf, str)}
    numbers = {path: leaf for path, leaf in leaves.items() if path not in texts}
    arrays = {path: Array(leaf.shape, partial(np.asarray, leaf)) for path, leaf in numbers.items()}
    objects = {name: named.as_object(kind) for name, kind in _objects(content)}
    return ArrayLog(named.with_units(arrays, texts), options, objects)


def _leaves(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield (path, array) of the numbers, and (path, text) of units, in variables and structures.

    Elements of a list are numbered from 1.
    """
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _leaves(inner, f"{path}.{name}" if path else name)
    elif isinstance(value, list):
        for number, inner in enumerate(value, 1):
            yield from _leaves(inner, f"{path}_{number}")
    elif isinstance(value, str):
        if is_unit_path(path):
            yield path, value
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.ndim:
        yield path, value.reshape(squeeze(value.shape))


def _objects(content: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield (name, class) of the objects of MATLAB in a file; SciPy calls them "None" and says their own names."""
    from scipy.io.matlab import MatlabOpaque

    for value in content.values():
        if isinstance(value, MatlabOpaque):
            for one in value.ravel():
                yield named.as_text(one["s0"]), named.as_text(one["s2"])
