"""The ``log`` backend: a folder of recorded rollouts.

    run-a.npz  run-b.csv  run-c.parquet      one trace each, a file's name is its id
    rollouts.csv                             id,<param>,<param>,…[,seed]

A parameter's unit may follow its name in brackets, ``vd [m/s]``. Without a unit its values are in the unit of the
specification. The folder is checked when it is opened; an error names file and line.

Options for reading follow the folder's name: ``log:FOLDER?nan=hold&time-unit=ms&map=t=stamp&map=vx=v.x``.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
import re
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from s2r_spec import logs
from s2r_spec.backend import Backend, Channel, Parameter, Recording
from s2r_spec.errors import TraceError, TraceNote, UsageError, one_of, shortened
from s2r_spec.logs.interpret import Loaded
from s2r_spec.logs.table import regular
from s2r_spec.rollouts.log_options import LogOptions
from s2r_spec.spec import Spec
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


class LogBackend:
    """A backend that returns recorded rollouts; it runs nothing, and has only the recorded tests.

    Args:
        folder: folder with ``rollouts.csv`` and a trace for each of its rows; options may follow a ``?``.

    Raises:
        LogError: the table or a file is missing or wrong.
        TraceError: a file is not a trace.

    Attributes:
        recordings: all recordings, in the order of ``rollouts.csv``.
        lacking: channel that only some recordings have → why the backend leaves it out.
    """

    deterministic = True
    cost = 1e-4

    def __init__(self, folder: str = "") -> None:
        if not folder:
            raise UsageError("the log backend needs a folder: --backend log:FOLDER")
        options = LogOptions.parse("log", folder)
        root = options.folder
        units, rows = _table(root / TABLE)
        files = _files(root, rows)
        self.name = f"log:{folder}"
        loaded = _with_placeholders({row.id: options.load(files[row.id]) for row in rows})
        self.lacking = _lacking([(str(files[row.id]), loaded[row.id]) for row in rows])
        self.recordings = tuple(
            Recording(
                str(files[row.id]),
                row.params,
                options.fill_gaps(_without(loaded[row.id].trace, self.lacking)),
            )
            for row in rows
        )
        for note in _notes([(files[row.id], loaded[row.id]) for row in rows], self.lacking):
            warnings.warn(note, TraceNote, stacklevel=2)
        _refuse_copies(self.recordings)
        self.channels = _channels(self.recordings)
        self.parameters = tuple(
            Parameter(name, unit, min(values), max(values), values[0], "as recorded")
            for name, unit in units.items()
            for values in [[recording.params[name] for recording in self.recordings]]
        )
        self.duration = max(recording.trace.duration for recording in self.recordings)
        content = hashlib.sha256(options.text.encode())
        for path in (root / TABLE, *sorted(files.values())):
            content.update(f"{path.name}\0{path.stat().st_size}\0".encode() + path.read_bytes())
        self.model_hash = content.hexdigest()

    def recorded(self) -> list[tuple[dict[str, float], Trace]]:
        """Return (parameters, trace) of every recording, in the order of ``rollouts.csv``."""
        return [(dict(recording.params), recording.trace) for recording in self.recordings]

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Return a recording at these parameters; the seed selects one of several.

        Raises:
            UsageError: there is no recording at these parameters.
        """
        candidates = [
            r for r in self.recordings if all(_same(r.params[name], params[name]) for name in params)
        ]
        if not candidates:
            tests = sorted({tuple(recording.params.items()) for recording in self.recordings})
            shown = "; ".join(_words(dict(test)) for test in tests[:5])
            more = f" and {len(tests) - 5} more" if len(tests) > 5 else ""
            raise UsageError(f"{self.name} has no recording at {_words(params)}; it has {shown}{more}")
        return candidates[seed % len(candidates)].trace


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


def _is_placeholder(trace: Trace) -> bool:
    return trace.failure is not None and digest(trace) is None


