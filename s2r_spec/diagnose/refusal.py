"""What is not diagnosed: recordings that no machine can explain, and a simulator that keeps state between rollouts."""

from __future__ import annotations

from collections.abc import Sequence

from s2r_spec.base.distribution import version
from s2r_spec.base.errors import S2RError, UsageError
from s2r_spec.diagnose.data.rollouts import RealRollouts
from s2r_spec.diagnose.decision import Evidence
from s2r_spec.diagnose.diagnosis import Diagnosis, Provenance, Which
from s2r_spec.diagnose.quality import Finding, Loop
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.runs.repeatability import check_here, is_repeated


def refusal(
    bench: Bench,
    seed: int,
    rollouts: RealRollouts,
    broken: Sequence[Finding],
    assumptions: tuple[str, ...],
    loop: Loop | None = None,
) -> Diagnosis:
    """Return the answer from recordings with mistakes that are certain, or with a loop of which no size is known."""
    return Diagnosis(
        Which(Evidence((), findings=broken, loop=loop), ()),
        None,
        {},
        provenance(bench, seed, rollouts, 0),
        assumptions,
        (*(each.text for each in broken), *rollouts.notes),
        passive=not rollouts.protocols,
    )


def provenance(bench: Bench, seed: int, rollouts: RealRollouts, held_out: int) -> Provenance:
    """Return the data that fix an answer from these rollouts, of which so many are held out."""
    return {
        "s2r": version(),
        "seed": seed,
        "spec_hash": bench.spec.hash,
        "requirement": bench.requirement,
        "backend": bench.backend.name,
        "model_hash": bench.backend.model_hash,
        "rollouts": len(rollouts.tests) + len(rollouts.protocols),
        "held_out": held_out,
    }


def refuse_memory(bench: Bench, seed: int) -> None:
    """Refuse a simulator that is declared as deterministic, and gives other bits when a rollout is repeated."""
    if not is_repeated(bench.backend):
        return
    space = bench.spec.space
    test, other = (bench.matched.to_backend(space.point(corner)) for corner in (space.upper, space.lower))
    try:
        differences = check_here(bench.backend, test, other, seed, elsewhere=False)
    except S2RError:  # it may not run at a corner; the diagnosis names a rollout that it needs
        return
    if differences:
        raise UsageError(
            f"no diagnosis: {bench.backend.name} is declared as deterministic, but the test {dict(test)} with seed "
            f"{seed} gives other bits when it is repeated. {differences}"
        )
