"""What a rollout is worth."""

from __future__ import annotations

from collections.abc import Mapping

from s2r_spec.rollouts.runner import Done
from s2r_spec.spec import Spec


def score(
    spec: Spec, requirement: str, point: Mapping[str, float], done: Done, fall: float
) -> tuple[float, str | None]:
    """Return ρ of a rollout, and the word for its failure if it failed.

    A fall or a crash has the value ``fall`` that was declared before the data:
    it is never dropped, and never judged by the trace that it cut short.
    """
    if done.trace is None:
        return fall, f"crash: {done.crash}"
    if done.trace.failure is not None:
        return fall, done.trace.failure
    return spec.robustness(done.trace, params=point)[requirement], None
