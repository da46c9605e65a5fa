"""What an improved simulator says of the gap, at the tests that were run and over the test space."""

from typing import ClassVar

import numpy as np
from s2r_cart import SPEC, Cart

import s2r_spec as s2r
from s2r_spec.diagnose.gap.surface import grid_of
from s2r_spec.diagnose.gap.where import predict
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.runs.seeds import SeedStream, rollout_seed

ADDED = {"coulomb": {"force": 1.5}}
TESTS = [{"vd": 0.25, "acc": 3.5}, {"vd": 0.9, "acc": 1.2}]


def bench(cart):
    spec = s2r.parse_spec(SPEC)
    return Bench.of(spec, spec.requirements[0], cart)


def test_what_is_foretold_is_what_the_two_simulators_say_of_the_same_seed():
    at = bench(Cart())
    found = predict(at, ADDED, TESTS, 3)
    for number, test in enumerate(TESTS):
        seed = rollout_seed(3, number, 0, SeedStream.FORETELL)
        rho = [at.rho(at.run(values, test, seed), test) for values in ({}, ADDED)]
        assert found.tests[number] == rho[1] - rho[0]
    assert found.grid.shape == (len(grid_of(at.spec.space)),)
    corner = at.spec.space.point(grid_of(at.spec.space)[0])
    rho = [at.rho(at.run(values, corner, 5), corner) for values in ({}, ADDED)]
    assert np.sign(found.grid[0]) == np.sign(rho[1] - rho[0])


class Counted(Cart):
    """A cart that counts its rollouts."""

    ran: ClassVar = []

    def rollout(self, params, seed):
        self.ran.append(params)
        return super().rollout(params, seed)


def test_a_costly_simulator_is_asked_at_a_coarse_grid_alone():
    Counted.ran.clear()
    assert predict(bench(Counted(cost=60.0)), ADDED, TESTS, 3).grid.shape == (441,)
    costly = len(Counted.ran)
    assert costly <= 2 * (len(TESTS) + 14)
    predict(bench(Counted()), ADDED, TESTS, 3)
    assert len(Counted.ran) - costly > costly
