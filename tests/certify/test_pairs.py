"""The pairs of two journals do not hang on the order in which rollouts came back from their processes."""

from types import SimpleNamespace

import numpy as np

from s2r_spec.certify.result import gap_result
from s2r_spec.certify.result.gap_result import pairs_of


def record(query, replicate, rho):
    return SimpleNamespace(query=query, replicate=replicate, rho=rho, params={"x": 0.0}, failure=None)


def test_the_mean_of_simulated_rollouts_is_the_same_in_any_order(monkeypatch):
    rng = np.random.default_rng(0)
    monkeypatch.setattr(gap_result, "SIMULATED_PER_REAL", 7)
    sim = [record(0, k, rho) for k, rho in enumerate(rng.normal(size=7) * 10.0 ** rng.integers(-8, 3, 7))]
    real = SimpleNamespace(records=lambda: [record(0, 0, 0.5)])
    found = set()
    for _ in range(50):
        mixed = [sim[k] for k in rng.permutation(7)]
        (pair,) = pairs_of({"sim": SimpleNamespace(records=lambda mixed=mixed: mixed), "real": real}, 7)
        found.add(pair.gap)
    assert len(found) == 1
