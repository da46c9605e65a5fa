"""A check on recordings: the tests were fixed before, so the search is told them and asks for none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from s2r_spec.backend import Backend, Recording
from s2r_spec.certify.drive import Observer
from s2r_spec.certify.search import Search
from s2r_spec.errors import TraceError, UsageError
from s2r_spec.rollouts.journal import Journal, Record
from s2r_spec.rollouts.match import Matched, match
from s2r_spec.rollouts.rig import Rig
from s2r_spec.rollouts.runner import Done
from s2r_spec.spec import Spec

# A conversion of units may put the end of a range this share of its width outside of it.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Design:
    """Recordings as tests of a spec.

    Attributes:
        tests: (test point in the spec's units, its recordings), in recorded order.
        notes: what a reader of the certificate must know, each in one sentence.
    """

    tests: tuple[tuple[dict[str, float], tuple[Recording, ...]], ...]
    notes: tuple[str, ...]


def fixed_design(spec: Spec, requirement: str, backend: Backend, recordings: Sequence[Recording]) -> Design:
    """Group the recordings inside the spec's test space by test; which are used depends on no outcome.

    Raises:
        UsageError: none is inside, or a parameter varies that the spec does not declare.
    """
    matched = match(spec, requirement, backend)
    groups: dict[tuple[float, ...], tuple[dict[str, float], list[Recording]]] = {}
    outside = []
    for recording in recordings:
        point = _point(spec, matched, recording)
        if point is None:
            outside.append(recording.source)
        else:
            groups.setdefault(tuple(point.values()), (point, []))[1].append(recording)
    if not groups:
        raise UsageError(
            f"none of the {len(recordings)} recordings of {backend.name} lies in the test space of {spec.name}: "
            + ", ".join(
                f"{axis.name} in [{axis.low:g}, {axis.high:g}] {axis.unit}" for axis in spec.space.axes
            )
        )
    tests = tuple((point, tuple(group)) for point, group in groups.values())
    _refuse_hidden(spec, backend, [recording for _, group in tests for recording in group])
    notes = []
    if outside:
        notes.append(
            f"{len(outside)} of {len(recordings)} recordings are of tests outside the spec's test space and are "
            f"not used ({', '.join(outside[:3])}{', …' if len(outside) > 3 else ''})"
        )
    if all(len(group) == 1 for _, group in tests):
        notes.append("no test was recorded twice, so that nothing here could have refuted R")
    units = {channel.name: channel.unit for channel in backend.channels}
    notes += [
        f"the channel {name!r} of {recordings[0].source} has no unit; its numbers are read as {unit}"
        for name in matched.channels
        if (unit := spec.signals[name].unit) and not units[name]
    ]
    return Design(tests, tuple(notes))


def observe(
    search: Search, design: Design, rig: Rig, journal: Journal, observer: Observer | None = None
) -> None:
    """Judge every recording, put ρ into the journal, and tell the search −ρ of all of them at once.

    Raises:
        TraceError: a recording cannot be judged; the message names its file.
    """
    outcomes = []
    for index, (point, recordings) in enumerate(design.tests):
        records = []
        for replicate, recording in enumerate(recordings):
            # The seed is what makes the backend give this recording again.
            task = rig.task(index, replicate, point, seed=replicate)
            try:
                rho, failure = rig.score(point, Done(task, recording.trace, 0.0))
            except TraceError as error:
                raise TraceError(f"{recording.source}: {error}") from None
            record = Record(index, replicate, point, replicate, rho, failure, trace=None, seconds=0.0)
            records.append(journal.get(index, replicate) or journal.append(record, None))
            if observer is not None:
                observer.rollout(records[-1])
        outcomes.append((point, [-record.rho for record in records]))
    search.observe(outcomes, final=True)


def _point(spec: Spec, matched: Matched, recording: Recording) -> dict[str, float] | None:
    """Return the test point of a recording, or None if it is outside the spec's test space."""
    found = matched.to_spec(recording.params)
    if found is None:
        return None
    point = {}
    for axis in spec.space.axes:
        value = found[axis.name]
        point[axis.name] = min(max(value, axis.low), axis.high)
        if abs(point[axis.name] - value) > ROUNDING * axis.width:
            return None
    return point


def _refuse_hidden(spec: Spec, backend: Backend, used: Sequence[Recording]) -> None:
    """Refuse a mixture: what varied without being declared would be hidden in the noise."""
    for parameter in backend.parameters:
        values = {recording.params[parameter.name] for recording in used}
        if parameter.name not in spec.params and len(values) > 1:
            raise UsageError(
                f"{backend.name} varies {parameter.name!r} from {min(values):g} to {max(values):g} "
                f"{parameter.unit}".rstrip()
                + f", which {spec.name} does not declare: give it a range to sweep, or a value to keep to"
            )
