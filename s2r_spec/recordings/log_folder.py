"""The folder of a ``log`` backend: its recordings, with the parameters of each.

Every log of the folder is a recording, or several if episodes are cut from it. The parameters of a log are in its row
of ``rollouts.csv``, or in its channels. A row or a trace's ``meta`` may name a protocol: its parameters are those of
the protocol, and cells of the tests' parameters stay empty.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from s2r_spec import logs
from s2r_spec.backend.protocols import PROTOCOL
from s2r_spec.base.errors import TraceError, UsageError, one_of, shortened
from s2r_spec.logs.formats.csv_head import is_number
from s2r_spec.logs.interpret import Loaded
from s2r_spec.logs.table import check_file
from s2r_spec.logs.topics.formats import FORMATS, opener
from s2r_spec.recordings.log_episodes import LogEpisodes, read_log_episodes
from s2r_spec.recordings.log_options import LogOptions
from s2r_spec.trace import Trace

TABLE = "rollouts.csv"
_ID, _SEED = "id", "seed"
_NAME = re.compile(r"[A-Za-z_][\w.-]*")
"""Definition: the form of a protocol's name."""
_LONGEST = 2**24
"""Budget: characters of the table, 16 million."""


class LogError(UsageError):
    """A folder of recorded rollouts has an error; the message names the file and the line."""


@dataclass(frozen=True)
class _TestRow:
    """A row of the table; empty cells are no entries of ``params``, and ``protocol`` is "" for a test."""

    line: int
    id: str
    params: dict[str, float]
    protocol: str = ""


@dataclass(frozen=True)
class _Tests:
    """What ``rollouts.csv`` says: parameter → its unit ("" if none is written), and the rows."""

    units: Mapping[str, str] = field(default_factory=dict)
    rows: Sequence[_TestRow] = ()


@dataclass(frozen=True)
class Entry:
    """A recording: its file, its parameters, its trace with notes, its protocol ("" for a test of a spec), its row."""

    source: str
    params: dict[str, float]
    loaded: Loaded
    protocol: str
    row: _TestRow


@dataclass(frozen=True)
class Folder:
    """The recordings of a folder in order, and the files that determine them.

    Args:
        units: parameter → its unit; "" if none is written.
        assumptions: what a statement about the recordings assumes of their choice, a sentence each.
    """

    units: Mapping[str, str]
    entries: tuple[Entry, ...]
    files: tuple[Path, ...]
    assumptions: tuple[str, ...] = ()


def read(options: LogOptions) -> Folder:
    """Return the recordings of a folder.

    Raises:
        LogError: the table is wrong, a log has no row, or a parameter has several values or units.
        TraceError: a file is not a log, or has no complete episode.
    """
    root, settings = options.folder, options.settings
    listed = (root / TABLE).exists() or not (settings.cuts or settings.sources)
    table = _table(root / TABLE) if listed else _Tests()
    paths = _logs(root)
    if listed:
        files = _files(root, table.rows, paths)
        tests = [(files[row.id], row) for row in table.rows]
    else:
        _complete(root, paths)
        tests = [(path, _TestRow(0, path.stem, {})) for path in paths]
    if not tests:
        raise LogError(f"{root} has no log; s2r reads {', '.join(logs.READABLE)}, and folders of ROS 2 bags")
    for name in settings.sources:
        if name in table.units:
            raise LogError(
                f"{root / TABLE} gives the parameter {name}, and so does param={name}; leave one out"
            )
    units = dict(table.units)
    entries: list[Entry] = []
    sentences: list[str] = []
    for path, row in tests:
        # The run of a protocol is one recording, whatever cuts the logs of tests into parts.
        own = replace(settings, every=None) if row.protocol else settings
        log = read_log_episodes(path, {}, None, math.inf, own)
        entries += _entries(log, row, units)
        sentences += [f"{path.name}: {note}" for note in log.cut]
    if listed:
        _refuse_empty(root / TABLE, table, entries)
    if listed and not settings.cuts:
        entries = _with_placeholders(entries)
    determining = [root / TABLE] if listed else []
    for path in sorted(path for path, _ in tests):
        determining += sorted(path.iterdir()) if path.is_dir() else [path]
    assumptions: tuple[str, ...] = ()
    if sentences or not listed:
        how = f" ({'; '.join(sentences)})" if sentences else ""
        assumptions = (
            f"the {sum(not entry.protocol for entry in entries)} episodes of {len(tests)} logs are all tests that were "
            f"run, chosen before their results were known{how}",
        )
    return Folder(units, tuple(entries), tuple(determining), assumptions)


