"""The two backends of a gap: each of them runs, or has recordings at fixed tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from s2r_spec.backend import Backend, HasRecordings, Recording, is_exclusive
from s2r_spec.base.errors import UsageError
from s2r_spec.certify.search.recorded import ROUNDING, Design, fixed_design
from s2r_spec.runs.scorer import Scorer
from s2r_spec.spec import Spec

SIMULATED_PER_REAL = 2
"""Budget: simulated rollouts whose mean is compared with each real one. With two instead of one, a gap takes a quarter
fewer real rollouts."""


@dataclass(frozen=True)
class Pairing:
    """Simulator and real machine, checked against the spec and against each other.

    A system that has recordings has a design of its tests; without one the search chooses them. The mean ρ of at least
    ``per_real`` simulated rollouts is compared with each real one. A reader of the certificate must know the notes.
    """

    sim: Scorer
    real: Scorer
    recorded: Design | None = None
    simulated: Design | None = None
    per_real: int = SIMULATED_PER_REAL
    notes: tuple[str, ...] = ()

    @property
    def scorers(self) -> dict[str, Scorer]:
        """Both scorers; the keys are the names in :data:`s2r_spec.runs.layout.SYSTEMS`."""
        return {"sim": self.sim, "real": self.real}

    @classmethod
    def for_spec(
        cls, spec: Spec, requirement: str, simulated: Backend | str, real: Backend | str, budget: int | None
    ) -> Pairing:
        """Open both backends, and pair their recordings; nothing runs. A UsageError says what does not fit together."""
        sim, machine = Scorer.for_spec(spec, requirement, simulated), Scorer.for_spec(spec, requirement, real)
        if is_exclusive(sim.backend):
            raise UsageError(
                f"{sim.name} is a machine, not a simulator: give it as --real, and a simulator as --sim"
            )
        if not isinstance(machine.backend, HasRecordings):
            if isinstance(sim.backend, HasRecordings):
                raise UsageError(
                    f"{sim.name} has only the tests that were recorded, but {machine.name} needs others: "
                    f"give a --sim that runs, or a recorded --real"
                )
            return cls(sim, machine)
        if budget is not None:
            raise UsageError(f"a budget does not apply to {machine.name}: s2r uses all of its recordings")
        recorded = fixed_design(spec, requirement, machine.backend, machine.backend.recordings)
        about = "the statement is about the machine as it was when it was recorded"
        if not isinstance(sim.backend, HasRecordings):
            notes = (about, *recorded.notes, *_undeclared_notes(spec, sim.backend, machine.backend))
            return cls(sim, machine, recorded, notes=notes)
        if sim.backend.model_hash == machine.backend.model_hash:
            raise UsageError(
                f"{sim.name} and {machine.name} are the same recordings: a gap needs two different ones"
            )
        others = fixed_design(spec, requirement, sim.backend, sim.backend.recordings)
        real_tests, sim_tests, note = _pair_designs(spec, recorded, others)
        notes = (about, *recorded.notes, *others.notes, *note)
        fewest = min(
            len(group) // len(real_group)
            for (_, group), (_, real_group) in zip(sim_tests.tests, real_tests.tests, strict=True)
        )
        return cls(sim, machine, real_tests, sim_tests, min(fewest, SIMULATED_PER_REAL), notes)


def _pair_designs(spec: Spec, real: Design, simulated: Design) -> tuple[Design, Design, list[str]]:
    """Return both designs at their common tests: for every real recording one or two simulated ones.

    The first recordings of a test are used, so the choice does not depend on any outcome.

    Raises:
        UsageError: no test was recorded on both sides.
    """
    widths = np.array([axis.width for axis in spec.space.axes])
    points = np.array([spec.space.vector(point) for point, _ in simulated.tests])
    real_tests: list[tuple[dict[str, float], tuple[Recording, ...]]] = []
    sim_tests: list[tuple[dict[str, float], tuple[Recording, ...]]] = []
    for point, recordings in real.tests:
        distances = np.abs((points - spec.space.vector(point)) / widths).max(axis=1)
        nearest = int(distances.argmin())
        if distances[nearest] <= ROUNDING:
            others = simulated.tests[nearest][1]
            pairs = min(len(recordings), len(others))
            real_tests.append((point, recordings[:pairs]))
            sim_tests.append((point, others[: SIMULATED_PER_REAL * pairs]))
    if not real_tests:
        raise UsageError(
            f"no test of {spec.name} was recorded in both: {_first_tests(real)} of the real machine, "
            f"{_first_tests(simulated)} of the simulator"
        )
    notes = []
    for side, before, after in (("real", real, real_tests), ("simulated", simulated, sim_tests)):
        unused = sum(len(group) for _, group in before.tests) - sum(len(group) for _, group in after)
        if unused:
            notes.append(
                f"{unused} {side} recordings have no counterpart at the same test, and are not used; "
                f"this choice does not depend on any outcome"
            )
    return Design(tuple(real_tests), ()), Design(tuple(sim_tests), ()), notes


def _first_tests(design: Design) -> str:
    shown = "; ".join(
        ", ".join(f"{name} = {value:.4g}" for name, value in point.items()) for point, _ in design.tests[:3]
    )
    return shown + ("; …" if len(design.tests) > 3 else "")


def _undeclared_notes(spec: Spec, sim: Backend, machine: Backend) -> Sequence[str]:
    """Return a note for each recorded parameter that the simulator has, too, but the spec does not declare."""
    offered = {parameter.name: parameter for parameter in sim.parameters}
    return [
        f"every recording was made with {recorded.name} = {recorded.default:g} {recorded.unit}".rstrip()
        + f", which {spec.name} does not declare: {sim.name} uses its own default, "
        + f"{offered[recorded.name].default:g} {offered[recorded.name].unit}".rstrip()
        for recorded in machine.parameters
        if recorded.name in offered and recorded.name not in spec.params
    ]