def _lacking(loaded: Sequence[tuple[str, Loaded]]) -> dict[str, str]:
    """Return channel → reason for each channel that not all files have; the reason names one file.

    Raises:
        LogError: no channel remains.
    """
    first_with: dict[str, str] = {}
    reasons: dict[str, str] = {}
    for source, one in loaded:
        for name in one.trace.channels:
            first_with.setdefault(name, source)
        for name, reason in one.left_out.items():
            reasons.setdefault(name, f"{source}: {reason}")
    by_source = {source: one.trace for source, one in loaded}
    for name, other in first_with.items():
        for source, one in loaded:
            difference = _difference(name, one.trace, by_source[other], other)
            if difference:
                reasons.setdefault(name, source + difference)
    if reasons and not set(first_with) - set(reasons):
        raise LogError(next(iter(reasons.values())))
    return reasons


def _difference(name: str, trace: Trace, first: Trace, other: str) -> str:
    """Return how a channel differs from its first trace, as text after a file's name; "" if it does not."""
    if name not in trace.channels:
        return f" lacks the channel {name!r}, which {other} has"
    if trace[name].shape[1:] != first[name].shape[1:]:
        return f": the channel {name!r} has a different width from {other}"
    unit, other_unit = trace.units.get(name), first.units.get(name)
    if unit != other_unit:
        here, there = (f"has the unit {each}" if each else "has no unit" for each in (unit, other_unit))
        return (
            f", line 1: the channel {name!r} {here}, but {there} in {other}; "
            f"write a header such as {name} [{unit or other_unit}]"
        )
    return ""


def _without(trace: Trace, names: Collection[str]) -> Trace:
    return trace.only(name for name in trace.channels if name not in names)


def _notes(loaded: Sequence[tuple[Path, Loaded]], lacking: Mapping[str, str]) -> list[str]:
    """Return a note for each channel left out, and one for each kind of the files' notes, with the first file."""
    sentences = [f"the channel {name!r} is left out: {reason}" for name, reason in lacking.items()]
    kinds: dict[str, list[str]] = {}
    for path, note in ((path, note) for path, one in loaded for note in one.notes):
        kinds.setdefault(re.sub(r"\d+", "", note), []).append(f"{path}: {note}")
    for notes in kinds.values():
        sentences.append(notes[0] if len(notes) == 1 else f"{notes[0]}; likewise in {len(notes)} files")
    return sentences


def refuse_hidden(
    spec: Spec, backend: Backend, used: Sequence[Recording], among: Collection[str] | None = None
) -> None:
    """Refuse recordings in which an undeclared parameter varies: its effect would count as noise.

    Args:
        spec: the specification, with its parameters.
        backend: the backend with the recordings.
        used: the recordings to check.
        among: names of the parameters to check; None for all.

    Raises:
        UsageError: a parameter varies that the spec does not declare.
    """
    for parameter in backend.parameters:
        values = {recording.params[parameter.name] for recording in used}
        matters = among is None or parameter.name in among
        if matters and parameter.name not in spec.params and len(values) > 1:
            raise UsageError(
                f"{backend.name} varies {parameter.name!r} from {min(values):g} to {max(values):g} "
                f"{parameter.unit}".rstrip()
                + f", and {spec.name} does not declare it: declare a range to sweep, or one value"
            )


def _words(params: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in params.items())


def _same(left: float, right: float) -> bool:
    """Return whether two numbers are equal up to the rounding of a conversion of units."""
    return math.isclose(left, right, rel_tol=1e-9, abs_tol=1e-12)


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


def _refuse_copies(recordings: Sequence[Recording]) -> None:
    """Refuse two copies of one recording: a certificate may count it only once."""
    sources: dict[bytes, str] = {}
    for recording in recordings:
        key = digest(recording.trace)
        original = recording.source if key is None else sources.setdefault(key, recording.source)
        if original != recording.source:
            raise LogError(
                f"{recording.source} is the same recording as {original}, sample for sample; remove one of them"
            )


def _channels(recordings: Sequence[Recording]) -> tuple[Channel, ...]:
    """Return the channels of the first trace; every other trace has the same ones."""
    first = recordings[0].trace
    return tuple(
        Channel(name, first.units.get(name, ""), "as recorded", math.prod(values.shape[1:]))
        for name, values in first.channels.items()
    )