def _entries(log: LogEpisodes, row: _TestRow, units: dict[str, str]) -> list[Entry]:
    """Return the recordings of a log, with its parameters and its protocol; add the units of its parameters."""
    entries = []
    for episode in log.episodes:
        for name, (_, unit) in episode.values.items():
            if units.setdefault(name, unit) != unit:
                raise LogError(
                    f"{episode.name}: the parameter {name} is in {unit!r}, and before in {units[name]!r}"
                )
        named = episode.trace.meta.get(PROTOCOL)
        if not isinstance(named, str) or named in ("", row.protocol):
            named = row.protocol
        elif row.protocol:
            raise LogError(
                f"{episode.name} is a run of the protocol {named!r}, but line {row.line} of {TABLE} names "
                f"{row.protocol!r}; correct the row"
            )
        values = {**row.params, **{name: value for name, (value, _) in episode.values.items()}}
        notes = (*log.notes, *log.silences)
        loaded = Loaded(episode.trace, notes, log.dated, log.left_out, log.accounts, log.stated)
        entries.append(Entry(episode.name, values, loaded, named, row))
    return entries


def _refuse_empty(path: Path, table: _Tests, entries: Sequence[Entry]) -> None:
    """Refuse a test without one of the tests' parameters; a column that only protocols fill is none of them."""
    of_protocols = {name for entry in entries if entry.protocol for name in entry.row.params}
    of_tests = {name for entry in entries if not entry.protocol for name in entry.row.params}
    for entry in entries:
        for name in () if entry.protocol else table.units:
            if name not in entry.row.params and (name in of_tests or name not in of_protocols):
                raise LogError(f"{path}, line {entry.row.line}: the parameter {name!r} is empty")


def _logs(root: Path) -> list[Path]:
    """Return the logs of a folder; a hidden file is incomplete, since some program still writes it or was killed."""
    if not root.is_dir():
        raise LogError(f"there is no folder {root}; log:FOLDER needs one with recordings")
    return [
        path
        for path in sorted(root.iterdir())
        if (opener(path) is not None or path.suffix.lower() in logs.FORMATS)
        and path.name != TABLE
        and not path.name.startswith(".")
    ]


def _complete(root: Path, paths: Sequence[Path]) -> None:
    """Refuse a folder with logs that lie deeper, are compressed or did not end well: no table says they are none."""
    for path in sorted(set(root.iterdir()) - set(paths)):
        if path.name.startswith("."):
            continue
        below = sorted(one.name for one in path.iterdir() if opener(one) is not None) if path.is_dir() else []
        if not below and not any(ending.lower() in FORMATS for ending in path.suffixes[:-1]):
            continue
        held = (
            f"holds {one_of(below)}, which log:{root} does not read"
            if below
            else f"is not read by log:{root}"
        )
        raise LogError(
            f"{path} {held}: leaving out a recording biases the bound. Move the logs into {root}, unpack or "
            f"`ros2 bag reindex` them, or list all tests in {TABLE}"
        )


def _with_placeholders(entries: Sequence[Entry]) -> list[Entry]:
    """Return the entries; a placeholder (a failed rollout without a log) gets the first recording's channels.

    Its samples are NaN, so that no channel is left out because the placeholder lacks it.
    """
    tests = [one.loaded.trace for one in entries if not one.protocol]
    first = next((trace for trace in tests if not _is_placeholder(trace)), None)
    filled = []
    for entry in entries:
        trace = entry.loaded.trace
        if first is not None and not entry.protocol and _is_placeholder(trace):
            samples = {key: np.full((len(trace), *v.shape[1:]), np.nan) for key, v in first.channels.items()}
            trace = Trace(trace.times, samples, first.units, trace.meta)
            entry = replace(entry, loaded=replace(entry.loaded, trace=trace, left_out={}))
        filled.append(entry)
    return filled


