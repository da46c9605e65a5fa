"""What a diagnosis will cost is printed before its first real rollout."""

from dataclasses import replace
from time import sleep

import pytest

import s2r_spec as s2r
from s2r_spec.diagnose.before import before_data
from s2r_spec.diagnose.data.campaign import smallest_with_held_out
from s2r_spec.diagnose.data.cost import of_library
from tests.diagnose.toy import TEST, Toy

TOY = s2r.parse_spec("param v in [0, 1]\nsignal x {N}\nrequire small: always[0, 0.9 s] (abs(x) <= 2 {N})")


class AnnouncedError(Exception):
    """Ends a diagnosis of which only the cost is looked at."""


class Announced:
    """A progress that keeps the cost, and the machines of all rollouts before it. It may end the diagnosis then."""

    def __init__(self, ran, end=False):
        self.ran, self.end, self.cost, self.before = ran, end, None, []

    def __call__(self, stage, done, of):
        pass

    def expect(self, cost):
        assert self.cost is None
        self.cost, self.before = cost, list(self.ran)
        if self.end:
            raise AnnouncedError


@pytest.fixture
def ran(monkeypatch):
    """Return a list that grows by the name of the backend with every rollout."""
    found, rollout = [], Toy.rollout

    def counted(self, params, seed):
        found.append(self)
        return rollout(self, params, seed)

    monkeypatch.setattr(Toy, "rollout", counted)
    return found


@pytest.mark.parametrize("budget", [10, smallest_with_held_out(1)])
def test_rollouts_and_held_out_tests_are_known_before_the_first(tmp_path, ran, budget):
    announced, machine = Announced(ran), Toy((("a", 0.5),))
    kept = {"cache": tmp_path, "folder": tmp_path / "real", "passive": True, "where": False}
    found = s2r.diagnose(TOY, Toy(), machine, budget, progress=announced, **kept)
    cost = announced.cost
    assert {one.added for one in announced.before} == {()}
    assert cost.real.rollouts == found.provenance["rollouts"] == budget
    assert cost.real.seconds == pytest.approx(budget * machine.cost)
    assert (cost.held_out > 0) == (found.provenance["held_out"] > 0) == (budget >= cost.enough)
    assert cost.simulated.rollouts <= len(ran)
    again = Announced(ran, end=True)
    with pytest.raises(AnnouncedError):
        s2r.diagnose(TOY, Toy(), machine, budget, progress=again, **kept)
    assert again.cost.real.rollouts == 0


@pytest.mark.parametrize("declared", [0.0, 1e-6, 100.0])
def test_the_time_of_simulations_is_measured(declared):
    class Slow(Toy):
        def rollout(self, params, seed):
            sleep(0.05)
            return super().rollout(params, seed)

    expected = of_library(Slow(cost=declared), {TEST: 40, replace(TEST, params=(("v", 0.1),)): 60})
    assert expected.rollouts == 100
    assert 5.0 <= expected.seconds <= 10.0
    assert of_library(Slow(), {TEST: 0}).seconds == 0.0


def test_recordings_cost_only_simulations(tmp_path, ran):
    machine = Toy()
    tests = [{"v": v / 11} for v in range(12)]
    rollouts = [(test, machine.rollout(test, seed)) for seed, test in enumerate(tests)]
    ran.clear()
    announced = Announced(ran)
    found = s2r.diagnose(TOY, Toy(), rollouts, cache=tmp_path, progress=announced, where=False)
    assert {one.added for one in announced.before} == {()}
    assert (announced.cost.real, announced.cost.enough) == (None, None)
    assert (announced.cost.held_out > 0) == (found.provenance["held_out"] > 0)
    again = Announced(ran, end=True)
    with pytest.raises(AnnouncedError):
        s2r.diagnose(TOY, Toy(), rollouts, cache=tmp_path, progress=again)
    assert again.cost.simulated.rollouts == 0 < announced.cost.simulated.rollouts


def test_before_the_data_only_simulations_cost(tmp_path, monkeypatch, ran):
    monkeypatch.setenv("S2R_CACHE", str(tmp_path))
    announced = Announced(ran)
    before_data(TOY, Toy(), progress=announced)
    assert {one.added for one in announced.before} == {()}
    assert (announced.cost.real, announced.cost.held_out) == (None, None)
    again = Announced(ran, end=True)
    with pytest.raises(AnnouncedError):
        before_data(TOY, Toy(), progress=again)
    assert again.cost.simulated.rollouts == 0 < announced.cost.simulated.rollouts
