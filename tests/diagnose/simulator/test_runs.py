"""Runs of the simulator are kept as they end."""

from time import monotonic, sleep

import numpy as np
import pytest

from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.runs import HEALTHY, NOMINAL_PILOT, Job, kept, simulate
from tests.diagnose.toy import Toy

SHORT, LONG = Experiment.test({"v": 0.2}), Experiment.test({"v": 0.8})
PLACES = {SHORT: "responses/short.npz", LONG: "responses/long.npz"}
JOBS = [NOMINAL_PILOT, *(Job.of({"a": {"size": size}}, 2) for size in np.linspace(0.1, 3.0, 20).tolist())]
WANTED = {SHORT: JOBS[:8], LONG: JOBS}


class KilledError(Exception):
    pass


@pytest.fixture
def toy(monkeypatch):
    """Return a machine, and the sizes of what it ran; at one number of rollouts it calls a function."""
    ran, rollout, events = [], Toy.rollout, {}

    def counted(self, params, seed):
        ran.append((params["v"], dict(self.added).get("a", 0.0), seed))
        events.get(len(ran), lambda: None)()
        return rollout(self, params, seed)

    monkeypatch.setattr(Toy, "rollout", counted)
    return Toy(), ran, events


def whole(cache):
    """Return the number of rows that a cache has of either experiment."""
    found = kept(cache, PLACES)
    return {e: sum(map(len, found[e].rows.values())) if e in found else 0 for e in PLACES}


def stop():
    raise KilledError


def once_kept(cache, experiment):
    """Return the same, as soon as the calling process has written this experiment; it runs beside the rollouts."""
    end = monotonic() + 30.0
    while not whole(cache)[experiment] and monotonic() < end:
        sleep(0.01)
    return whole(cache)


def test_a_stopped_simulation_goes_on_with_all_runs_that_had_ended(tmp_path, toy):
    machine, ran, events = toy
    every = simulate(machine, WANTED, PLACES, Cache(tmp_path / "whole"))
    assert len(ran) == sum(len(job.seeds) for jobs in WANTED.values() for job in jobs) + 2 * HEALTHY == 78
    ran.clear()
    cache, seen = Cache(tmp_path / "stopped"), []
    events |= {76: lambda: seen.append(once_kept(cache, LONG)), 77: stop}
    with pytest.raises(KilledError):
        simulate(machine, WANTED, PLACES, cache)
    # The longer experiment ran first, and was kept while the other one ran.
    assert seen[0][LONG] == 44
    assert whole(cache) == {LONG: 44, SHORT: 16}
    events.clear()
    ran.clear()
    again = simulate(machine, WANTED, PLACES, cache)
    assert len(ran) == 2
    for experiment, jobs in WANTED.items():
        assert all(np.array_equal(again[experiment].rows[j], every[experiment].rows[j]) for j in jobs)
    ran.clear()
    simulate(machine, WANTED, PLACES, Cache(tmp_path / "stopped"))
    assert ran == []


def test_runs_that_are_wanted_later_join_the_earlier_ones(tmp_path, toy):
    machine, ran, _ = toy
    simulate(machine, {LONG: JOBS[:3]}, PLACES, Cache(tmp_path))
    ran.clear()
    simulate(machine, {LONG: JOBS[2:5]}, PLACES, Cache(tmp_path))
    assert len(ran) == 4
    assert whole(Cache(tmp_path)) == {LONG: 12, SHORT: 0}


def test_a_fall_of_the_nominal_simulator_is_an_error(tmp_path, monkeypatch):
    from dataclasses import replace

    from s2r_spec.base.errors import BackendError

    rollout = Toy.rollout

    def falls(self, params, seed):
        trace = rollout(self, params, seed)
        return replace(trace, meta={"failure": "fell"})

    monkeypatch.setattr(Toy, "rollout", falls)
    with pytest.raises(BackendError):
        simulate(Toy(), WANTED, PLACES, Cache(tmp_path))