def digest(trace: Trace) -> bytes | None:
    """Return a hash of the samples, equal for two copies of one recording; None if no sample is finite.

    A failed rollout may have no log. Its placeholder has no finite sample, and is not a copy of another.
    """
    # two episodes may have the same values at a clock
    trace = trace if trace.origin is None else trace.origin
    own = [one.values for one in trace.messages.values()] or list(trace.channels.values())
    if not any(np.isfinite(values).any() for values in own):
        return None
    sha = hashlib.sha256(b"" if trace.messages else trace.times.tobytes())
    for name in sorted(trace.messages or trace.channels):
        message = trace.messages.get(name)
        sha.update(name.encode() + (b"" if message is None else message.times.tobytes()))
        values = trace[name] if message is None else message.values
        # NaN has many bit patterns, and a file need not keep them.
        sha.update(np.where(np.isnan(values), np.nan, values).tobytes())
    return sha.digest()


def _is_placeholder(trace: Trace) -> bool:
    return trace.failure is not None and digest(trace) is None


def _lines(path: Path) -> list[tuple[int, list[str]]]:
    """Return (number, cells) of each line of the table of tests that is not empty: a header and rows."""
    if not path.parent.is_dir():
        raise LogError(f"there is no folder {path.parent}; log:FOLDER needs one with recordings and {TABLE}")
    try:
        if path.exists():
            check_file(path)
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
            f"recording: a header id,<parameter>,… and one row per recording. Or name the column of each parameter, "
            f"such as --param vd=vx_cmd@0"
        ) from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise LogError(f"{path} is not comma-separated UTF-8 text: {error}") from None
    if len(lines) < 2:
        raise LogError(f"{path} lists no recording; it needs a header id,<parameter>,… and rows")
    return lines


def _table(path: Path) -> _Tests:
    (number, header), *body = _lines(path)
    units: dict[str, str] = {}
    for place, text in enumerate(header):
        name, unit = _split_unit(text)
        if not name or name in units or (place == 0) != (text == _ID):
            raise LogError(
                f"{path}, line {number}: the header is {shortened(','.join(header))!r}; "
                f"it must be 'id' and one name per parameter, such as 'vd' or 'vd [m/s]'"
            )
        units[name] = unit
    names = list(units)
    has_protocols = units.get(PROTOCOL) == ""
    if has_protocols:  # numbers are a parameter of an older folder
        column = [cells[names.index(PROTOCOL)] for _, cells in body if len(cells) == len(names)]
        has_protocols = not any(column) or not all(map(is_number, column))
    rows: dict[str, _TestRow] = {}
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
        by_name = dict(zip(names[1:], cells[1:], strict=True))
        protocol = by_name.pop(PROTOCOL) if has_protocols else ""
        if protocol and not _NAME.fullmatch(protocol):
            raise LogError(
                f"{path}, line {line}: the protocol {shortened(protocol)!r} is not a name such as 'squat'; "
                f"leave the cell empty for a test"
            )
        params = {
            key: _number(path, line, key, text) for key, text in by_name.items() if text or key == _SEED
        }
        params.pop(_SEED, None)
        rows[name] = _TestRow(line, name, params, protocol)
    reserved = (_ID, _SEED, PROTOCOL) if has_protocols else (_ID, _SEED)
    return _Tests({name: unit for name, unit in units.items() if name not in reserved}, list(rows.values()))


def _split_unit(text: str) -> tuple[str, str]:
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


def _files(root: Path, rows: Sequence[_TestRow], paths: Sequence[Path]) -> dict[str, Path]:
    """Return id → log; each row has exactly one log, and each log a row."""
    by_id: dict[str, list[Path]] = {}
    for path in paths:
        by_id.setdefault(path.name if path.is_dir() else path.stem, []).append(path)
    for row in rows:
        matches = by_id.get(row.id, [])
        if len(matches) != 1:
            endings = ", ".join(f"{row.id}{ending}" for ending in logs.READABLE)
            fault = f"has no file; there must be one of {endings}" if not matches else (
                f"has several files: {one_of(path.name for path in matches)}; keep one"
            )  # fmt: skip
            raise LogError(f"{root / TABLE}, line {row.line}: the id {row.id!r} {fault}")
    for name in by_id.keys() - {row.id for row in rows}:
        raise LogError(
            f"{by_id[name][0]} has no row in {TABLE}; add one with its parameters, "
            f"because leaving out a recording biases the bound"
        )
    return {row.id: by_id[row.id][0] for row in rows}
