"""The ``log`` backend: a folder of recorded rollouts.

    run-a.npz  run-b.csv  run-c.parquet      one trace each, a file's name is its id
    rollouts.csv                             id,<param>,<param>,…[,seed]

A parameter's unit may follow its name in brackets, ``vd [m/s]``; without one its
numbers are in the unit of the specification. Mistakes are found when the folder
is opened, and each is one sentence with file and line.

How the traces are read follows the folder's name: ``log:FOLDER?nan=hold&time-unit=ms&map=t=stamp&map=vx=v.x``.
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
from s2r_spec.rollouts.reading import Reading
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

TABLE = "rollouts.csv"
_ID, _SEED = "id", "seed"
_LONGEST = 2**24
"""Budget: letters of the table, 16 million; twice as many take 0.3 GB more."""


class LogError(UsageError):
    """A folder of recorded rollouts cannot be used; the message names the file and the line."""


@dataclass(frozen=True)
class _Row:
    line: int
    id: str
    params: dict[str, float]


class LogBackend:
    """What a machine already did, as a backend: it runs nothing, and knows only the tests that were recorded.

    Args:
        folder: with ``rollouts.csv`` and a trace for each of its rows; after a ``?`` how they are read.

    Raises:
        LogError: see there.
        TraceError: a file is no trace.

    Attributes:
        recordings: all of them, in the order of ``rollouts.csv``.
        lacking: channel that some recordings have → why it is no channel of the backend.
    """

    deterministic = True
    cost = 1e-4

    def __init__(self, folder: str = "") -> None:
        if not folder:
            raise UsageError("the log backend needs a folder: --backend log:FOLDER")
        reading = Reading.of("log", folder)
        root = reading.folder
        units, rows = _table(root / TABLE)
        files = _files(root, rows)
        self.name = f"log:{folder}"
        loaded = _completed({row.id: reading.load(files[row.id]) for row in rows})
        self.lacking = _lacking([(str(files[row.id]), loaded[row.id]) for row in rows])
        self.recordings = tuple(
            Recording(
                str(files[row.id]), row.params, reading.held(_without(loaded[row.id].trace, self.lacking))
            )
            for row in rows
        )
        for sentence in _notes([(files[row.id], loaded[row.id]) for row in rows], self.lacking):
            warnings.warn(sentence, TraceNote, stacklevel=2)
        _refuse_copies(self.recordings)
        self.channels = _channels(self.recordings)
        self.parameters = tuple(
            Parameter(name, unit, min(values), max(values), values[0], "as recorded")
            for name, unit in units.items()
            for values in [[recording.params[name] for recording in self.recordings]]
        )
        self.duration = max(recording.trace.duration for recording in self.recordings)
        content = hashlib.sha256(reading.words.encode())
        for path in (root / TABLE, *sorted(files.values())):
            content.update(f"{path.name}\0{path.stat().st_size}\0".encode() + path.read_bytes())
        self.model_hash = content.hexdigest()

    def recorded(self) -> list[tuple[dict[str, float], Trace]]:
        """Return (parameters, trace) of every recording, in the order of ``rollouts.csv``."""
        return [(dict(recording.params), recording.trace) for recording in self.recordings]

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Return a recording made at these parameters; the seed only says which, where there are several.

        Raises:
            UsageError: nothing was recorded there.
        """
        fitting = [r for r in self.recordings if all(_same(r.params[name], params[name]) for name in params)]
        if not fitting:
            tests = sorted({tuple(recording.params.items()) for recording in self.recordings})
            shown = "; ".join(_words(dict(test)) for test in tests[:5])
            more = f" and {len(tests) - 5} more" if len(tests) > 5 else ""
            raise UsageError(f"{self.name} has no recording at {_words(params)}; it has {shown}{more}")
        return fitting[seed % len(fitting)].trace


