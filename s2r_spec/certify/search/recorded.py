"""Searches on recordings: the tests are a fixed design, and the search asks for none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from s2r_spec.backend import Backend, Recording
from s2r_spec.base.errors import TraceError, UsageError
from s2r_spec.certify.bound.rounding import width_text
from s2r_spec.certify.search.experiments import OutcomeSource
from s2r_spec.certify.search.observers import Observer
from s2r_spec.certify.search.search import Query, Search
from s2r_spec.recordings.recorded import omission_note, refuse_hidden, refuse_unstated_times, tests_of
from s2r_spec.runs.compatibility import Interface, check_compatibility
from s2r_spec.runs.journal import Journal, Record
from s2r_spec.runs.scorer import Scorer
from s2r_spec.runs.task import Done
from s2r_spec.spec import Spec

ROUNDING = 1e-9
"""Tolerance: share of a range by which a value may lie outside it after its unit was converted."""
FINE = {1: 501, 2: 41, 3: 15}
"""Budget: points for each parameter at which the band is compared with ε, by the number of parameters."""


@dataclass(frozen=True)
class Design:
    """Recordings as tests of a spec: (test point in the spec's units, its recordings), in recorded order.

    The notes are facts that a reader of the certificate must know, each in one sentence.
    """

    tests: tuple[tuple[dict[str, float], tuple[Recording, ...]], ...]
    notes: tuple[str, ...]

    @property
    def queries(self) -> list[Query]:
        """The tests as queries: one outcome for each recording."""
        return [Query(index, point, len(group)) for index, (point, group) in enumerate(self.tests)]


def fixed_design(spec: Spec, requirement: str, backend: Backend, recordings: Sequence[Recording]) -> Design:
    """Group the recordings inside the spec's test space by test; the choice does not depend on any outcome.

    Runs of protocols are left out, and a note counts them.

    Raises:
        UsageError: none is inside, or a parameter varies that the spec does not declare.
    """
    tests = tests_of(recordings)
    matched = check_compatibility(spec, requirement, backend)
    groups: dict[tuple[float, ...], tuple[dict[str, float], list[Recording]]] = {}
    outside = []
    for recording in tests:
        point = _point(spec, matched, recording)
        if point is None:
            outside.append(recording.source)
        else:
            groups.setdefault(tuple(point.values()), (point, []))[1].append(recording)
    if not groups:
        raise UsageError(
            f"none of the {len(tests)} recordings of {backend.name} lies in the test space of {spec.name}: "
            + ", ".join(
                f"{axis.name} in [{axis.low:g}, {axis.high:g}] {axis.unit}" for axis in spec.space.axes
            )
        )
    grouped = tuple((point, tuple(group)) for point, group in groups.values())
    used = [recording for _, group in grouped for recording in group]
    refuse_hidden(spec, backend, used)
    refuse_unstated_times(spec, requirement, backend, used)
    notes = [sentence] if (sentence := omission_note(recordings)) else []
    if outside:
        notes.append(
            f"{len(outside)} of {len(tests)} recordings have tests outside the spec's test space and are "
            f"not used ({', '.join(outside[:3])}{', …' if len(outside) > 3 else ''})"
        )
    units = {channel.name: channel.unit for channel in backend.channels}
    notes += [
        f"the channel {name!r} of {tests[0].source} has no unit; its numbers are read as {unit}"
        for name in matched.channels
        if (unit := spec.signals[name].unit) and not units[name]
    ]
    return Design(grouped, tuple(notes))


@dataclass(frozen=True)
class RecordedExperiment:
    """An experiment with recorded outcomes: test *i* of the design answers query *i*.

    Each outcome is the mean of ``each`` recordings; the last one may be of fewer.
    """

    design: Design
    scorer: Scorer
    journal: Journal
    each: int = 1

    def outcomes(self, queries: Sequence[Query], observer: Observer) -> dict[int, list[float]]:
        """Evaluate the recordings; a TraceError names the file of one that cannot be evaluated."""
        return {query.index: self._outcomes(query, observer) for query in queries}

    def on_disk(self, index: int, replicates: int) -> bool:
        """Return whether there is such a test: recordings need no rollout."""
        return index < len(self.design.tests)

    def _outcomes(self, query: Query, observer: Observer) -> list[float]:
        point, recordings = self.design.tests[query.index]
        groups: list[list[float]] = [[] for _ in range(query.replicates)]
        for number, recording in enumerate(recordings):
            # One for each replicate first, so that none is left without.
            place, replicate = divmod(number, query.replicates)
            key = query.index, replicate * self.each + place
            # With its number as the seed the backend returns this recording again.
            task = self.scorer.task(*key, point, seed=number)
            try:
                rho, failure = self.scorer.score(point, Done(task, recording.trace, 0.0))
            except TraceError as error:
                raise TraceError(f"{recording.source}: {error}") from None
            record = Record(*key, point, number, rho, failure, trace=None, seconds=0.0)
            record = self.journal.get(*key) or self.journal.append(record, None)
            observer.rollout(record)
            groups[replicate].append(-record.rho)
        return [float(np.mean(group)) for group in groups]


def observe(search: Search, design: Design, experiment: OutcomeSource, observer: Observer) -> None:
    """Give a search the outcomes of all tests of a design at once; it is then done."""
    outcomes = experiment.outcomes(design.queries, observer)
    search.observe([(query.point, outcomes[query.index]) for query in design.queries], final=True)


def limitations(search: Search, what: str) -> list[str]:
    """Return the limits of a certificate from recorded tests, each in one sentence; ``what`` is "E ρ" or "E Δ"."""
    notes, space = [], search.space
    if not search.degrees:
        notes.append("no test was recorded twice, so these recordings could not have refuted R")
    if search.one_sided() is not None:  # it needs no band
        return notes
    points = space.grid((FINE.get(space.dim, 7),) * space.dim)
    lower, upper = search.band(points)
    widths = upper - lower
    if (widths > search.epsilon).any():
        lengths = search.kernel.lengthscales(space.dim)
        far = np.abs((points[:, None] - search.tested[None]) / lengths).max(axis=2).min(axis=1)
        # Where nothing is near, the band is as wide as B makes it: of the widest places the farthest is named.
        # To nine digits: mirror images are equally wide, and the last bit is not a reason to name one of them.
        widest = np.lexsort((far.round(9), (widths / search.epsilon).round(9)))[-1]
        unit = f" {search.unit}" if search.unit else ""
        where = ", ".join(
            f"{axis.name} = {value:.4g} {axis.unit}".rstrip()
            for axis, value in zip(space.axes, points[widest], strict=True)
        )
        share = width_text(100 * float(np.mean(widths > search.epsilon)), 0)
        notes.append(
            f"the recorded tests leave the band of {what} wider than ε = {search.epsilon:g}{unit} over {share} % of "
            f"the test space. It is widest at {where}, {width_text(widths[widest])}{unit}, "
            f"{far[widest]:.2g} lengthscales from the nearest recorded test"
        )
    return notes


def _point(spec: Spec, matched: Interface, recording: Recording) -> dict[str, float] | None:
    values = matched.to_spec(recording.params)
    if values is None:
        return None
    point = {}
    for axis in spec.space.axes:
        value = values[axis.name]
        point[axis.name] = min(max(value, axis.low), axis.high)
        if abs(point[axis.name] - value) > ROUNDING * axis.width:
            return None
    return point
