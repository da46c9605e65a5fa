"""HDF5, read by ``h5py`` (the extra ``logs``): each group with times is a topic. Also MATLAB files from version 7.3 on.

A unit is the attribute ``unit`` or ``units`` of a dataset, as a text of any kind: bytes of a fixed length, a string, or
an array of one of these. Times in "seconds since 1970-01-01" are in seconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.errors import TraceError
from s2r_spec.lang.units import LONGEST
from s2r_spec.logs.library import library, reason_of
from s2r_spec.logs.options import TimeOptions
from s2r_spec.logs.table import check_columns, check_file, quote
from s2r_spec.logs.topics import arrays as named
from s2r_spec.logs.topics.arrays import Array, ArrayLog, is_unit_path, squeeze

_MATLAB = "MATLAB_class"
_PACKED = ("scale_factor", "add_offset", "_FillValue")
"""Definition: attributes by which netCDF packs numbers: factor, offset, and the number that stands for none."""
_OBJECT = "MATLAB_object_decode"


def open_hdf5(path: Path, options: TimeOptions | None = None) -> ArrayLog:
    """Return the arrays of a file, with the times that the user says.

    Raises:
        TraceError: h5py is not installed, or the file is not HDF5.
    """
    check_file(path)
    h5py = library("h5py", "HDF5 files")
    arrays: dict[str, Array] = {}
    texts: dict[str, str] = {}
    origins: dict[str, str] = {}
    objects: dict[str, str] = {}

    def visit(name: str, item: Any) -> None:
        if name.startswith("#refs#") or not isinstance(item, h5py.Dataset):
            return
        if h5py.check_ref_dtype(item.dtype) is h5py.Reference:
            for path, element in _elements(item, name):
                add(path, element)
        elif _OBJECT in item.attrs:
            objects[name.replace("/", ".")] = named.as_object(named.as_text(item.attrs.get(_MATLAB)))
        else:
            add(name, item)

    def add(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset):
            return
        place = name.replace("/", ".")
        if item.attrs.get(_MATLAB) == b"char":
            if is_unit_path(place) and item.size <= LONGEST:
                texts[place] = "".join(map(chr, np.ravel(item[()])))
        elif h5py.check_string_dtype(item.dtype) is not None:
            if is_unit_path(place) and item.size == 1:
                texts[place] = named.as_text(np.ravel(item[()])[0])
        elif item.dtype.kind in "biufmM":
            turned = _MATLAB in item.attrs  # MATLAB has the samples of a column last
            shape = squeeze(item.shape[::-1] if turned else item.shape)
            unit, _, since = (_unit(item.attrs) or "").partition(" since ")
            if since and named.is_word(place):
                origins[since] = name
            arrays[place] = Array(shape, partial(_read, path, item.name, turned), unit.strip() or None)

    with _open(path) as file:
        file.visititems(visit)
    if len(origins) > 1:
        (one, first), (other, second), *_ = origins.items()
        raise TraceError(
            f"the times {quote(first)} count since {one}, and {quote(second)} since {other}; save both since the same"
        )
    return ArrayLog(named.with_units(arrays, texts), options, objects)


def _unit(attributes: Any) -> str | None:
    """Return the unit that the attributes of a dataset state; bytes that are not UTF-8 and lists are no units."""
    values = [attributes[key] for key in attributes if key.lower() in ("unit", "units")]
    values = [value for value in values if getattr(value, "shape", ()) is not None]
    raw = [one for value in values for one in np.asarray(value).ravel().tolist()]
    texts = (one.decode("utf-8", "surrogateescape") if isinstance(one, bytes) else str(one) for one in raw)
    # a program in C ends a text by a zero byte
    distinct = dict.fromkeys(one.partition("\0")[0].strip() for one in texts)
    return "\n".join(filter(None, distinct)) or None


def _elements(references: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield (name, item) of what MATLAB's references lead to: elements of a list, or of a field of structures.

    They are numbered from 1, ``list_1`` or ``structures_1.field``.
    """
    check_columns(references.size)
    folder, slash, field = ("", "", name) if _MATLAB in references.attrs else name.rpartition("/")
    for number, one in enumerate(references[()].ravel(), 1):
        if one:
            numbered = f"{folder}_{number}{slash}{field}" if folder else f"{name}_{number}"
            yield numbered, references.file[one]


def _read(path: Path, name: str, turned: bool) -> NDArray[Any]:
    with _open(path) as file:
        values, stated = np.asarray(file[name][()]), file[name].attrs
        packed = {key: np.ravel(stated[key])[0] for key in _PACKED if key in stated}
    values = values.T if turned else values
    if packed:  # the conventions of netCDF
        missing = values == packed["_FillValue"] if "_FillValue" in packed else np.zeros(values.shape, bool)
        values = values.astype(np.float64) * packed.get("scale_factor", 1.0) + packed.get("add_offset", 0.0)
        values[missing] = np.nan
    return values.reshape(squeeze(values.shape))


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    """Open a file; turn what h5py raises for a damaged one into a TraceError."""
    try:
        with library("h5py", "HDF5 files").File(path) as file:
            yield file
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise TraceError(f"this is not a complete HDF5 file: {reason_of(error)}") from None
