"""NumPy's zip: an array ``t`` [s], one a channel, and ``s2r.json`` with units and meta."""

from __future__ import annotations

import json
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.errors import TraceError, one_of
from s2r_spec.logs.times import TIME as _TIME
from s2r_spec.logs.times import no_times
from s2r_spec.trace import Trace

_NOTES = "s2r.json"


def read(path: Path, time: str = _TIME) -> Trace:
    """Read a file of :func:`write`, or any other with an array of times and one a channel."""
    try:
        if path.is_file() and not zipfile.is_zipfile(path):
            raise TraceError("this is not an .npz archive")
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (ValueError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise TraceError(f"this is not an .npz archive of numeric arrays: {error}") from None
    if time not in arrays:
        raise TraceError(no_times("array", time, one_of(arrays)))
    notes = _notes(arrays.pop(_NOTES, None))
    times = arrays.pop(time)
    return Trace(times, arrays, notes.get("units", {}), notes.get("meta", {}))


def _notes(array: NDArray[Any] | None) -> dict[str, Any]:
    if array is None:
        return {}
    try:
        notes = json.loads(str(array))
    except json.JSONDecodeError as error:
        raise TraceError(f"the array {_NOTES!r} is not JSON: {error}") from None
    if not isinstance(notes, dict):
        raise TraceError(f"the array {_NOTES!r} is not a JSON object")
    return notes


def write(trace: Trace, path: Path) -> None:
    """Write a trace."""
    for name in (_TIME, _NOTES):
        if name in trace.channels:
            raise TraceError(f"a channel cannot be called {name!r} in an .npz file")
    notes = json.dumps({"units": dict(trace.units), "meta": dict(trace.meta)})
    arrays = {_TIME: trace.times, **trace.channels, _NOTES: np.array(notes)}
    # numpy.savez takes names as keywords, so that a channel called "file" would break it; and a file
    # that is written once, whole, costs a journal half of what many small writes and seeks do.
    whole = BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            one = BytesIO()
            np.lib.format.write_array(one, array, allow_pickle=False)
            # No time of day: the same trace makes the same file.
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), one.getbuffer())
    path.write_bytes(whole.getbuffer())
