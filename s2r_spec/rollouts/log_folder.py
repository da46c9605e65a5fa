"""The folder of a ``log`` backend: its recordings, with the parameters of each.

Either ``rollouts.csv`` lists the parameters of whole files, or the files are long logs, from which episodes are cut and
whose channels hold the parameters.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from s2r_spec import logs
from s2r_spec.errors import TraceError, UsageError, one_of, shortened
from s2r_spec.logs.interpret import Loaded
from s2r_spec.logs.table import regular
from s2r_spec.logs.topics.formats import FORMATS, opener
from s2r_spec.rollouts.excerpts import excerpt
from s2r_spec.rollouts.log_options import LogOptions
from s2r_spec.trace import Trace

TABLE = "rollouts.csv"
_ID, _SEED = "id", "seed"
_LONGEST = 2**24
"""Budget: characters of the table, 16 million; twice as many take 0.3 GB more."""


class LogError(UsageError):
    """A folder of recorded rollouts has an error; the message names the file and the line."""


@dataclass(frozen=True)
class _Row:
    line: int
    id: str
    params: dict[str, float]


@dataclass(frozen=True)
class Entry:
    """A recording: its file, its test parameters, and its trace with notes."""

    source: str
    params: dict[str, float]
    loaded: Loaded


@dataclass(frozen=True)
class Folder:
    """The recordings of a folder.

    Args:
        units: parameter → its unit; "" if none is written.
        entries: the recordings in order.
        files: the files that determine them.
        assumptions: what a statement about the recordings assumes of their choice, a sentence each.
    """

    units: Mapping[str, str]
    entries: tuple[Entry, ...]
    files: tuple[Path, ...]
    assumptions: tuple[str, ...] = ()


def tabulated(options: LogOptions) -> Folder:
    """Return the whole files that ``rollouts.csv`` lists.

    Raises:
        LogError: the table or a file is missing or wrong, or episodes are to be cut.
        TraceError: a file is not a trace.
    """
    root = options.folder
    if options.excerpts.cuts or options.excerpts.sources:
        raise LogError(
            f"{root / TABLE} lists the tests of whole files; leave out when, start, duration and param, "
            f"or remove the table"
        )
    units, rows = _table(root / TABLE)
    files = _files(root, rows)
    loaded = _with_placeholders({row.id: options.load(files[row.id]) for row in rows})
    entries = tuple(Entry(str(files[row.id]), row.params, loaded[row.id]) for row in rows)
    return Folder(units, entries, (root / TABLE, *sorted(files.values())))


def episodes(options: LogOptions) -> Folder:
    """Return the episodes of all logs of a folder.

    Raises:
        LogError: the folder has no logs, or a parameter has several units.
        TraceError: a file is not a log, or has no complete episode.
    """
    paths = _logs(options.folder)
    units: dict[str, str] = {}
    entries: list[Entry] = []
    sentences: list[str] = []
    for path in paths:
        found = excerpt(path, {}, None, math.inf, options.excerpts)
        for episode in found.episodes:
            for name, (_, unit) in episode.values.items():
                if units.setdefault(name, unit) != unit:
                    raise LogError(
                        f"{episode.name}: the parameter {name} is in {unit!r}, and before in {units[name]!r}"
                    )
            params = {name: value for name, (value, _) in episode.values.items()}
            entries.append(Entry(episode.name, params, Loaded(episode.trace, found.notes, found.dated, {})))
        sentences += [f"{path.name}: {note}" for note in found.cut]
    assumption = (
        f"the {len(entries)} episodes of {len(paths)} logs are all tests that were run, chosen before their results "
        f"were known ({'; '.join(sentences)})"
    )
    return Folder(units, tuple(entries), tuple(_parts(paths)), (assumption,))


def _logs(root: Path) -> list[Path]:
    """Return the logs of a folder; hidden files are incomplete."""
    if not root.is_dir():
        raise LogError(f"there is no folder {root}; log:FOLDER needs one with recordings")
    known = (*logs.FORMATS, *FORMATS)
    found = [
        path
        for path in sorted(root.iterdir())
        if not path.name.startswith(".") and (opener(path) is not None or path.suffix.lower() in known)
    ]
    if not found:
        raise LogError(f"{root} has no log; s2r reads {', '.join(known)}, and folders of ROS 2 bags")
    return found


def _parts(paths: Sequence[Path]) -> list[Path]:
    """Return the files of logs, some of which are folders."""
    return [file for path in paths for file in (sorted(path.iterdir()) if path.is_dir() else [path])]


def _with_placeholders(loaded: Mapping[str, Loaded]) -> dict[str, Loaded]:
    """Return the loaded files; a placeholder (a failed rollout without a log) gets the first recording's channels.

    Its samples are NaN, so that no channel is left out because the placeholder lacks it.
    """
    first = next((one.trace for one in loaded.values() if not _is_placeholder(one.trace)), None)
    if first is None:
        return dict(loaded)
    completed = {}
    for name, one in loaded.items():
        if _is_placeholder(one.trace):
            count = len(one.trace)
            samples = {key: np.full((count, *v.shape[1:]), np.nan) for key, v in first.channels.items()}
            one = replace(
                one, trace=Trace(one.trace.times, samples, first.units, one.trace.meta), left_out={}
            )
        completed[name] = one
    return completed


def digest(trace: Trace) -> bytes | None:
    """Return a hash of the samples, equal for two copies of one recording; None if no sample is finite.

    A failed rollout may have no log. Its placeholder has no finite sample, and is not a copy of another.
    """
    if not any(np.isfinite(values).any() for values in trace.channels.values()):
        return None
    sha = hashlib.sha256(trace.times.tobytes())
    for name, values in sorted(trace.channels.items()):
        # NaN has many bit patterns, and a file need not keep them.
        sha.update(name.encode() + np.where(np.isnan(values), np.nan, values).tobytes())
    return sha.digest()


def _is_placeholder(trace: Trace) -> bool:
    return trace.failure is not None and digest(trace) is None


def _table(path: Path) -> tuple[dict[str, str], list[_Row]]:
    """Return parameter → unit ("" if none is written), and the rows."""
    if not path.parent.is_dir():
        raise LogError(f"there is no folder {path.parent}; log:FOLDER needs one with recordings and {TABLE}")
    try:
        if path.exists():
            regular(path)
        with path.open(newline="", encoding="utf-8-sig") as stream:
            text = stream.read(_LONGEST)
        if len(text) == _LONGEST:
            raise LogError(f"{path} has {_LONGEST:,} characters or more; it needs one row per recording")
        reader = csv.reader(io.StringIO(text, newline=""), strict=True, skipinitialspace=True)
        lines = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(row)]
    except TraceError as error:
        raise LogError(f"{path}: {error}") from None
    except OSError as error:
        raise LogError(
            f"cannot read {path}: {error.strerror or error}; this file must list the parameters of each "
            f"recording: a header id,<parameter>,… and one row per recording"
        ) from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise LogError(f"{path} is not comma-separated UTF-8 text: {error}") from None
    if len(lines) < 2:
        raise LogError(f"{path} lists no recording; it needs a header id,<parameter>,… and rows")
    (number, header), *body = lines
    units: dict[str, str] = {}
    for place, text in enumerate(header):
        name, unit = _parameter(text)
        if not name or name in units or (place == 0) != (text == _ID):
            raise LogError(
                f"{path}, line {number}: the header is {shortened(','.join(header))!r}; "
                f"it must be 'id' and one name per parameter, such as 'vd' or 'vd [m/s]'"
            )
        units[name] = unit
    names = list(units)
    rows: dict[str, _Row] = {}
    for line, cells in body:
        if len(cells) != len(names):
            raise LogError(
                f"{path}, line {line}: the row has {len(cells)} values, but there are {len(names)} columns"
            )
        name = cells[0]
        if name in rows:
            raise LogError(
                f"{path}, line {line}: the id {name!r} is already in line {rows[name].line}; ids must differ"
            )
        params = {key: _number(path, line, key, text) for key, text in zip(names[1:], cells[1:], strict=True)}
        params.pop(_SEED, None)
        rows[name] = _Row(line, name, params)
    return {name: unit for name, unit in units.items() if name not in (_ID, _SEED)}, list(rows.values())


def _parameter(text: str) -> tuple[str, str]:
    """Return the name and the unit ("" if there is none) in a cell such as "vd [m/s]"; ("", "") for another form."""
    name, bracket, rest = text.partition("[")
    unit = rest.removesuffix("]")
    fits = not any(mark in name + unit for mark in "[]") and (rest != unit or not bracket)
    return (name.strip(), unit) if fits else ("", "")


def _number(path: Path, line: int, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        what = "is empty" if not text else f"is {text!r}, not a finite number"
        raise LogError(f"{path}, line {line}: the parameter {name!r} {what}")
    return value


def _files(root: Path, rows: Sequence[_Row]) -> dict[str, Path]:
    """Return id → file; each row has exactly one file, and each file a row."""
    by_id: dict[str, list[Path]] = {}
    for path in sorted(root.iterdir()):
        # A hidden file is incomplete: some program still writes it, or was killed.
        if path.suffix.lower() in logs.FORMATS and path.name != TABLE and not path.name.startswith("."):
            by_id.setdefault(path.stem, []).append(path)
    for row in rows:
        paths = by_id.get(row.id, [])
        if len(paths) != 1:
            endings = ", ".join(f"{row.id}{ending}" for ending in logs.FORMATS)
            fault = f"has no file; there must be one of {endings}" if not paths else (
                f"has several files: {one_of(path.name for path in paths)}; keep one"
            )  # fmt: skip
            raise LogError(f"{root / TABLE}, line {row.line}: the id {row.id!r} {fault}")
    for name in by_id.keys() - {row.id for row in rows}:
        raise LogError(
            f"{by_id[name][0]} has no row in {TABLE}; add one with its parameters, "
            f"because leaving out a recording biases the bound"
        )
    return {row.id: by_id[row.id][0] for row in rows}
