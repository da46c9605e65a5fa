"""The ``log`` backend: a folder of recorded rollouts.

    run-a.npz  run-b.csv  run-c.parquet      one trace each, a file's name is its id
    rollouts.csv                             id,<param>,<param>,…[,seed]

A parameter's unit may follow its name in brackets, ``vd [m/s]``; without one its
numbers are in the unit of the specification. Mistakes are found when the folder
is opened, and each is one sentence with file and line.
"""

from __future__ import annotations

import csv
import hashlib
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from s2r_spec import logs
from s2r_spec.backend import Backend, Channel, Parameter, Recording
from s2r_spec.errors import UsageError, one_of
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

TABLE = "rollouts.csv"
_ID, _SEED = "id", "seed"
_COLUMN = re.compile(r"(?P<name>[^\[\]]+?)(?:\s*\[(?P<unit>[^\[\]]*)\])?")


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
        folder: with ``rollouts.csv`` and a trace for each of its rows.

    Raises:
        LogError: see there.
        TraceError: a file is no trace.

    Attributes:
        recordings: all of them, in the order of ``rollouts.csv``.
    """

    deterministic = True
    cost = 1e-4

    def __init__(self, folder: str = "") -> None:
        if not folder:
            raise UsageError("the log backend needs a folder: --backend log:FOLDER")
        root = Path(folder)
        units, rows = _table(root / TABLE)
        files = _files(root, rows)
        self.name = f"log:{folder}"
        self.recordings = tuple(
            Recording(str(files[row.id]), row.params, logs.read(files[row.id])) for row in rows
        )
        _refuse_copies(self.recordings)
        self.channels = _channels(self.recordings)
        self.parameters = tuple(
            Parameter(name, unit, min(values), max(values), values[0], "as recorded")
            for name, unit in units.items()
            for values in [[recording.params[name] for recording in self.recordings]]
        )
        self.duration = max(recording.trace.duration for recording in self.recordings)
        digest = hashlib.sha256()
        for path in (root / TABLE, *sorted(files.values())):
            digest.update(f"{path.name}\0{path.stat().st_size}\0".encode() + path.read_bytes())
        self.model_hash = digest.hexdigest()

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
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream, strict=True, skipinitialspace=True)
            lines = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if row]
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
        match = _COLUMN.fullmatch(text)
        if match is None or match["name"] in units or (place == 0) != (text == _ID):
            raise LogError(
                f"{path}, line {number}: the header is {','.join(header)!r}; "
                f"it must be 'id' and then one name a parameter, such as 'vd' or 'vd [m/s]'"
            )
        units[match["name"]] = match["unit"] or ""
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
        if path.suffix.lower() in logs.FORMATS and path.name != TABLE:
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


def _refuse_copies(recordings: Sequence[Recording]) -> None:
    """A certificate must never count one recording twice, under whatever name."""
    seen: dict[bytes, str] = {}
    for recording in recordings:
        digest = hashlib.sha256(recording.trace.times.tobytes())
        for name, values in sorted(recording.trace.channels.items()):
            digest.update(name.encode() + values.tobytes())
        before = seen.setdefault(digest.digest(), recording.source)
        if before != recording.source:
            raise LogError(
                f"{recording.source} is the same recording as {before}, sample for sample; it counts only once"
            )


def _channels(recordings: Sequence[Recording]) -> tuple[Channel, ...]:
    """Return the channels of the first trace, which every other one must have alike."""
    first = recordings[0]
    for recording in recordings[1:]:
        for name, values in first.trace.channels.items():
            if name not in recording.trace.channels:
                raise LogError(f"{recording.source} lacks the channel {name!r}, which {first.source} has")
            if recording.trace[name].shape[1:] != values.shape[1:]:
                raise LogError(f"{recording.source}: {name!r} has another width than in {first.source}")
            unit, other = recording.trace.units.get(name), first.trace.units.get(name)
            if unit != other:
                raise LogError(
                    f"{recording.source}, line 1: the channel {name!r} is in {unit or 'no unit'}, "
                    f"but in {other or 'no unit'} in {first.source}; write for example {name} [{unit or other}]"
                )
    return tuple(
        Channel(name, first.trace.units.get(name, ""), "as recorded", math.prod(values.shape[1:]))
        for name, values in first.trace.channels.items()
    )
