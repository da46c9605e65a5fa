from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest

from s2r_spec.errors import BackendError, UsageError
from s2r_spec.runs.runner import Runner
from s2r_spec.runs.seeds import rollout_seed
from s2r_spec.runs.task import Task, open_backend, run_task
from s2r_spec.trace import Trace
from s2r_spec.workers.pools import process_pool
from tests.errors import naming

pytestmark = pytest.mark.usefixtures("toy")


def tasks(backend, speeds, **more):
    return [
        Task(i, 0, backend, {"vd": speed}, rollout_seed(0, i, 0), **more) for i, speed in enumerate(speeds)
    ]


def traces(factory, jobs):
    with Runner(factory) as runner:
        return {done.task.query: done for done in runner.run(jobs)}


def test_any_number_of_workers_and_any_executor_give_the_same_traces():
    jobs = tasks("toy", [-0.2, 0.0, 0.1, 0.3])
    one, two, threads = (
        traces(factory, jobs) for factory in (process_pool(1), process_pool(2), lambda: ThreadPoolExecutor(3))
    )
    for query in one:
        assert (
            one[query].trace["vx"].tobytes()
            == two[query].trace["vx"].tobytes()
            == threads[query].trace["vx"].tobytes()
        )


def test_only_the_channels_asked_for_come_back():
    found = traces(process_pool(1), tasks("toy", [0.1], channels=("vx",)))
    assert set(found[0].trace.channels) == {"vx"}


def test_a_channel_that_a_rollout_lacks_is_the_backends_fault_and_named_with_its_rollout():
    job = tasks("toy", [0.1], channels=("vx", "extr"))[0]
    with pytest.raises(BackendError, match=rf"'toy' .*'extr' .*'vd': 0\.1.*{job.seed}.*extra, vx") as caught:
        traces(process_pool(1), [job])
    assert caught.value.exit_code == 4


def test_a_test_with_a_parameter_that_the_backend_does_not_declare_is_not_run():
    """The toy itself would not mind: it reads vd alone."""
    job = replace(tasks("toy:raise", [0.1])[0], params={"vd": 0.1, "lod": 1.0})
    with pytest.raises(UsageError, match=r"'toy:raise' .*'lod'.*'load'"):
        run_task(job)


def test_meta_that_contains_itself_is_a_sentence(monkeypatch):
    meta: dict = {}
    meta["again"] = meta
    toy = open_backend("toy", None)
    monkeypatch.setattr(type(toy), "rollout", lambda *_: Trace([0.0, 1.0], {"vx": [0.0, 0.0]}, {}, meta))
    with pytest.raises(BackendError, match=naming("'toy'", "meta", "seed")):
        run_task(tasks("toy", [0.1])[0])


def test_a_spec_that_looks_further_than_rollouts_last_lengthens_them_or_says_so():
    assert open_backend("toy", 4.0).duration == 4.0
    with pytest.raises(BackendError, match=naming("'toy-short'", "4 s", "1.5 s")):
        open_backend("toy-short", 4.0)


def test_a_seed_depends_on_its_place_and_on_nothing_else():
    seeds = {rollout_seed(s, q, r) for s in range(3) for q in range(5) for r in range(5)}
    assert len(seeds) == 75
    assert rollout_seed(1, 2, 3) == rollout_seed(1, 2, 3)


def test_a_simulator_is_prepared_once_in_a_process_before_the_clock_of_its_rollouts(toy, monkeypatch):
    calls = []
    kind = type(open_backend("toy", None))
    monkeypatch.setattr(kind, "prepare", lambda self: calls.append(self.name), raising=False)
    monkeypatch.setattr("s2r_spec.runs.task._prepared", [])
    for seed in range(3):
        run_task(Task(0, seed, "toy", {"vd": 0.1}, seed))
    assert calls == ["toy"]
