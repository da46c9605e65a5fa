"""Columns and parameters of recorded traces, for the commands that evaluate them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from s2r_spec.cli.common import note
from s2r_spec.errors import TraceError, UsageError, one_of, shortened
from s2r_spec.printable import one_line

if TYPE_CHECKING:
    from s2r_spec.logs.account import Account
    from s2r_spec.robustness.reading import Missing
    from s2r_spec.rollouts.excerpts import Excerpts
    from s2r_spec.spec import Spec
    from s2r_spec.trace import Trace


@dataclass(frozen=True)
class Request:
    """The requirements to evaluate on recorded traces, and how the traces are read.

    Args:
        spec: the specification.
        requirements: names of the requirements to evaluate.
        params: parameter → value from the command line, in the declared unit.
        excerpts: how the files become traces.
        nan: "error" or "hold", for missing samples.
    """

    spec: Spec
    requirements: tuple[str, ...]
    params: dict[str, float]
    excerpts: Excerpts
    nan: Missing

    @property
    def wanted(self) -> dict[str, int | None]:
        """Signal → number of components of a vector, None for a scalar."""
        names = {name: None for one in self.requirements for name in self.spec.channels(one)}
        signals = [self.spec.signals[name] for name in names]
        return {signal.name: signal.dim if signal.vector else None for signal in signals}


@dataclass(frozen=True)
class Recorded:
    """A trace with the parameters of its test.

    Args:
        name: the file, with the number of the episode if it was cut.
        trace: the trace.
        params: parameter of the spec → value: from the command line, else from the trace.
        taken: names of the parameters whose values come from the trace.
        notes: sentences on what was left out of the file, and on the date from which its times count.
        accounts: signal → what became of its messages in the file.
        stated: whether the file or the user states the unit of the times.
    """

    name: str
    trace: Trace
    params: dict[str, float]
    taken: frozenset[str]
    notes: tuple[str, ...]
    accounts: Mapping[str, Account]
    stated: bool


def read(request: Request, path: Path) -> list[Recorded]:
    """Return the traces of a file; print a note on stderr for each thing left out.

    Raises:
        TraceError: the file cannot be read; the message names it.
    """
    from s2r_spec.rollouts.excerpts import assumed, excerpt

    if unknown := sorted(set(request.excerpts.longest) - set(request.spec.signals)):
        known = one_of(request.spec.signals)
        raise UsageError(f"--longest names {unknown[0]!r}, which is no signal; the signals are {known}")
    horizon = max(request.spec.horizon(name) for name in request.requirements)
    found = excerpt(path, request.spec.signals, request.wanted, horizon, request.excerpts)
    notes = list(found.notes)
    for name, (_, unit) in found.episodes[0].values.items():
        if name in request.spec.params and not unit:
            source = request.excerpts.sources[name]
            remedy = f"--param '{name}={source.column} [UNIT]@{source.at:g}'"
            notes += filter(None, [assumed(source.column, request.spec.params[name].unit, remedy)])
    if found.dated:
        notes.append(f"times count from the first sample, at {found.dated}")
    for sentence in notes:
        note(f"{path}: {sentence}")
    recorded = []
    for episode in found.episodes:
        with named(path):
            read = request.spec.read_params(episode.texts())
            params, taken = parameters(request, episode.trace.meta, episode.name, read)
        accounts = {name: one for name, one in found.accounts.items() if name in request.wanted}
        recorded.append(
            Recorded(episode.name, episode.trace, params, taken, tuple(notes), accounts, found.stated)
        )
    return recorded


def parameters(
    request: Request, meta: Mapping[str, Any], source: str, read: Mapping[str, float] | None = None
) -> tuple[dict[str, float], frozenset[str]]:
    """Return parameter → value, and the names of the parameters whose values come from the trace.

    A value of the command line goes before the trace's; if they differ, a note is printed.

    Raises:
        TraceError: the trace's value of a parameter is not a number.
    """
    recorded = meta.get("params", {})
    if not isinstance(recorded, Mapping):
        raise TraceError('its meta "params" must map names of parameters to numbers')
    found = {name: _number(name, recorded[name]) for name in request.spec.params if name in recorded}
    found |= read or {}
    for name, value in request.params.items():
        if name in found and not math.isclose(value, found[name], rel_tol=1e-9, abs_tol=1e-12):
            note(
                f"{source} was recorded with {name} = {found[name]:g}; it is evaluated with {value:g}, as given"
            )
    return found | request.params, frozenset(found) - frozenset(request.params)


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise TraceError(f"its parameter {name} = {shortened(repr(value))} is not a finite number")
    return float(value)


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Add the file's name to every UsageError that does not have it."""
    try:
        yield
    except UsageError as error:
        if one_line(path) in str(error):
            raise
        raise type(error)(f"{path}: {error}") from None
