"""The two sides of a gap: who runs, and what was recorded and so cannot be asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from s2r_spec.backend import Backend, HasRecordings, Recording, is_exclusive
from s2r_spec.certify.recorded import ROUNDING, Design, fixed_design
from s2r_spec.errors import UsageError
from s2r_spec.rollouts.scorer import Scorer
from s2r_spec.spec import Spec

# Simulated rollouts averaged against each real one: a quarter fewer real rollouts than with one.
SIMULATED_PER_REAL = 2


@dataclass(frozen=True)
class Pairing:
    """Both scorers of a gap, which fit the spec and each other.

    Attributes:
        sim: the simulator's scorer.
        real: the real machine's.
        recorded: the tests, if the real side is recordings; else None, and the search chooses them.
        simulated: recordings of the simulator at the same tests; None if it runs.
        per_real: fewest simulated rollouts that are averaged against a real one.
        notes: what a reader of the certificate must know, each in one sentence.
    """

    sim: Scorer
    real: Scorer
    recorded: Design | None = None
    simulated: Design | None = None
    per_real: int = SIMULATED_PER_REAL
    notes: tuple[str, ...] = ()

    @classmethod
    def for_spec(cls, spec: Spec, requirement: str, simulated: str, real: str, budget: int | None) -> Pairing:
        """Open both backends, and pair what was recorded; nothing runs.

        Raises:
            UsageError: spec and backends do not fit together, or the recordings do not make pairs.
        """
        sim, machine = Scorer.for_spec(spec, requirement, simulated), Scorer.for_spec(spec, requirement, real)
        if is_exclusive(sim.backend):
            raise UsageError(
                f"{simulated} is a machine, not a simulator: give it as --real, and a simulator as --sim"
            )
        if not isinstance(machine.backend, HasRecordings):
            if isinstance(sim.backend, HasRecordings):
                raise UsageError(
                    f"{simulated} has only the tests that were recorded, but {real} is asked for others: "
                    f"give a simulator that runs as --sim, or recordings as --real, too"
                )
            return cls(sim, machine)
        if budget is not None:
            raise UsageError(f"a budget does not apply to {real}: it has the recordings that it has")
        recorded = fixed_design(spec, requirement, machine.backend, machine.backend.recordings)
        about = "the statement is about the machine as it was when it was recorded"
        if not isinstance(sim.backend, HasRecordings):
            notes = (about, *recorded.notes, *_undeclared(spec, sim.backend, machine.backend))
            return cls(sim, machine, recorded, notes=notes)
        if sim.backend.model_hash == machine.backend.model_hash:
            raise UsageError(f"{simulated} and {real} are the same recordings: a gap needs both sides apart")
        others = fixed_design(spec, requirement, sim.backend, sim.backend.recordings)
        left, right, note = _paired(spec, recorded, others)
        notes = (about, *recorded.notes, *others.notes, *note)
        fewest = min(
            len(group) // len(real_group)
            for (_, group), (_, real_group) in zip(right.tests, left.tests, strict=True)
        )
        return cls(sim, machine, left, right, min(fewest, SIMULATED_PER_REAL), notes)


def _paired(spec: Spec, real: Design, simulated: Design) -> tuple[Design, Design, list[str]]:
    """Return both designs at their common tests, every real recording with one or two simulated ones.

    The first recordings are taken, so that nothing depends on an outcome.

    Raises:
        UsageError: no test was recorded on both sides.
    """
    widths = np.array([axis.width for axis in spec.space.axes])
    there = np.array([spec.space.vector(point) for point, _ in simulated.tests])
    left: list[tuple[dict[str, float], tuple[Recording, ...]]] = []
    right: list[tuple[dict[str, float], tuple[Recording, ...]]] = []
    for point, recordings in real.tests:
        apart = np.abs((there - spec.space.vector(point)) / widths).max(axis=1)
        nearest = int(apart.argmin())
        if apart[nearest] <= ROUNDING:
            others = simulated.tests[nearest][1]
            pairs = min(len(recordings), len(others))
            left.append((point, recordings[:pairs]))
            right.append((point, others[: SIMULATED_PER_REAL * pairs]))
    if not left:
        raise UsageError(
            f"no test of {spec.name} was recorded on both sides: {_few(real)} of the real machine, "
            f"{_few(simulated)} of the simulator"
        )
    notes = []
    for side, before, after in (("real", real, left), ("simulated", simulated, right)):
        unused = sum(len(group) for _, group in before.tests) - sum(len(group) for _, group in after)
        if unused:
            notes.append(
                f"{unused} {side} recordings have no counterpart at the same test, and are not used; "
                f"which are used depends on no outcome"
            )
    return Design(tuple(left), ()), Design(tuple(right), ()), notes


def _few(design: Design) -> str:
    """Return some tests in words."""
    shown = "; ".join(
        ", ".join(f"{name} = {value:.4g}" for name, value in point.items()) for point, _ in design.tests[:3]
    )
    return shown + ("; …" if len(design.tests) > 3 else "")


def _undeclared(spec: Spec, sim: Backend, machine: Backend) -> Sequence[str]:
    """Say which parameters were recorded that the simulator has too, but the spec does not give it."""
    offered = {parameter.name: parameter for parameter in sim.parameters}
    return [
        f"every recording was made with {recorded.name} = {recorded.default:g} {recorded.unit}".rstrip()
        + f", which {spec.name} does not declare: {sim.name} runs with its own, "
        + f"{offered[recorded.name].default:g} {offered[recorded.name].unit}".rstrip()
        for recorded in machine.parameters
        if recorded.name in offered and recorded.name not in spec.params
    ]
