import json

import numpy as np
import pytest

from s2r_spec.certify.bound import confidence
from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.search.search import Query, Search
from s2r_spec.errors import UsageError
from s2r_spec.space import Space
from tests.certify.rkhs import RandomFunction, run
from tests.errors import naming, states

LINE = Space.of({"vd": (-0.2, 0.3)}, {"vd": "m/s"})
USUAL = {"kernel": Kernel("rbf", 0.2), "B": 1.5, "R": 0.02, "delta": 0.1, "epsilon": 0.05}


def searched(seed=0, norm=0.4, noise=0.02, **changes):
    search = Search(LINE, **(USUAL | {"seed": seed} | changes))
    rng = np.random.default_rng(seed)
    run(search, RandomFunction(USUAL["kernel"], LINE, norm, rng), noise, rng)
    return search


def test_a_finished_search_is_certified_and_as_narrow_as_asked():
    certificate = searched().certificate()
    assert certificate.label is Label.CERTIFIED
    assert certificate.lower <= certificate.upper <= certificate.lower + 0.05
    assert certificate.settings["B"] == 1.5
    assert len(certificate.assumptions) == 3


def test_before_any_data_the_norm_bound_alone_speaks():
    search = Search(LINE, **USUAL)
    certificate = search.certificate()
    assert (certificate.lower, certificate.rollouts) == (-1.5, 0)
    lower, upper = search.band([[0.0], [0.05]])
    assert (lower.tolist(), upper.tolist()) == ([-1.5, -1.5], [1.5, 1.5])
    assert certificate.upper == pytest.approx(1.5 + certificate.discretisation)
    assert certificate.label is Label.RUNNING


def test_the_interval_never_widens_and_every_rung_contains_the_one_below():
    search = Search(LINE, **USUAL)
    rng = np.random.default_rng(0)
    function = RandomFunction(USUAL["kernel"], LINE, 0.4, rng)
    before = search.certificate()
    while not search.done:
        for query in search.ask():
            search.tell(
                query, function(search.space.vector(query.point)) + 0.02 * rng.normal(size=query.replicates)
            )
        now = search.certificate()
        assert now.lower >= before.lower
        assert now.upper <= before.upper
        assert [rung.B for rung in now.ladder] == [1.5, 3, 6, 12]
        for narrow, wide in zip(now.ladder, now.ladder[1:], strict=False):
            assert wide.lower <= narrow.lower
            assert narrow.upper <= wide.upper
        before = now


def test_the_order_of_telling_within_a_batch_changes_nothing():
    def certificate(reverse):
        search = Search(LINE, **USUAL)
        function = RandomFunction(USUAL["kernel"], LINE, 0.4, np.random.default_rng(0))
        while not search.done:
            queries = search.ask()
            for query in reversed(queries) if reverse else queries:
                noise = 0.02 * np.random.default_rng(query.index).normal(size=query.replicates)
                search.tell(query, function(search.space.vector(query.point)) + noise)
        return search.certificate()

    assert certificate(False) == certificate(True)


def batches(R, seed):
    """Return the replicates of every batch of a search with this much noise."""
    search = Search(LINE, **(USUAL | {"R": R, "delta": 1e-6, "epsilon": 0.02, "seed": seed}))
    rng = np.random.default_rng(seed)
    function = RandomFunction(USUAL["kernel"], LINE, 0.4, rng)
    asked = []
    while not search.done:
        queries = search.ask()
        asked.append([query.replicates for query in queries])
        for query in queries:
            outcomes = function(search.space.vector(query.point)) + R * rng.normal(size=query.replicates)
            search.tell(query, outcomes)
    assert search.certificate().label is Label.CERTIFIED
    return asked


def test_an_early_batch_ends_with_the_test_that_is_expected_to_be_the_last():
    runs = [batches(0.005, seed) for seed in range(8)]
    assert any(len(one[-1]) < 4 for one in runs)
    for one in runs:
        assert all(len(batch) == 4 for batch in one[:2])  # not before it is near its end
        assert all(replicates >= 2 for batch in one for replicates in batch)  # what could refute R stays
    later = batches(0.05, 0)
    assert sum(map(sum, later)) > 80
    assert all(len(batch) == 4 for batch in later)


def test_a_seed_fixes_the_search_and_another_one_moves_it():
    assert searched(seed=1).certificate() == searched(seed=1).certificate()
    assert Search(LINE, **USUAL, seed=0).ask() != Search(LINE, **USUAL, seed=1).ask()


def test_asking_again_gives_the_queries_that_are_still_open():
    search = Search(LINE, **USUAL)
    queries = search.ask()
    assert search.ask() == queries
    search.tell(queries[0], [0.0, 0.0])
    with pytest.raises(UsageError, match=naming("query 0")):
        search.tell(queries[0], [0.0])


def test_both_engines_walk_the_same_way():
    ours, theirs = (
        searched(engine=name, mode="rigorous-simple").certificate() for name in ("spectral", "gpytorch")
    )
    assert (ours.rollouts, ours.worst) == (theirs.rollouts, theirs.worst)
    assert ours.lower == pytest.approx(theirs.lower, abs=1e-9)
    assert ours.upper == pytest.approx(theirs.upper, abs=1e-9)


def test_a_budget_ends_the_search_with_a_valid_interval_and_a_larger_one_goes_the_same_way():
    small, large = searched(budget=30), searched(budget=60)
    assert small.certificate().label is Label.BUDGET
    assert small.certificate().rollouts <= 30 < large.certificate().rollouts <= 60
    assert large.certificate().upper <= small.certificate().upper
    assert small.certificate().epsilon > 0.05


