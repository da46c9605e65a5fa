"""Real experiments beside the simulator: what the luck of a few runs counts."""

from dataclasses import dataclass

import numpy as np
import pytest

from s2r_spec.diagnose.inference.recorded import Recorded
from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import library, simulated_rows
from tests.diagnose.test_candidates import Rig, runs

TESTS = [Experiment.test({"v": v}) for v in (0.3, 0.7)]


@dataclass(frozen=True)
class Chaotic(Rig):
    """A rig whose scatter is another one as soon as any size changes."""

    def rollout(self, params, seed):
        changed = sum(1 + int(1e6 * abs(size)) * n for n, (_, size) in enumerate(self.added, 1) if size)
        return super().rollout(params, seed + 100_003 * changed)


def recorded(machine, folder):
    responses = library(machine, TESTS, cache=Cache(folder))
    return Recorded.of(machine, responses, runs({}, tests=TESTS)), responses


@pytest.mark.parametrize(("machine", "correlation"), [(Rig(), 1.0), (Chaotic(), 0.0)])
def test_seeds_in_common_count_as_far_as_runs_of_one_seed_agree(machine, correlation, tmp_path):
    found, _ = recorded(machine, tmp_path)
    assert np.mean([common.mean() for common in found.common]) == pytest.approx(correlation, abs=0.3)


def test_runs_of_a_chaotic_simulator_correct_no_sum_of_responses_that_is_right(tmp_path):
    """Else the scatter of a few runs would move all observables, and with them the evidence."""
    found, responses = recorded(Chaotic(), tmp_path)
    theta = responses.coordinates({"d": {"size": 0.4}})
    values = responses.values(theta)
    few = found.near(theta, simulated_rows(Chaotic(), responses.responses, values, None, 2))
    moved = [np.abs(one.correction).mean() for one in few]
    scatter = [np.sqrt(own).mean() for own in found.scatter]
    assert max(moved) < 0.5 * min(scatter)
