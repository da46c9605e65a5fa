"""Rollouts of the simulator without effects at every test of the real ones, made once for all comparisons."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.gap import SHOTS
from s2r_spec.diagnose.simulator.bench import Bench, Job, Test, places_of, run_jobs, with_seeds
from s2r_spec.runs.seeds import SeedStream
from s2r_spec.space import Key, key_of


@dataclass(frozen=True, eq=False)
class Nominal:
    """What the simulator does without effects in 2 SHOTS rollouts of every test.

    Attributes:
        seed: of the simulations.
        runs: test → test and seed of each rollout. A simulator with effects has the same seeds.
        rho, ended: test → (2 SHOTS,) ρ of each, and whether it ended early.
        files: the same of the simulator as its files are, where this one has the mistakes of the machine's loop.
    """

    seed: int
    runs: Mapping[Key, Sequence[tuple[Test, int]]]
    rho: Mapping[Key, FloatArray]
    ended: Mapping[Key, NDArray[np.bool_]]
    files: Nominal | None = None

    @property
    def before(self) -> Nominal:
        """The simulator without anything that was found."""
        return self.files or self

    @classmethod
    def of(cls, bench: Bench, tests: Sequence[Test], seed: int) -> Nominal:
        """Simulate at every different test of the real rollouts.

        Raises:
            BackendError: a simulation raised an error.
        """
        keys, shots = list(places_of(tests)), 2 * SHOTS
        every = with_seeds([dict(key) for key in keys], seed, SeedStream.NOMINAL, shots)
        runs = {key: every[n * shots : (n + 1) * shots] for n, key in enumerate(keys)}
        rows = dict(zip(keys, run_jobs(bench, [Job({}, own) for own in runs.values()]), strict=True))
        rho = {key: row[:, 0] for key, row in rows.items()}
        return cls(seed, runs, rho, {key: row[:, 1] > 0.0 for key, row in rows.items()})

    def first(self, tests: Iterable[Test], shots: int = 1) -> list[tuple[Test, int]]:
        """Return test and seed of the first rollouts at each of some tests, one test after the other."""
        return [run for test in tests for run in self.runs[key_of(test)][:shots]]

    def ends(self, test: Test) -> bool:
        """Return whether the first rollout at a test ended early."""
        return bool(self.ended[key_of(test)][0])
