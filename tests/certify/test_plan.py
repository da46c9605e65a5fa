import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.bound.sample_complexity import minimax, sequential_lower_bound
from s2r_spec.certify.bound.settings import SearchSettings
from s2r_spec.certify.search.effort import Effort, Objective
from s2r_spec.certify.search.plan_request import plan
from s2r_spec.certify.search.search import Search
from s2r_spec.errors import UsageError
from s2r_spec.space import Space
from s2r_spec.workers.pools import in_this_process
from tests.certify.rkhs import RandomFunction, run
from tests.errors import naming, states

LINE = Space.of({"vd": (-0.2, 0.3)})


def test_the_floors_of_the_papers_two_settings():
    """Simulator: R = 0.05, ε = 0.02. Hardware: R = 0.1, ε = 0.003. Both at δ = 1e-6."""
    assert sequential_lower_bound(0.05, 0.02, 1e-6) == pytest.approx(173, abs=0.5)
    assert sequential_lower_bound(0.1, 0.003, 1e-6) == pytest.approx(30_701, abs=0.5)
    assert minimax(0.05, 0.02, 1e-6) == pytest.approx(565, abs=0.5)
    assert minimax(0.1, 0.003, 1e-6) == pytest.approx(100_422, abs=0.5)
    assert sequential_lower_bound(1, 1, 0.5) == 0


def test_a_plan_foretells_what_a_search_then_takes():
    settings = {"kernel": Kernel("rbf", 0.2), "B": 1.5, "R": 0.02, "delta": 1e-3, "epsilon": 0.03}
    foretold = plan(LINE, **settings, budgets=(20, 200))
    taken = []
    for seed in range(5):
        rng = np.random.default_rng(1000 + seed)
        search = Search(LINE, **settings, seed=seed)
        # It varies by about two ε.
        run(search, RandomFunction(settings["kernel"], LINE, 0.04, rng), 0.02, rng)
        taken.append(search.certificate().rollouts)
    assert foretold.floor < foretold.minimax < foretold.flat
    assert foretold.peaked <= foretold.expected <= foretold.flat
    assert sum(foretold.peaked <= rollouts <= foretold.flat for rollouts in taken) >= 4
    (_, wide), (_, narrow) = foretold.reachable
    assert narrow < wide
    for (_, expected), (_, low, high) in zip(foretold.reachable, foretold.reachable_range, strict=True):
        assert low < expected < high


def taken_by(settings, space, outcome, seed=0):
    """Return the rollouts of a search until ε."""
    search = Search(space, **settings, seed=seed)
    rng = np.random.default_rng(seed)
    while not search.done:
        for query in search.ask():
            search.tell(query, outcome(query.point) + settings["R"] * rng.normal(size=query.replicates))
    return search.certificate().rollouts


PLANE = Space.of({"x": (0.0, 0.5), "y": (0.0, 0.3)})


@pytest.mark.parametrize(
    ("space", "settings"),
    [
        (LINE, {"kernel": Kernel("matern52", 0.2), "B": 1.0, "R": 0.02, "delta": 1e-3, "epsilon": 0.04}),
        (LINE, {"kernel": Kernel("rbf", 0.2), "B": 1.0, "R": 0.02, "delta": 1e-3, "epsilon": 0.04}),
        (PLANE, {"kernel": Kernel("rbf", 0.3), "B": 1.0, "R": 0.02, "delta": 1e-3, "epsilon": 0.08}),
    ],
    ids=["Matérn", "RBF", "two parameters"],
)
def test_a_flat_outcome_takes_what_the_design_of_a_flat_objective_takes(space, settings):
    """The design has no batches and no discrete tests."""
    effort = Effort.of(SearchSettings(space=space, **settings))
    design = effort.rollouts(Objective.flat(len(effort.region.points), 0.0), 0.4)
    assert 0.6 < taken_by(settings, space, lambda point: 0.0) / design < 1.7


def test_the_rollouts_grow_as_the_square_of_the_number_of_lengthscales():
    """There are more places to test, and the radius grows with their number. A long box is computed as many parts."""
    counts = []
    for length in (0.5, 50.0, 100.0):
        settings = SearchSettings(
            space=Space.of({"x": (0.0, length)}),
            kernel=Kernel("rbf", 0.2),
            B=1.5,
            R=0.02,
            delta=1e-3,
            epsilon=0.03,
        )
        effort = Effort.of(settings)
        counts.append(effort.rollouts(Objective.flat(len(effort.region.points), 0.0), 0.5))
    assert 2000 < counts[1] / counts[0] < 10_000
    assert counts[2] / counts[1] == pytest.approx(4, rel=0.2)


