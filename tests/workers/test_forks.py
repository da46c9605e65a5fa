"""Backends that fork, spawn and ignore SIGTERM: they answer, and when they are ended, nothing is left of them."""

import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from s2r_spec.errors import BackendError
from s2r_spec.runs.runner import Runner
from s2r_spec.runs.seeds import rollout_seed
from s2r_spec.runs.task import Task, run_task
from s2r_spec.workers import worker_process
from s2r_spec.workers.pools import ProcessPool, process_pool
from tests.errors import states
from tests.processes import lives, until

pytestmark = [
    pytest.mark.usefixtures("toy"),
    pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes as Linux shows them"),
]


def tasks(backend, speeds, **more):
    return [
        Task(i, 0, backend, {"vd": speed}, rollout_seed(0, i, 0), **more) for i, speed in enumerate(speeds)
    ]


def outcomes(jobs, **more):
    with Runner(process_pool(1), **more) as runner:
        return sorted(runner.run(jobs), key=lambda done: done.task.query)


def numbers(found):
    return [done.trace["vx"].tobytes() for done in found]


@pytest.mark.parametrize(
    "habit",
    ["pool", "fork", "twice", "copies", pytest.param("executor", marks=pytest.mark.slow),
     pytest.param("spawn", marks=pytest.mark.slow)],
)  # fmt: skip
def test_a_rollout_that_starts_processes_answers_once_and_in_its_place(habit, noted):
    speeds = [-0.1, 0.0, 0.1, 0.2]
    alone = [run_task(task)[0]["vx"].tobytes() for task in tasks("toy", speeds)]
    assert numbers(outcomes(tasks(f"forks:{habit}", speeds))) == alone


@pytest.mark.parametrize(
    ("habit", "count", "seconds"),
    [("pool", 3, 2), ("stubborn", 2, 2), pytest.param("executor", 3, 4, marks=pytest.mark.slow),
     pytest.param("spawn", 2, 20, marks=pytest.mark.slow), pytest.param("fork", 2, 4, marks=pytest.mark.slow)],
)  # fmt: skip
def test_a_rollout_that_hangs_in_processes_of_its_own_is_ended_with_all_of_them(habit, count, seconds, noted):
    found = outcomes(tasks(f"forks:{habit}-hang", [0.3, 0.1]), timeout=seconds / 10)
    hung, other = (done.failure for done in found)
    assert states(hung, "crash", f"{seconds} s")
    assert other is None
    assert len(noted()) == count
    assert len({group for _, group in noted()}) == 1
    assert not [pid for pid, _ in noted() if lives(pid)]


def test_a_worker_that_is_stopped_is_ended(noted, monkeypatch):
    pool = ProcessPool(1)
    try:
        first = pool.submit(os.getpid).result()
        os.kill(first, signal.SIGSTOP)
        with monkeypatch.context() as patch:
            patch.setattr(worker_process, "BEGINNING", 0.3)
            with pytest.raises(worker_process.WorkerDiedError):
                pool.submit(len, bytes(10**6)).result()
        assert not lives(first)
        assert pool.submit(abs, -1).result() == 1
    finally:
        pool.shutdown()


def test_a_process_that_leaves_the_group_is_named_and_not_hunted(noted, capfd):
    found = outcomes(tasks("forks:daemon", [0.1]))
    assert found[0].trace is not None
    ((pid, _),) = noted()
    assert lives(pid)
    said = capfd.readouterr().err
    assert f"{pid} (sleep 999)" in said
    assert said.count(str(pid)) == 1


def test_bytes_among_the_answers_are_no_answer(noted):
    with pytest.raises(BackendError, match="pipe"):
        outcomes(tasks("forks:writes", [0.1]))


PROGRAM = textwrap.dedent("""\
    import sys
    from s2r_spec.workers.pools import process_pool
    from s2r_spec.runs.runner import Runner
    from s2r_spec.runs.task import Task, run_task
    with Runner(process_pool(1)) as runner:
        list(runner.run([Task(0, 0, sys.argv[1], {"vd": 0.3}, 0)]))
    """)


@pytest.mark.parametrize(
    ("habit", "count", "number"), [("stubborn", 2, signal.SIGKILL), ("pool", 3, signal.SIGTERM)]
)
def test_when_s2r_is_killed_its_workers_end_with_all_that_they_started(habit, count, number, noted):
    s2r = subprocess.Popen([sys.executable, "-c", PROGRAM, f"forks:{habit}-hang"], start_new_session=True)
    until(lambda: len(noted()) == count)
    os.killpg(s2r.pid, number)
    assert s2r.wait(120) == -number
    until(lambda: not any(lives(pid) for pid, _ in noted()))
