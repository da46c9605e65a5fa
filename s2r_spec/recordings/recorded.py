"""The ``log`` backend: a folder of recorded rollouts.

    run-a.npz  run-b.csv  run-c.mcap      a trace each, or several episodes; a file's name is its id
    rollouts.csv                          id,[protocol,]<param>,<param>,…[,seed]

The column ``protocol`` is empty for a test of a specification, and names the protocol of another run. A parameter's
unit may follow its name in brackets, ``vd [m/s]``. Without a unit its values are in the unit of the specification. The
table may be missing if the logs themselves hold the parameters. The folder is checked when it is opened; an error
names file and line.

Options for reading follow the folder's name: ``log:FOLDER?nan=hold&map=vx=v.x&when=go&param=vd=v_cmd@0``.
"""

from __future__ import annotations

import hashlib
import math
import re
import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

from s2r_spec.backend import Backend, Channel, Parameter, Recording
from s2r_spec.base.errors import TraceNote, UsageError
from s2r_spec.recordings.log_folder import Entry, LogError, digest, read
from s2r_spec.recordings.log_options import LogOptions
from s2r_spec.recordings.reading_rule import READING
from s2r_spec.robustness.grid import sent_on_change
from s2r_spec.spec import Spec
from s2r_spec.spec.monitored import refuse_unstated
from s2r_spec.trace import Trace

_BLOCK = 2**20
"""Budget: bytes of a file that are read at a time for its hash."""