def _completed(loaded: Mapping[str, Loaded]) -> dict[str, Loaded]:
    """Return what was read, with what stands for a failed rollout without a log like the first recording.

    It has no number, so that no channel is left out because it lacks it.
    """
    first = next((one.trace for one in loaded.values() if not _stands_in(one.trace)), None)
    if first is None:
        return dict(loaded)
    found = {}
    for name, one in loaded.items():
        if _stands_in(one.trace):
            count = len(one.trace)
            nothing = {key: np.full((count, *v.shape[1:]), np.nan) for key, v in first.channels.items()}
            one = replace(
                one, trace=Trace(one.trace.times, nothing, first.units, one.trace.meta), left_out={}
            )
        found[name] = one
    return found


def _stands_in(trace: Trace) -> bool:
    return trace.failure is not None and digest(trace) is None


def _lacking(loaded: Sequence[tuple[str, Loaded]]) -> dict[str, str]:
    """Return the channels that some files have and others do not, each with a sentence that names one.

    Raises:
        LogError: no channel is left.
    """
    having: dict[str, str] = {}
    found: dict[str, str] = {}
    for source, one in loaded:
        for name in one.trace.channels:
            having.setdefault(name, source)
        for name, why in one.left_out.items():
            found.setdefault(name, f"{source}: {why}")
    by_source = {source: one.trace for source, one in loaded}
    for name, other in having.items():
        for source, one in loaded:
            wrong = _unlike(name, one.trace, by_source[other], other)
            if wrong:
                found.setdefault(name, source + wrong)
    if found and not set(having) - set(found):
        raise LogError(next(iter(found.values())))
    return found


def _unlike(name: str, trace: Trace, first: Trace, other: str) -> str:
    """Return why a trace's channel is not that of the first trace with it, after the file's name; "" if it is."""
    if name not in trace.channels:
        return f" lacks the channel {name!r}, which {other} has"
    if trace[name].shape[1:] != first[name].shape[1:]:
        return f": {name!r} has another width than in {other}"
    unit, before = trace.units.get(name), first.units.get(name)
    if unit != before:
        return (
            f", line 1: the channel {name!r} is in {unit or 'no unit'}, "
            f"but in {before or 'no unit'} in {other}; write for example {name} [{unit or before}]"
        )
    return ""


def _without(trace: Trace, names: Collection[str]) -> Trace:
    return trace.only(name for name in trace.channels if name not in names)


def _notes(loaded: Sequence[tuple[Path, Loaded]], lacking: Mapping[str, str]) -> list[str]:
    """Return what was left out, a sentence for each kind of it with the first file where it was."""
    found = [f"the channel {name!r} is left out: {why}" for name, why in lacking.items()]
    kinds: dict[str, list[str]] = {}
    for path, note in ((path, note) for path, one in loaded for note in one.notes):
        kinds.setdefault(re.sub(r"\d+", "", note), []).append(f"{path}: {note}")
    for notes in kinds.values():
        found.append(notes[0] if len(notes) == 1 else f"{notes[0]}; so in {len(notes)} files")
    return found