def test_an_axis_shorter_than_its_lengthscale_takes_the_tests_of_every_eighth():
    settings = {"kernel": Kernel("rbf", 1.0), "B": 1.5, "R": 0.02, "delta": 1e-3, "epsilon": 0.02}
    floor = sequential_lower_bound(0.02, 0.02, 1e-3)
    assert plan(LINE, **settings).peaked >= 8 * floor


def test_a_claim_beyond_reach_is_said_to_be():
    foretold = plan(LINE, kernel=Kernel("rbf", 0.2), B=1.5, R=0.1, delta=1e-6, epsilon=0.003, most=2000)
    assert foretold.peaked is None
    assert foretold.flat is None


def test_settings_fitted_on_the_same_data_make_no_certificate():
    rng = np.random.default_rng(0)
    kernel = Kernel("rbf", 0.2)
    search = Search(LINE, kernel=kernel, B=1.5, R=0.02, delta=0.1, epsilon=0.1, fitted=("R", "kernel"))
    run(search, RandomFunction(kernel, LINE, 0.4, rng), 0.02, rng)
    certificate = search.certificate()
    assert certificate.label is Label.MODEL_BASED
    assert states(certificate.reason, "R, kernel")


def test_single_precision_outcomes_are_refused():
    search = Search(LINE, kernel=Kernel("rbf", 0.2), B=1.5, R=0.02, delta=0.1, epsilon=0.1)
    with pytest.raises(UsageError, match=naming("float32", "float64")):
        search.tell(search.ask()[0], np.zeros(2, dtype=np.float32))


@pytest.mark.usefixtures("toy")
def test_any_measure_can_be_certified_and_resumed(tmp_path):
    """The smallest distance of the speed from 1 m/s over the trace: no temporal logic in it."""
    import s2r_spec as s2r

    def search():
        return Search(LINE, kernel=Kernel("rbf", 0.5), B=4.0, R=0.02, delta=0.1, epsilon=0.1)

    def distance(trace, params):
        return float(np.abs(trace["vx"] - 1.0).min())

    words, thread = (distance, "distance", "toy"), {"executor": in_this_process}
    first = s2r.check_measure(*words, search(), tmp_path / "run", fall=-1.0, **thread)
    assert first.label is Label.CERTIFIED
    # The worst test is the fastest: 1 − (0.3·(1 − e^{−15}) − 0.02·0.3) on average over the bias.
    assert -first.upper <= 1 - 0.3 + 0.006 <= -first.lower
    again = s2r.check_measure(*words, search(), tmp_path / "run", fall=-1.0, resume=True, **thread)
    assert again == first
    with pytest.raises(UsageError, match=naming("fall", "-1.0", "-2.0")):
        s2r.check_measure(*words, search(), tmp_path / "run", fall=-2.0, resume=True)


SPEC = """
signal x {m}
param p {m} in [0, 1]
require r: always (x <= p)
certify r: delta = 1e-3, epsilon = 0.1, B = 0.5, R = 0.02, kernel = matern52(0.4 {m}), fall = -1
"""


def test_a_specification_is_planned_by_its_certify_line_and_by_what_the_caller_gives():
    spec = s2r.parse_spec(SPEC)
    own = {"kernel": Kernel("matern52", 0.4), "B": 0.5, "R": 0.02, "delta": 1e-3, "epsilon": 0.1}
    assert s2r.plan(spec) == s2r.plan(spec.space, **own)
    assert s2r.plan(spec, epsilon=0.2) == s2r.plan(spec.space, **own | {"epsilon": 0.2})
    assert s2r.plan(spec.space, **own | {"R": None}, bounds=(0.0, 0.04)) == s2r.plan(spec)


def test_the_time_on_a_backend_becomes_a_budget():
    class Robot(s2r.FunctionBackend):
        exclusive = True  # so one rollout at a time

    robot = Robot(lambda params, seed: None, cost=100.0)
    found = s2r.plan(s2r.parse_spec(SPEC), backend=robot, time="30min")
    assert [rollouts for rollouts, _ in found.gaps] == [rollouts for rollouts, _ in found.reachable] == [18]
    smaller = s2r.plan(s2r.parse_spec(SPEC.rstrip() + ", gap_B = 0.1\n"), backend=robot, time="30min")
    assert smaller.reachable == found.reachable
    assert smaller.gaps[0][1] < found.gaps[0][1]


@pytest.mark.parametrize(
    ("keywords", "facts"),
    [
        ({"B": 1.0}, ["--R", "--eps", "--delta"]),
        ({"bounds": (1.0, 0.0)}, ["--range"]),
        ({"time": "30min"}, ["--time", "--backend"]),
    ],
)
def test_a_plan_without_its_settings_is_refused(keywords, facts):
    of = s2r.parse_spec(SPEC) if "time" in keywords else LINE
    with pytest.raises(UsageError, match=naming(*facts)):
        s2r.plan(of, **keywords)
