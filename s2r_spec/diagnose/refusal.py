"""The answer from recordings that no machine can explain: their mistakes, and no estimate."""

from __future__ import annotations

from collections.abc import Sequence

from s2r_spec.base.distribution import version
from s2r_spec.diagnose.data.rollouts import RealRollouts
from s2r_spec.diagnose.decision import Evidence
from s2r_spec.diagnose.diagnosis import Diagnosis, Provenance, Which
from s2r_spec.diagnose.quality import Finding
from s2r_spec.diagnose.simulator.bench import Bench


def refusal(
    bench: Bench, seed: int, rollouts: RealRollouts, broken: Sequence[Finding], assumptions: tuple[str, ...]
) -> Diagnosis:
    """Return the answer from recordings with mistakes that are certain."""
    return Diagnosis(
        Which(Evidence((), findings=broken), ()),
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