def refuse_hidden(
    spec: Spec, backend: Backend, used: Sequence[Recording], among: Collection[str] | None = None
) -> None:
    """Refuse a mixture: what varied without being declared would be hidden in the noise.

    Args:
        spec: that declares parameters.
        backend: with the recordings.
        used: of these.
        among: names that matter; all if None.

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
                + f", which {spec.name} does not declare: give it a range to sweep, or a value to keep to"
            )


def _words(params: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in params.items())


def _same(left: float, right: float) -> bool:
    """Whether two numbers are one, up to the rounding of a conversion of units."""
    return math.isclose(left, right, rel_tol=1e-9, abs_tol=1e-12)


def _table(path: Path) -> tuple[dict[str, str], list[_Row]]:
    """Return parameter → unit ("" if none is written), and the rows."""
    if not path.parent.is_dir():
        raise LogError(f"there is no folder {path.parent}; log:FOLDER is one with recordings and {TABLE}")
    try:
        if path.exists():
            regular(path)
        with path.open(newline="", encoding="utf-8-sig") as stream:
            text = stream.read(_LONGEST)
        if len(text) == _LONGEST:
            raise LogError(f"{path}: it is longer than {_LONGEST:,} letters, too long for a row a recording")
        reader = csv.reader(io.StringIO(text, newline=""), strict=True, skipinitialspace=True)
        lines = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(row)]
    except TraceError as error:
        raise LogError(f"{path}: {error}") from None
    except OSError as error:
        raise LogError(
            f"cannot read {path}: {error.strerror or error}; it says what each recording was a test of: "
            f"a header id,<parameter>,… and a row for each"
        ) from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise LogError(f"{path}: this is not comma-separated UTF-8 text: {error}") from None
    if len(lines) < 2:
        raise LogError(f"{path}: there is no recording in it; it needs a header id,<parameter>,… and rows")
    (number, header), *body = lines
    units: dict[str, str] = {}
    for place, text in enumerate(header):
        name, unit = _parameter(text)
        if not name or name in units or (place == 0) != (text == _ID):
            raise LogError(
                f"{path}, line {number}: the header is {shortened(','.join(header))!r}; "
                f"it must be 'id' and then one name a parameter, such as 'vd' or 'vd [m/s]'"
            )
        units[name] = unit
    names = list(units)
    rows: dict[str, _Row] = {}
    for line, cells in body:
        if len(cells) != len(names):
            raise LogError(f"{path}, line {line}: {len(cells)} values, but there are {len(names)} columns")
        name = cells[0]
        if name in rows:
            raise LogError(f"{path}, line {line}: {name!r} is in line {rows[name].line} already")
        params = {key: _number(path, line, key, text) for key, text in zip(names[1:], cells[1:], strict=True)}
        params.pop(_SEED, None)
        rows[name] = _Row(line, name, params)
    return {name: unit for name, unit in units.items() if name not in (_ID, _SEED)}, list(rows.values())


def _parameter(text: str) -> tuple[str, str]:
    """Return name and unit, "" if none, of a cell such as "vd [m/s]"; no name if it has another form."""
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
    """Return id → file; each row has one, and each file its row."""
    found: dict[str, list[Path]] = {}
    for path in sorted(root.iterdir()):
        # A hidden file is one that somebody is writing, or was when the machine went down.
        if path.suffix.lower() in logs.FORMATS and path.name != TABLE and not path.name.startswith("."):
            found.setdefault(path.stem, []).append(path)
    for row in rows:
        paths = found.get(row.id, [])
        if len(paths) != 1:
            endings = ", ".join(f"{row.id}{ending}" for ending in logs.FORMATS)
            what = f"has no file; there must be one of {endings}" if not paths else (
                f"has several files: {one_of(path.name for path in paths)}"
            )  # fmt: skip
            raise LogError(f"{root / TABLE}, line {row.line}: {row.id!r} {what}")
    for name in found.keys() - {row.id for row in rows}:
        raise LogError(
            f"{found[name][0]} has no row in {TABLE}; to leave out a recording is selection: say what it was a test of"
        )
    return {row.id: found[row.id][0] for row in rows}


def digest(trace: Trace) -> bytes | None:
    """Return what two recordings share if they are one, sample for sample; None of one without a single number.

    A rollout that failed may have no log: what stands for it has no number, and is a copy of nothing.
    """
    if not any(np.isfinite(values).any() for values in trace.channels.values()):
        return None
    found = hashlib.sha256(trace.times.tobytes())
    for name, values in sorted(trace.channels.items()):
        # One NaN has many forms, and a file need not keep which it was.
        found.update(name.encode() + np.where(np.isnan(values), np.nan, values).tobytes())
    return found.digest()


def _refuse_copies(recordings: Sequence[Recording]) -> None:
    """A certificate must never count one recording twice, under whatever name."""
    seen: dict[bytes, str] = {}
    for recording in recordings:
        found = digest(recording.trace)
        before = recording.source if found is None else seen.setdefault(found, recording.source)
        if before != recording.source:
            raise LogError(
                f"{recording.source} is the same recording as {before}, sample for sample; it counts only once"
            )


def _channels(recordings: Sequence[Recording]) -> tuple[Channel, ...]:
    """Return the channels of the first trace, which every other one has alike."""
    first = recordings[0].trace
    return tuple(
        Channel(name, first.units.get(name, ""), "as recorded", math.prod(values.shape[1:]))
        for name, values in first.channels.items()
    )
