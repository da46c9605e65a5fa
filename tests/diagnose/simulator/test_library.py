"""The response library of the cart: what is simulated once, and kept."""

from dataclasses import replace

import numpy as np
import pytest
from s2r_cart import Cart

from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import library, simulated_rows

TEST = Experiment.test({"vd": 0.6, "acc": 2.5})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def made(folder):
    return library(Cart(), [TEST], cache=Cache(folder))


def test_a_response_is_the_difference_that_an_effect_makes(made):
    response = made.response(TEST)
    number = [line.name for line in made.parameters].index("tilt.force")
    for coordinate in (-1.0, 1.0):
        machine = Cart().with_effects(made.parameters[number].at(made.parameters[number].value(coordinate)))
        runs = [
            response.observables.vector(TEST.run(m, 1000 + k)) for m in (machine, Cart()) for k in range(2)
        ]
        moved = np.mean(runs[:2], axis=0) - np.mean(runs[2:], axis=0)
        assert response.curves[number].at(coordinate) == pytest.approx(moved, abs=1e-6)


def test_coordinates_and_values_are_inverse(made):
    theta = np.array([0.5, 0.0, 0.2, -0.3, 0.7, 0.0, 0.1])
    assert made.coordinates(made.values(theta)) == pytest.approx(theta)
    assert made.coordinates({}) == pytest.approx(np.zeros(7))


def test_the_library_is_read_from_the_cache(made, folder, monkeypatch):
    def never(self, params, seed):
        raise AssertionError("the simulator ran")

    monkeypatch.setattr(Cart, "rollout", never)
    again = library(Cart(), [TEST], cache=Cache(folder))
    assert again.response(TEST).nominal == pytest.approx(made.response(TEST).nominal)
    assert again.response(TEST).curves[0].values == pytest.approx(
        made.response(TEST).curves[0].values, rel=1e-6
    )
    assert again.response(TEST).observables.groups == made.response(TEST).observables.groups


def test_nominal_runs_of_the_library_are_not_made_again(made, monkeypatch):
    (rows,) = simulated_rows(Cart(), made.responses, {}, runs=3)
    ran = [made.response(TEST).observables.vector(TEST.run(Cart(), 1000 + k)) for k in range(3)]
    assert rows == pytest.approx(np.array(ran), rel=1e-6, abs=1e-6)
    monkeypatch.setattr(Cart, "rollout", None)
    assert (simulated_rows(Cart(), made.responses, {}, runs=3)[0] == rows).all()


def test_a_declared_cost_changes_nothing(folder, made, monkeypatch):
    monkeypatch.setattr(Cart, "rollout", None)
    costly = replace(Cart(), cost=100.0)
    assert library(costly, [TEST], cache=Cache(folder)).response(TEST).nominal == pytest.approx(
        made.response(TEST).nominal
    )


def test_another_model_has_a_library_of_its_own(folder, made):
    heavier = Cart().with_effects({"payload": {"mass": 1.0}})
    other = library(heavier, [TEST], cache=Cache(folder))
    assert np.abs(other.response(TEST).nominal - made.response(TEST).nominal).max() > 0.01


def test_another_duration_and_another_source_have_libraries_of_their_own(tmp_path, made):
    """A cart's hash has neither: a library of another one would answer for it."""

    class Other(Cart):
        """The same cart, as code of another module."""

    cache = Cache(tmp_path)
    library(Cart(), [TEST], cache=cache)
    library(replace(Cart(), duration=1.0), [TEST], cache=cache)
    library(Other(), [TEST], cache=cache)
    assert len(list(tmp_path.glob("responses/*.npz"))) == 3


def test_a_damaged_cache_is_made_again(tmp_path, made):
    cache = Cache(tmp_path)
    first = library(Cart(), [TEST], cache=cache)
    (path,) = tmp_path.glob("responses/*.npz")
    path.write_bytes(path.read_bytes()[:1000])
    again = library(Cart(), [TEST], cache=cache)
    assert again.response(TEST).nominal == pytest.approx(first.response(TEST).nominal)
    assert any(str(path) in sentence for sentence in cache.notes)
