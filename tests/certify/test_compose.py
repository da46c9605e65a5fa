import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.base.verdict import Verdict
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.result.compose import compose, decides, judge
from s2r_spec.certify.search.search import Search
from s2r_spec.errors import UsageError
from s2r_spec.space import Space
from tests.certify.rkhs import RandomFunction, run

KERNEL = Kernel("matern52", 0.3)


def searched(space, function, seed):
    search = Search(space, kernel=KERNEL, B=1.5, R=0.02, delta=0.05, epsilon=0.08, seed=seed, budget=3000)
    run(search, function, 0.02, np.random.default_rng(seed))
    return search


@pytest.mark.parametrize("dim", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_the_promise_holds_and_is_never_looser_than_the_papers(dim):
    space = Space.of(dict.fromkeys("xy"[:dim], (0.0, 0.5)))
    fine = space.grid((2001,)) if dim == 1 else space.grid((151, 151))
    for seed in range(4):
        rng = np.random.default_rng(seed)
        simulated, gap = (RandomFunction(KERNEL, space, norm, rng) for norm in (0.4, 0.15))
        result = s2r.compose(searched(space, simulated, 2 * seed), searched(space, gap, 2 * seed + 1))
        # The searches saw −ρ̂ and −Δ, so that ρ_real = −(J₁ + J₂).
        real = -(simulated(fine) + gap(fine))
        assert result.lower <= real.min() <= result.upper
        assert result.lower >= result.paper_lower
        assert result.gap[0] <= -gap(fine).max()
        assert -gap(fine).min() <= result.gap[1]
        assert result.delta == 0.1


def test_a_verdict_that_ends_the_search_is_the_one_of_the_whole_composition():
    space = Space.of({"x": (0.0, 0.5)})
    for seed in range(3):
        rng = np.random.default_rng(seed)
        simulated, gap = (RandomFunction(KERNEL, space, norm, rng) for norm in (0.3, 0.1))
        second = searched(space, gap, 2 * seed + 1)
        largest = (simulated(space.grid((2001,))) + gap(space.grid((2001,)))).max()
        for margin, known in ((-0.4, True), (0.0, False), (0.4, True)):
            first = searched(
                space, lambda points, at=margin - largest, of=simulated: at + of(points), 2 * seed
            )
            assert decides(first, second) is known
            assert (judge(compose(first, second)) is not Verdict.UNKNOWN) is known


def test_bounds_over_different_spaces_are_not_added():
    searches = [Search({"x": (0, high)}, kernel=KERNEL, B=1, R=1, delta=0.1, epsilon=1) for high in (1, 2)]
    with pytest.raises(UsageError, match="different test spaces"):
        s2r.compose(*searches)
