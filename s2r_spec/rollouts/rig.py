"""A requirement on a backend: what turns a test into ρ."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from s2r_spec.backend import Backend
from s2r_spec.errors import UsageError
from s2r_spec.rollouts.match import Matched, match
from s2r_spec.rollouts.runner import Done, Task, open_backend
from s2r_spec.spec import Spec


@dataclass(frozen=True)
class Rig:
    """One requirement of a spec, set up on one backend.

    Attributes:
        spec: with the requirement.
        requirement: its name.
        name: of the backend, as every worker opens it.
        backend: the same, in this process.
        matched: channels and units that fit together.
        fall: ρ of a rollout that failed, declared before the data.
    """

    spec: Spec
    requirement: str
    name: str
    backend: Backend
    matched: Matched
    fall: float

    @classmethod
    def set_up(cls, spec: Spec, requirement: str, name: str, duration: float | None = None) -> Self:
        """Open the backend with rollouts as long as the requirement looks ahead, and match the two.

        Raises:
            UsageError: they do not fit together, or no ρ is declared for a fall.
        """
        horizon = spec.horizon(requirement)
        if duration is None and math.isfinite(horizon) and horizon > 0:
            duration = horizon
        backend = open_backend(name, duration)
        settings = spec.certify.get(requirement)
        if settings is None or settings.fall is None:
            raise UsageError(
                f"{spec.name} declares no ρ for a rollout that falls; "
                f"write for example  certify {requirement}: fall = -1"
            )
        return cls(spec, requirement, name, backend, match(spec, requirement, backend), settings.fall)

    def task(self, query: int, replicate: int, point: Mapping[str, float], seed: int) -> Task:
        """Return the task of one rollout at a test point, which is in the spec's units."""
        return Task(
            query=query,
            replicate=replicate,
            backend=self.name,
            params=self.matched.to_backend(point),
            seed=seed,
            duration=self.backend.duration,
            # A simulator gives the same trace again for the same seed, so only what
            # the spec reads is kept; what cannot be repeated is kept whole.
            channels=self.matched.channels if self.backend.deterministic else None,
        )

    def score(self, point: Mapping[str, float], done: Done) -> tuple[float, str | None]:
        """Return ρ of a rollout, and the word for its failure if it failed.

        A fall or a crash has the value that was declared for it: it is never
        dropped, and never judged by the trace that it cut short.
        """
        if done.trace is None:
            return self.fall, f"crash: {done.crash}"
        if done.trace.failure is not None:
            return self.fall, done.trace.failure
        return self.spec.robustness(done.trace, params=point)[self.requirement], None
