"""NumPy's zip archive: an array ``t`` [s], one array per channel, and ``s2r.json`` with units and meta.

Only the chosen arrays are read, according to their headers. No content of a file is ever unpickled.
"""

from __future__ import annotations

import ast
import json
import lzma
import math
import zipfile
import zlib
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.errors import TraceError, shortened
from s2r_spec.logs import cells, own
from s2r_spec.logs import table as parsed
from s2r_spec.logs.table import Chooser, Column, Head, Table, check_size, quote
from s2r_spec.trace import Trace

_NOTES = "s2r.json"
_NOTE_LENGTH = 2**24
"""Budget: bytes of ``s2r.json``, 16 million."""
_HEADER_LENGTH = 10_000
"""Budget: bytes of an array's header, numpy's own limit; a longer header is slow to parse."""
_DAMAGED = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, MemoryError, RuntimeError)
_BROKEN = (*_DAMAGED, ValueError, KeyError, SyntaxError, TypeError)
"""Definition: what :mod:`zipfile` and numpy raise for a damaged archive."""


def load(path: Path, choose: Chooser) -> Table:
    """Read the chosen arrays of a file.

    Raises:
        TraceError: the file is not an archive, or an array in it is damaged.
        OSError: the file cannot be read.
    """
    parsed.check_file(path)
    try:
        if not zipfile.is_zipfile(path):
            raise TraceError("this is not an .npz archive")
        with zipfile.ZipFile(path) as archive:
            return _table(archive, choose)
    except _BROKEN as error:
        reason = shortened(str(error) or type(error).__name__)
        raise TraceError(f"this is not an .npz archive of arrays: {reason}") from None


def _table(archive: zipfile.ZipFile, choose: Chooser) -> Table:
    members = {name.removesuffix(".npy"): name for name in archive.namelist()}
    parsed.check_columns(len(members))
    units, meta, record = _notes(archive, members.pop(_NOTES, None))
    names = list(members)
    heads = tuple(Head(name, None, units.get(name)) for name in names)
    needed = sorted(set(choose(heads)))
    arrays = {number: _Member.of(archive, members[names[number]]) for number in needed}
    check_size(sum(one.numbers for one in arrays.values()))
    columns = {number: _column(archive, one) for number, one in arrays.items()}
    if unknown := set(units) - set(names):
        raise TraceError(f"{_NOTES} has a unit for {quote(min(unknown))}, which is not an array of the file")
    place = parsed.places_in(heads, "sample {} of the array {}")
    return Table(heads, columns, meta, place, own=record)


@dataclass(frozen=True)
class _Member:
    """The header of an array in the archive."""

    name: str
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    fortran: bool
    start: int
    fault: str = ""

    @classmethod
    def of(cls, archive: zipfile.ZipFile, name: str) -> _Member:
        """Read the header of an array, and check that the archive holds enough bytes for it."""
        size = archive.getinfo(name).file_size
        with archive.open(name) as stream:
            version = np.lib.format.read_magic(stream)
            wide = 2 if version == (1, 0) else 4
            length = int.from_bytes(stream.read(wide), "little")
            if length > _HEADER_LENGTH:
                raise ValueError(f"the header of {name} is too long")
            header = ast.literal_eval(stream.read(length).decode("utf-8" if version >= (3, 0) else "latin1"))
        dtype = np.lib.format.descr_to_dtype(header["descr"])
        shape, start = header["shape"], 8 + wide + length
        if not isinstance(shape, tuple) or not all(isinstance(n, int) and n >= 0 for n in shape):
            raise ValueError(f"the shape of {name} is {str(shape)[:40]}")
        fortran, fault = bool(header["fortran_order"]), ""
        if dtype.hasobject:
            fault = "holds Python objects, which s2r does not read"
        elif dtype.names is not None or not dtype.itemsize:
            fault = "holds records, not numbers"
        elif math.prod(shape) * dtype.itemsize > size - start:
            raise ValueError(
                f"the header of {name} states the shape {str(shape)[:60]}, but its data are shorter"
            )
        return cls(name, dtype, shape, fortran, start, fault)

    @property
    def numbers(self) -> int:
        """Memory for the array, in numbers of 8 bytes."""
        if self.fault:
            return 0
        size = parsed.TEXT_SIZE if self.dtype.kind in "US" else 1
        return math.prod(self.shape) * max(size, self.dtype.itemsize // 8)


def _array(archive: zipfile.ZipFile, member: _Member) -> NDArray[Any]:
    with archive.open(member.name) as stream:
        if len(stream.read(member.start)) != member.start:
            raise EOFError("it ends inside a header")
        data = stream.read(math.prod(member.shape) * member.dtype.itemsize)
        stream.read(1)  # the archive compares the checksum at the end
    flat = np.frombuffer(data, dtype=member.dtype)
    return flat.reshape(member.shape, order="F" if member.fortran else "C")


def _column(archive: zipfile.ZipFile, member: _Member) -> Column:
    if member.fault:
        return Column.without(member.fault)
    values = _array(archive, member)
    if values.ndim == 0:
        return Column.without("is one value for the whole file, not one per sample")
    if values.ndim > 2:
        return Column.without(f"has the shape {values.shape}, not one number or one vector per sample")
    if values.dtype.kind == "S":
        values = np.char.decode(values, "utf-8", "replace")
    if values.dtype.kind == "U":
        words = np.empty(values.shape, dtype=object)
        words[...] = np.char.strip(values)
        return Column(words, cells.is_missing(words) if values.ndim == 1 else None)
    if values.dtype.kind not in "biufMm":
        return Column.without(f"holds values of the type {values.dtype}, not numbers")
    return Column(values)


def _notes(archive: zipfile.ZipFile, name: str | None) -> parsed.Description:
    if name is None:
        return {}, {}, {}
    member = _Member.of(archive, name)
    dtype = member.dtype
    if member.fault or dtype.kind != "U" or member.shape or dtype.itemsize > _NOTE_LENGTH:
        raise TraceError(f"the array {_NOTES!r} is not a string")
    try:
        text = str(_array(archive, member)[()])
    except ValueError as error:
        raise TraceError(f"the array {_NOTES!r} is not JSON: {error}") from None
    return parsed.parse_description(text, f"the array {_NOTES!r}")


def write(trace: Trace, path: Path) -> None:
    """Write a trace."""
    for name in ("t", _NOTES):
        if name in trace.channels:
            raise TraceError(f"a channel cannot be called {name!r} in an .npz file")
    times, channels, record = own.rows(trace)
    arrays = {"t": times, **channels, _NOTES: np.array(json.dumps(own.description(trace, record)))}
    # numpy.savez takes names as keywords, so a channel called "file" would break it. And one write of the whole file
    # takes half the time of many small writes and seeks.
    whole = BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            one = BytesIO()
            np.lib.format.write_array(one, array, allow_pickle=False)
            # Without a time of day, so that the same trace makes the same file.
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), one.getbuffer())
    path.write_bytes(whole.getbuffer())
