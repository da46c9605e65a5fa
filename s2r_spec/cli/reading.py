"""What the commands that evaluate recorded traces share: which columns they read, and at which parameters."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from s2r_spec.cli.common import note
from s2r_spec.errors import TraceError, UsageError, shortened
from s2r_spec.printable import one_line

if TYPE_CHECKING:
    from s2r_spec.robustness.reading import Missing
    from s2r_spec.spec import Spec
    from s2r_spec.trace import Trace


@dataclass(frozen=True)
class Asked:
    """What is asked of recorded traces, and how they are read.

    Args:
        spec: the specification.
        requirements: those of it to evaluate.
        params: parameter → value, of those that are given.
        columns: signal or ``t`` → what the files call it.
        time_unit: of times that are plain numbers; None if not stated.
        nan: what a missing sample means.
    """

    spec: Spec
    requirements: tuple[str, ...]
    params: dict[str, float]
    columns: dict[str, str]
    time_unit: str | None
    nan: Missing

    @property
    def wanted(self) -> dict[str, int | None]:
        """Signal → None for a number a sample, the number of components of a vector."""
        names = {name: None for one in self.requirements for name in self.spec.channels(one)}
        signals = [self.spec.signals[name] for name in names]
        return {signal.name: signal.dim if signal.vector else None for signal in signals}


@dataclass(frozen=True)
class Recorded:
    """A trace with the parameters of its test.

    Args:
        trace: as read.
        params: parameter → value: as given, else as the trace says, where the spec has it.
        taken: names of those that the trace says.
        notes: what was left out of the file, and from which date its times count, in sentences.
    """

    trace: Trace
    params: dict[str, float]
    taken: frozenset[str]
    notes: tuple[str, ...]


def read(asked: Asked, path: Path) -> Recorded:
    """Return what a file holds of what is asked; say on stderr what was left out.

    Raises:
        TraceError: it cannot be read; the message names it.
    """
    from s2r_spec.logs import load

    found = load(path, asked.columns, asked.wanted, time_unit=asked.time_unit)
    notes = list(found.notes)
    if found.begins:
        notes.append(f"times count from the first sample, {found.begins}")
    for sentence in notes:
        note(f"{path}: {sentence}")
    with named(path):
        params, taken = parameters(asked, found.trace.meta, str(path))
    return Recorded(found.trace, params, taken, tuple(notes))


def parameters(asked: Asked, meta: Mapping[str, Any], source: str) -> tuple[dict[str, float], frozenset[str]]:
    """Return parameter → value, and the names of those that the trace itself says.

    A given value is used even where the trace says another one, and that is a note.

    Raises:
        TraceError: what the trace says of a parameter is no number.
    """
    recorded = meta.get("params", {})
    if not isinstance(recorded, Mapping):
        raise TraceError('its meta "params" must map names of parameters to numbers')
    found = {name: _number(name, recorded[name]) for name in asked.spec.params if name in recorded}
    for name, value in asked.params.items():
        if name in found and not math.isclose(value, found[name], rel_tol=1e-9, abs_tol=1e-12):
            note(
                f"{source} was recorded with {name} = {found[name]:g}; it is evaluated with {value:g}, as given"
            )
    return found | asked.params, frozenset(found) - frozenset(asked.params)


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise TraceError(f"it says that {name} = {shortened(repr(value))}, which is no finite number")
    return float(value)


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Name the file in every error of the user's that has not named it."""
    try:
        yield
    except UsageError as error:
        if one_line(path) in str(error):
            raise
        raise type(error)(f"{path}: {error}") from None
