"""The same rollouts on processes of this machine and on a Dask cluster, with workers that die, hang and raise."""

import os
import signal
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from multiprocessing import get_context

import jsonschema
import pytest

from s2r_spec.backend import load_backend
from s2r_spec.base import errors
from s2r_spec.errors import BackendError, UsageError
from s2r_spec.runs import runner
from s2r_spec.runs.runner import Runner
from s2r_spec.runs.scorer import default_timeout
from s2r_spec.runs.seeds import rollout_seed
from s2r_spec.runs.task import Task, run_task
from s2r_spec.workers import pools, worker_process
from s2r_spec.workers.limits import Limit, TimeLimitError
from s2r_spec.workers.pools import dask_pool, process_pool
from tests.conftest import PLUGIN
from tests.errors import naming, states
from tests.processes import lives

pytestmark = pytest.mark.usefixtures("toy")

HARMLESS = [-0.1, 0.0, 0.1, 0.2]


@contextmanager
def dask_cluster(workers):
    distributed = pytest.importorskip("distributed", reason="the extra [dask] is not installed")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(PLUGIN), prepend=os.pathsep)
        # What another program's cluster logs is not what is tested here.
        quiet = {"n_workers": workers, "threads_per_worker": 2, "dashboard_address": ":0", "silence_logs": 50}
        with distributed.LocalCluster(**quiet) as cluster:
            yield cluster


@pytest.fixture(scope="module")
def cluster():
    with dask_cluster(2) as found:
        yield found


@pytest.fixture(params=["processes", "dask"])
def engine(request):
    """A factory of pools, and what tells the process ids of its workers."""
    if request.param == "processes":
        return process_pool(2), lambda: [one.pid for one in worker_process._workers]
    cluster = request.getfixturevalue("cluster")
    return dask_pool(cluster.scheduler_address), lambda: [
        nanny.process.pid for nanny in cluster.workers.values()
    ]


def tasks(backend, speeds, **more):
    return [
        Task(i, 0, backend, {"vd": speed}, rollout_seed(0, i, 0), **more) for i, speed in enumerate(speeds)
    ]


def outcomes(factory, jobs, **more):
    with Runner(factory, **more) as runner:
        return {done.task.query: done for done in runner.run(jobs)}


def numbers(found):
    return {query: done.trace["vx"].tobytes() for query, done in found.items() if done.trace is not None}


class Stub(Executor):
    """A pool that starts, and then has one answer to everything."""

    def __init__(self, answer):
        self.answer = answer

    def submit(self, function, *arguments):
        found = Future()
        if function is os.getpid:
            found.set_result(1)
        else:
            found.set_exception(self.answer)
        return found


def here(jobs):
    return {task.query: run_task(task)[0]["vx"].tobytes() for task in jobs}


def test_the_numbers_do_not_depend_on_the_engine(engine):
    jobs = tasks("toy", HARMLESS * 3)
    assert numbers(outcomes(engine[0], jobs)) == here(jobs)


def test_a_worker_that_segfaults_takes_nobody_with_it(engine):
    jobs = tasks("toy:die", [*HARMLESS, 0.3])
    found = outcomes(engine[0], jobs)
    assert found[4].failure == "crash: the worker died 3 times"
    assert numbers(found) == here(jobs[:4])


@pytest.mark.parametrize(
    ("habit", "timeout", "seconds", "clock"), [("hang", 0.5, 0.5, "CPU"), ("sleep", 0.1, 1, "wall")]
)
def test_a_rollout_that_hangs_is_ended_and_takes_nobody_with_it(engine, habit, timeout, seconds, clock):
    """One that computes has its limit in CPU time; one that sleeps, ten times as long on the wall clock."""
    jobs = tasks(f"toy:{habit}", [0.3, *HARMLESS])
    found = outcomes(engine[0], jobs, timeout=timeout)
    assert states(found[0].failure, "crash", f"{seconds} s", clock)
    assert found[0].seconds >= seconds
    assert numbers(found) == here(jobs[1:])


def test_a_rollout_that_waits_longer_than_its_cpu_limit_is_no_crash():
    """A busy computer lets a rollout wait, too."""
    jobs = tasks("toy:dozes", HARMLESS[:2])
    found = outcomes(process_pool(1), jobs, timeout=0.15)
    assert numbers(found) == here(jobs)
    assert all(done.seconds > 0.15 for done in found.values())


def test_on_a_cluster_too_a_rollout_that_hangs_in_processes_of_its_own_is_ended_with_them(cluster, noted):
    address = cluster.scheduler_address
    with import_module("distributed").Client(address, set_as_default=False) as client:
        client.run(exec, f"import os; os.environ['S2R_FORKS'] = {os.environ['S2R_FORKS']!r}")
    found = outcomes(dask_pool(address), tasks("forks:pool-hang", [0.3, 0.1]), timeout=0.3)
    assert states(found[0].failure, "crash", "3 s", "wall")
    assert found[1].failure is None
    assert len(noted()) == 3
    assert not [pid for pid, _ in noted() if lives(pid)]


