"""A simulator whose rollouts depend on earlier ones, or on their process, gets no certificate."""

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import s2r_toy

import s2r_spec as s2r
from s2r_spec.errors import UsageError
from s2r_spec.report.recompute import recompute
from s2r_spec.runs import repeatability
from s2r_spec.runs.journal import Journal
from s2r_spec.trace import Trace
from s2r_spec.workers.pools import process_pool
from tests.cli.conftest import SPEC
from tests.errors import states

pytestmark = pytest.mark.usefixtures("toy")
TEXT = SPEC.replace("LIMIT", "0.1")
MEMORY, PROCESS = "memory", "random numbers"


def one_thread():
    return ThreadPoolExecutor(1)


HERE = {"budget": 8, "executor": one_thread}


@pytest.fixture
def spec(monkeypatch):
    monkeypatch.setattr(s2r_toy, "KEPT", {})
    return s2r.parse_spec(TEXT, "spec.stl")


def refused(run, *words, **keywords):
    """Return the sentences of a run that is refused as wrong input."""
    with pytest.raises(UsageError) as caught:
        run(*words, **keywords)
    assert caught.value.exit_code == 2
    return str(caught.value)


def repeats(folder):
    return json.loads((folder / "repeats" / "repeats.json").read_text())


@pytest.mark.usefixtures("new_interpreters")
@pytest.mark.parametrize(
    ("habit", "cause", "executor"),
    [
        ("counts", MEMORY, one_thread),
        ("recurrent", MEMORY, process_pool(1)),
        ("first", MEMORY, process_pool(2)),
        ("unseeded", PROCESS, one_thread),
    ],
    ids=["counts", "recurrent", "first", "unseeded"],
)
def test_a_simulator_that_is_not_repeatable_gets_no_certificate(spec, tmp_path, habit, cause, executor):
    said = refused(s2r.check, spec, f"toy:{habit}", tmp_path, budget=8, executor=executor)
    found = repeats(tmp_path)
    rollout = f"{found['query']}.{found['replicate']}"
    assert states(said, f"toy:{habit}", rollout, "vd", f"seed {found['seed']}", "vx", "t = 0 s", "m/s")
    assert (cause == MEMORY) == (MEMORY in said)
    assert (cause == PROCESS) == (PROCESS in said)
    # Neither does a report, nor the same run again, which runs nothing.
    lines = (tmp_path / "journal.jsonl").read_bytes()
    assert refused(s2r.check, spec, f"toy:{habit}", tmp_path, resume=True, **HERE) == said
    assert refused(recompute, tmp_path) == said
    assert (tmp_path / "journal.jsonl").read_bytes() == lines


def test_no_machine_runs_for_a_simulator_that_is_not_repeatable(spec, tmp_path):
    said = refused(s2r.certify, spec, "toy:counts", "toy", tmp_path, **HERE)
    assert states(said, "toy:counts")
    assert not (tmp_path / "gap").exists()


@pytest.mark.parametrize(("sim", "real"), [("toy:counts", "toy:drag"), ("toy", "toy:counts")])
def test_a_gap_needs_repeatable_simulators_on_both_sides(spec, tmp_path, sim, real):
    assert states(refused(s2r.gap, spec, sim, real, tmp_path, **HERE), "toy:counts")


def test_repeats_lie_apart_and_count_nowhere(spec, tmp_path):
    result = s2r.check(spec, "toy:cached", tmp_path, **HERE)
    assert result.certificate.rollouts == len(Journal.read(tmp_path)) == 8
    found = repeats(tmp_path)
    assert found["refused"] is None
    assert [row["place"] for row in found["repeats"]] == ["same-process", "new-process"]
    record = Journal.read(tmp_path).get(found["query"], found["replicate"])
    before = s2r.read_trace(tmp_path / record.trace)
    for row in found["repeats"]:
        again = s2r.read_trace(tmp_path / "repeats" / row["trace"])
        assert set(again.channels) == {"vx", "extra"}
        assert again["vx"].tobytes() == before["vx"].tobytes()
    assert not any("deterministic" in text for text in result.assumptions)


def test_a_resumed_run_repeats_only_what_its_journal_lacks(spec, tmp_path, monkeypatch):
    first = s2r.check(spec, "toy", tmp_path, **HERE)
    (tmp_path / "repeats" / "repeats.json").unlink()
    assert s2r.check(spec, "toy", tmp_path, resume=True, **HERE).certificate == first.certificate
    assert repeats(tmp_path)["refused"] is None
    monkeypatch.setattr(repeatability, "run_after", None)
    monkeypatch.setattr(repeatability, "run_afresh", None)
    assert s2r.check(spec, "toy", tmp_path, resume=True, **HERE).certificate == first.certificate


def test_a_damaged_result_of_repeats_is_named(spec, tmp_path):
    s2r.check(spec, "toy", tmp_path, **HERE)
    (tmp_path / "repeats" / "repeats.json").write_text("{}")
    assert states(refused(s2r.check, spec, "toy", tmp_path, resume=True, **HERE), "repeats.json")


def test_a_backend_that_is_not_deterministic_is_not_repeated_and_its_certificate_says_so(spec, tmp_path):
    toy = s2r_toy.Toy("unseeded")
    toy.deterministic = False
    result = s2r.check(spec, toy, tmp_path, **HERE)
    assert any(states(text, "toy:unseeded", "deterministic") for text in result.assumptions)
    assert recompute(tmp_path).result.assumptions == result.assumptions
    assert not (tmp_path / "repeats").exists()


def test_an_object_of_this_process_alone_is_repeated_here(spec, tmp_path):
    class Local(s2r_toy.Toy):
        pass

    result = s2r.check(spec, Local("cached"), tmp_path / "cached", budget=8)
    assert any(states(text, "toy:cached", "process") for text in result.assumptions)
    assert [row["place"] for row in repeats(tmp_path / "cached")["repeats"]] == ["same-process"]
    assert states(refused(s2r.check, spec, Local("counts"), tmp_path / "counts", budget=8), "vx")


def counting(params, seed):
    """Count the rollouts of this process in a channel that no requirement reads."""
    trace = s2r_toy.Toy().with_duration(1.5).rollout(params, seed)
    state = np.full(len(trace), float(next(s2r_toy.COUNT)))
    return Trace(trace.times, {"vx": trace["vx"], "state": state}, trace.units)


def test_a_memory_in_a_channel_that_no_requirement_reads_is_one(spec, tmp_path):
    said = refused(s2r.check, spec, s2r.FunctionBackend(counting), tmp_path, **HERE)
    assert states(said, "counting", "state", "t = 0 s")