class TestRefusals:
    def test_a_norm_bound_below_twice_what_the_data_show(self):
        certificate = searched(norm=1.5).certificate()
        assert certificate.label is Label.REFUSED
        assert "B = 1.5" in certificate.reason
        assert 0.75 < certificate.B_low <= 1.5

    def test_a_norm_bound_that_the_data_refute_ends_the_search(self):
        search = searched(norm=1.5, B=0.5)
        assert search.done
        assert search.certificate().label is Label.REFUSED
        assert search.certificate().B_low > 0.5

    def test_a_proxy_that_the_replicates_refute(self):
        certificate = searched(noise=0.1, R=0.02).certificate()
        assert certificate.label is Label.REFUSED
        assert states(certificate.reason, "R = 0.02", "replicates")

    def test_bounds_that_contradict_each_other(self, monkeypatch):
        """Here the width itself is wrong: what later data say lies outside of what earlier data allowed."""
        honest = confidence.width
        monkeypatch.setattr(confidence, "width", lambda *args: honest(*args) / 20)
        certificate = searched(budget=2000, epsilon=0.001).certificate()
        assert certificate.label is Label.REFUSED
        assert "contradict each other" in certificate.reason

    def test_a_rollout_left_out(self):
        search = Search(LINE, **USUAL)
        first, *others = search.ask()
        search.tell(first, [])
        for query in others:
            search.tell(query, [0.0] * query.replicates)
        assert search.done
        assert search.certificate().label is Label.REFUSED
        assert "query 0" in search.certificate().reason


@pytest.mark.parametrize(
    ("changes", "facts"),
    [
        ({"B": 0}, ["B = 0"]),
        ({"R": -1}, ["R = -1"]),
        ({"epsilon": float("nan")}, ["epsilon = nan"]),
        ({"delta": 1}, ["delta = 1"]),
        ({"mode": "magic"}, ["'magic'", "rigorous"]),
        ({"engine": "magic"}, ["'magic'", "gpytorch, spectral"]),
        ({"epsilon": 3}, ["epsilon = 3", "B = 1.5"]),
        ({"R": 1e-9}, ["R = 1e-09", "B = 1.5", "100000"]),
        ({"seed": -1}, ["seed = -1"]),
        ({"spread": 0.5}, ["spread = 0.5"]),
        ({"budget": 2}, ["budget = 2", "8 rollouts"]),
    ],
)
def test_a_bad_setting_gets_a_sentence(changes, facts):
    with pytest.raises(UsageError, match=naming(*facts)):
        Search(LINE, **(USUAL | changes))


@pytest.mark.parametrize(
    ("outcomes", "facts"),
    [
        ([float("nan")], ["outcome 0", "query 0"]),
        ([1.0, 2.0, 3.0], ["query 0", "2", "3"]),
    ],
)
def test_a_bad_outcome_gets_a_sentence(outcomes, facts):
    search = Search(LINE, **USUAL)
    with pytest.raises(UsageError, match=naming(*facts)):
        search.tell(search.ask()[0], outcomes)


def test_an_empty_space_gets_a_sentence():
    with pytest.raises(UsageError, match="test space"):
        Search({}, **USUAL)
    with pytest.raises(UsageError, match=naming("'vd'", "[1, 1]")):
        Search({"vd": (1, 1)}, **USUAL)


def test_a_certificate_is_json():
    found = Search(LINE, **USUAL).certificate()
    values = json.loads(json.dumps(found.to_json()))
    assert (values["lower"], values["upper"], values["epsilon"]) == (found.lower, found.upper, found.epsilon)
    assert values["label"] == found.label.value
    assert [rung["B"] for rung in values["ladder"]] == [1.5, 3.0, 6.0, 12.0]


def test_two_dimensions():
    space = Space.of({"x": (0, 1), "y": (-1, 1)})
    kernel = Kernel("rbf", (0.5, 1.0))
    rng = np.random.default_rng(0)
    function = RandomFunction(kernel, space, 0.5, rng)
    search = Search(space, kernel=kernel, B=1.5, R=0.02, delta=0.1, epsilon=0.1)
    run(search, function, 0.02, rng)
    certificate = search.certificate()
    truth = function(space.grid((101, 101))).max()
    assert certificate.label is Label.CERTIFIED
    assert certificate.lower <= truth <= certificate.upper


def test_the_band_is_known_within_the_space_only():
    search = Search(LINE, **USUAL)
    for outside in ([[-0.3]], [[5.0]], [[0.0, 0.0]]):
        with pytest.raises(UsageError, match=naming("(n, 1)", "test space")):
            search.band(outside)


def test_a_forged_query_does_not_change_what_was_asked():
    search = Search(LINE, **USUAL)
    asked = search.ask()[0]
    with pytest.raises(UsageError, match=naming("2", "50")):
        search.tell(Query(asked.index, asked.point, 50), np.zeros(50))


@pytest.mark.parametrize("R", [1e-3, 2e-5])
def test_small_noise_costs_no_digits_that_matter(R):
    """The largest ratio B/R that is admitted: bounds hold at every step, and never contradict each other."""
    kernel = Kernel("rbf", 0.2)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        function = RandomFunction(kernel, LINE, 0.45, rng)
        search = Search(LINE, kernel=kernel, B=1.5, R=R, delta=0.1, epsilon=20 * R, seed=seed, budget=300)
        truth = function(LINE.grid((4001,))).max()
        while not search.done:
            for query in search.ask():
                mean = function(search.space.vector(query.point))[0]
                search.tell(query, mean + R * rng.normal(size=query.replicates))
            certificate = search.certificate()
            assert certificate.lower <= truth <= certificate.upper
            assert "contradict" not in certificate.reason