def test_a_worker_that_is_killed_loses_nothing(engine):
    factory, workers = engine
    jobs = tasks("toy:slow", HARMLESS * 5)
    found = {}
    with Runner(factory) as runner:
        for done in runner.run(jobs):
            if not found:
                os.kill(workers()[0], signal.SIGKILL)
            found[done.task.query] = done
    assert numbers(found) == here(jobs)


def test_a_rollout_that_raises_arrives_as_a_sentence(engine):
    with pytest.raises(
        BackendError, match=naming("'toy:raise'", "ValueError", "gyroscope", "{'vd': 0.1}", "seed")
    ):
        outcomes(engine[0], tasks("toy:raise", [0.1]))


def test_another_model_on_the_worker_is_refused(engine):
    jobs = [replace(task, model_hash="toy-0") for task in tasks("toy", HARMLESS)]
    with pytest.raises(BackendError, match=naming("toy-0", "toy-1")):
        outcomes(engine[0], jobs)


def test_a_backend_that_does_not_open_is_no_rollout():
    task = tasks("toy", [0.1], timeout=0.5)[0]
    pool = Stub(TimeLimitError(Limit(60.5, opening=True), 60.5))
    with pytest.raises(BackendError, match=naming("'toy'", "60.5 s")):
        outcomes(lambda: pool, [task])


def test_a_pool_of_somebody_elses_works_too(monkeypatch):
    """It breaks as a whole, so that every rollout in flight is a suspect."""
    monkeypatch.setattr(runner, "STRIKES", 1)
    jobs = tasks("toy:die", [0.1, 0.3])
    found = outcomes(lambda: ProcessPoolExecutor(1, mp_context=get_context("spawn")), jobs)
    assert states(found[1].failure, "crash", "1")
    assert numbers(found) == here(jobs[:1])


def test_leaving_early_ends_what_is_running():
    with Runner(process_pool(2)) as runner:
        for _ in runner.run(tasks("toy:hang", [0.1, 0.3, 0.3])):
            break
    assert not worker_process._workers


class Lost:
    """What a worker cannot unpickle."""

    def __reduce__(self):
        return __import__, ("a_package_that_nobody_has",)


def test_one_child_after_another_thing():
    pool = pools.ProcessPool(1)
    try:
        assert pool.submit(os.write, 1, b"printed by a worker\n").result() == 20
        assert pool.submit(print, "again, and not between the answers").result() is None
        with pytest.raises(BackendError, match=naming("ModuleNotFoundError", "'a_package_that_nobody_has'")):
            pool.submit(print, Lost()).result()
        with pytest.raises(errors.UnknownBackendError, match=naming("'tay'", "toy")):
            pool.submit(load_backend, "tay").result()
        with pytest.raises(BackendError, match=naming("ValidationError", "'string'")):
            pool.submit(jsonschema.validate, 1, {"type": "string"}).result()  # its error cannot be unpickled
        with pytest.raises(worker_process.WorkerDiedError):
            pool.submit(os._exit, 1).result()
        assert pool.submit(abs, -1).result() == 1
    finally:
        pool.shutdown()


def test_a_scheduler_that_is_not_there(monkeypatch):
    pytest.importorskip("distributed", reason="the extra [dask] is not installed")
    monkeypatch.setattr(pools, "ANSWER", 0.3)
    with pytest.raises(BackendError, match=naming("tcp://127.0.0.1:1")):
        dask_pool("tcp://127.0.0.1:1")()
    with pytest.raises(UsageError, match=naming("somewhere", "tcp://")):
        dask_pool("somewhere")


def test_without_the_extra_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setattr(errors, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=naming("--scheduler", "distributed", "pip install", "[dask]")):
        dask_pool("tcp://127.0.0.1:1")


def test_a_program_has_a_generous_time_and_a_robot_any():
    toy = load_backend("toy")
    assert default_timeout(toy) == pytest.approx(60.01)
    toy.deterministic = False
    assert default_timeout(toy) == float("inf")


def test_a_scheduler_that_goes_away(cluster, monkeypatch):
    monkeypatch.setattr(pools, "ANSWER", 2.0)
    address = cluster.scheduler_address
    with Runner(dask_pool(address), timeout=60) as one:
        answers = one.run(tasks("toy:slow", HARMLESS * 50))
        next(answers)
        cluster.close()
        with pytest.raises(BackendError, match=naming(address)):
            list(answers)


def test_a_pool_that_is_kept_open_is_made_once_and_closed_once():
    made, closed = [], []

    class Counted(Executor):
        def submit(self, function, /, *arguments, **named):
            done: Future = Future()
            done.set_result(function(*arguments, **named))
            return done

        def shutdown(self, wait=True, *, cancel_futures=False):
            closed.append(self)

    def factory():
        made.append(Counted())
        return made[-1]

    with pools.keep_open(factory) as lend:
        for number in range(3):
            with lend() as pool:
                assert pool.submit(abs, -number).result() == number
        assert (len(made), len(closed)) == (1, 0)
    assert closed == made
    with pools.keep_open(factory):
        pass  # nobody asked for it
    assert len(made) == 1
    with pools.keep_open(None) as lend:
        assert lend is None