class LogBackend:
    """A backend that returns recorded rollouts; it runs nothing, and has only the recorded tests.

    Channels, parameters and duration are those of the tests. Runs of protocols keep channels of their own.

    Args:
        folder: folder with ``rollouts.csv`` and a trace for each of its rows; options may follow a ``?``.

    Raises:
        LogError: the table or a file is missing or wrong.
        TraceError: a file is not a trace.

    Attributes:
        recordings: all recordings, in the order of ``rollouts.csv``.
        lacking: channel that only some recordings have → why the backend leaves it out.
        accounts: file → channel → what became of its messages (:class:`s2r_spec.logs.account.Account`).
        unstated: sources of the recordings whose times have no unit.
    """

    deterministic = True
    cost = 1e-4
    reading = READING

    def __init__(self, folder: str = "") -> None:
        if not folder:
            raise UsageError("the log backend needs a folder: --backend log:FOLDER")
        options = LogOptions.parse("log", folder)
        recorded = read(options)
        self.name = f"log:{folder}"
        tests = [entry for entry in recorded.entries if not entry.protocol]
        self.lacking = _lacking_channels(tests)
        self.recordings = tuple(
            Recording(
                entry.source, entry.params, options.fill_gaps(_own_trace(entry, self.lacking)), entry.protocol
            )
            for entry in recorded.entries
        )
        self._tests = tests_of(self.recordings)
        self.accounts = {
            entry.source.partition("#")[0]: dict(entry.loaded.accounts)
            for entry in recorded.entries
            if entry.loaded.accounts
        }
        self.unstated = frozenset(entry.source for entry in recorded.entries if not entry.loaded.stated)
        used = self._tests or self.recordings
        for note in _notes(recorded.entries, self.lacking):
            warnings.warn(note, TraceNote, stacklevel=2)
        _refuse_copies(self.recordings)
        first = used[0].trace  # every other trace has the same channels
        self.channels = tuple(
            Channel(name, first.units.get(name, ""), "as recorded", math.prod(values.shape[1:]))
            for name, values in first.channels.items()
        )
        self.assumptions = recorded.assumptions
        self.parameters = tuple(
            Parameter(name, unit, min(values), max(values), values[0], "as recorded")
            for name, unit in recorded.units.items()
            for values in [[r.params[name] for r in self._tests if name in r.params]]
            if values
        )
        # The last value of messages is valid up to the end of the recording.
        self.duration = max(recording.trace.ends - recording.trace.begin for recording in used)
        content = hashlib.sha256(f"reading {self.reading}\0{options.text}".encode())
        for path in recorded.files:
            content.update(f"{path.name}\0{path.stat().st_size}\0".encode())
            with path.open("rb") as stream:
                while block := stream.read(_BLOCK):
                    content.update(block)
        self.model_hash = content.hexdigest()

    def recorded(self) -> list[tuple[dict[str, float], Trace]]:
        """Return (parameters, trace) of every recorded test, in the order of ``rollouts.csv``."""
        return [(dict(recording.params), recording.trace) for recording in self._tests]

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Return a recording at these parameters; the seed selects one of several.

        Raises:
            UsageError: there is no recording at these parameters.
        """
        # equal up to the rounding of a conversion of units
        candidates = [
            one
            for one in self._tests
            if all(
                name in one.params and math.isclose(one.params[name], value, rel_tol=1e-9, abs_tol=1e-12)
                for name, value in params.items()
            )
        ]
        if not candidates:
            tests = sorted({tuple(recording.params.items()) for recording in self._tests})
            shown = "; ".join(_words(dict(test)) for test in tests[:5])
            more = f" and {len(tests) - 5} more" if len(tests) > 5 else ""
            raise UsageError(f"{self.name} has no recording at {_words(params)}; it has {shown}{more}")
        return candidates[seed % len(candidates)].trace


def tests_of(recordings: Iterable[Recording]) -> tuple[Recording, ...]:
    """Return the recordings that are tests of a specification, without the runs of protocols."""
    return tuple(recording for recording in recordings if not recording.protocol)


def omission_note(recordings: Sequence[Recording]) -> str:
    """Return a sentence on the runs of protocols that a statement leaves out; "" if there are none."""
    count = len(recordings) - len(tests_of(recordings))
    if count < 2:
        return "1 rollout of a protocol was left out" * count
    return f"{count} rollouts of protocols were left out"


def _own_trace(entry: Entry, lacking: Collection[str]) -> Trace:
    """Return the trace of an entry; of a test without the channels that other tests lack."""
    trace = entry.loaded.trace
    if not entry.protocol:
        trace = trace.only(name for name in trace.channels if name not in lacking)
    if trace.messages or trace.origin is not None or not sent_on_change(trace.times):
        return trace
    return replace(trace, origin=trace.as_messages())


def _lacking_channels(tests: Sequence[Entry]) -> dict[str, str]:
    """Return channel → reason for each channel that not all files have; the reason names one file."""
    first_with: dict[str, Entry] = {}
    reasons: dict[str, str] = {}
    for entry in tests:
        for name in entry.loaded.trace.channels:
            first_with.setdefault(name, entry)
        for name, reason in entry.loaded.left_out.items():
            reasons.setdefault(name, f"{entry.source}: {reason}")
    for name, first in first_with.items():
        for entry in tests:
            if difference := _difference(name, entry.loaded.trace, first.loaded.trace, first.source):
                reasons.setdefault(name, entry.source + difference)
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


def _notes(entries: Sequence[Entry], lacking: Mapping[str, str]) -> list[str]:
    """Return a note for each channel left out, and one for each kind of the files' notes, with the first file."""
    sentences = [f"the channel {name!r} is left out: {reason}" for name, reason in lacking.items()]
    kinds: dict[str, dict[str, str]] = {}
    for source, note in dict.fromkeys(
        (entry.source.partition("#")[0], note) for entry in entries for note in entry.loaded.notes
    ):
        kinds.setdefault(re.sub(r"\d+", "", note), {}).setdefault(source, f"{source}: {note}")
    for notes in kinds.values():
        first = next(iter(notes.values()))
        sentences.append(first if len(notes) == 1 else f"{first}; likewise in {len(notes)} files")
    return sentences


def refuse_hidden(
    spec: Spec, backend: Backend, used: Sequence[Recording], among: Collection[str] | None = None
) -> None:
    """Refuse recordings in which an undeclared parameter varies: its effect would count as noise.

    ``among`` are the names of the parameters to check; None for all.

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


def refuse_unstated_times(spec: Spec, requirement: str, backend: Backend, used: Iterable[Recording]) -> None:
    """Refuse recordings whose times have no unit, and look like none in seconds.

    Raises:
        UsageError: there is one; see :func:`s2r_spec.spec.monitored.refuse_unstated`.
    """
    unstated = getattr(backend, "unstated", ())
    for recording in used:
        if recording.source in unstated:
            try:
                refuse_unstated(spec, recording.trace, requirement)
            except UsageError as error:
                raise UsageError(f"{recording.source}: {error}") from None


def _words(params: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in params.items())


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
