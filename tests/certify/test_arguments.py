"""What Python callers give by mistake is one sentence, before anything is run or with the rollout's name."""

from concurrent.futures import ThreadPoolExecutor
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.certify.gap import gap
from s2r_spec.certify.real_machine import certify
from s2r_spec.errors import BackendError, UsageError
from s2r_spec.report.recompute import recompute
from tests.cli.conftest import SPEC
from tests.errors import naming

pytestmark = pytest.mark.usefixtures("toy")


def one_thread():
    return ThreadPoolExecutor(1)


@pytest.fixture
def spec():
    return s2r.parse_spec(SPEC.replace("LIMIT", "0.1"), "spec.stl")


def search(**more):
    words = {
        "kernel": s2r.Kernel("rbf", 0.4),
        "B": 0.5,
        "R": 0.02,
        "delta": 1e-3,
        "epsilon": 0.5,
        "budget": 8,
    }
    return s2r.Search({"vd": (-0.2, 0.3)}, **words | more)


@pytest.mark.parametrize("given", [object(), None, 3, Path("toy")])
def test_what_is_no_backend_is_said_by_every_search(spec, tmp_path, given):
    for call in (
        lambda: s2r.check(spec, given, tmp_path),
        lambda: gap(spec, given, "toy", tmp_path),
        lambda: gap(spec, "toy", given, tmp_path),
        lambda: certify(spec, "toy", given, tmp_path),
        lambda: s2r.check_measure(lambda trace, test: 1.0, "m", given, search(), tmp_path, fall=-1.0),
    ):
        with pytest.raises(UsageError, match=naming("backend", "name")):
            call()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("given", [None, 3, object()])
def test_a_diagnosis_is_of_a_simulator_and_of_rollouts(spec, given):
    with pytest.raises(UsageError, match=naming("sim")):
        s2r.diagnose(spec, given, "toy")
    with pytest.raises(UsageError, match=naming("real")):
        s2r.diagnose(spec, "toy", given)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (None, "load_spec"),
        (3, "load_spec"),
        ("signal v\nrequire r: v > 0", "parse_spec"),
        ("no.stl", "no.stl"),
    ],
)
def test_what_is_no_specification_names_what_reads_one(tmp_path, given, words):
    with pytest.raises(UsageError, match=words):
        s2r.check(given, "toy", tmp_path)
    with pytest.raises(UsageError, match=words):
        s2r.diagnose(given, "toy", "toy:drag")


def test_a_file_is_a_specification_and_a_run_without_a_folder_gets_a_new_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("walk.stl").write_text(SPEC.replace("LIMIT", "0.1"))
    first, second = (
        s2r.check(given, "toy", budget=8, executor=one_thread) for given in ("walk.stl", Path("walk.stl"))
    )
    assert first.folder != second.folder
    assert {first.folder.parent, second.folder.parent} == {Path("s2r-runs")}
    assert "walk-toy-seed0" in first.folder.name
    assert first.certificate.upper == second.certificate.upper
    with pytest.raises(UsageError, match="folder"):
        s2r.check("walk.stl", "toy", resume=True)
    with pytest.raises(UsageError, match="stop"):
        gap("walk.stl", "toy", "toy:drag", stop="decided")
    assert len(list(Path("s2r-runs").iterdir())) == 2  # what is refused leaves no folder


def test_a_keyword_that_does_not_exist_is_answered_with_the_right_one(spec, tmp_path):
    for call in (
        lambda: s2r.check(spec, "toy", tmp_path, bugdet=8),
        lambda: gap(spec, "toy", "toy:drag", tmp_path, bugdet=8),
        lambda: certify(spec, "toy", "toy:drag", tmp_path, bugdet=8),
    ):
        with pytest.raises(UsageError, match="budget"):
            call()
    with pytest.raises(UsageError, match="fall"):
        s2r.check_measure(lambda trace, test: 1.0, "m", "toy", search(), tmp_path)


def test_workers_are_processes_in_place_of_an_executor(spec, tmp_path):
    with pytest.raises(UsageError, match=naming("workers", "executor")):
        s2r.check(spec, "toy", tmp_path, workers=1, executor=one_thread)
    with pytest.raises(UsageError, match="workers = 0"):
        s2r.check(spec, "toy", tmp_path, workers=0)
    found = s2r.check(spec, "toy", tmp_path / "run", budget=8, workers=1)
    assert found.certificate.rollouts == 8


@pytest.mark.parametrize("given", [3, b"bytes"])
def test_what_is_no_folder_is_said(spec, given):
    with pytest.raises(UsageError, match=naming("folder")):
        s2r.check(spec, "toy", given)


def test_a_folder_may_be_a_text_and_its_seconds_are_those_of_the_report(spec, tmp_path):
    found = s2r.check(spec, "toy", str(tmp_path / "run"), budget=8, executor=one_thread)
    assert found.folder == tmp_path / "run"
    again = s2r.check(spec, "toy", str(tmp_path / "run"), budget=8, executor=one_thread, resume=True)
    assert found.seconds == again.seconds == recompute(found.folder).result.seconds > 0


@pytest.mark.parametrize("made", [False, True])
def test_there_is_nothing_to_resume_in_a_folder_without_a_run(spec, tmp_path, made):
    if made:
        (tmp_path / "run").mkdir()
        (tmp_path / "run" / "notes.txt").write_text("not a run")
    folder = tmp_path / "run"
    for call in (
        lambda: s2r.check(spec, "toy", folder, resume=True),
        lambda: gap(spec, "toy", "toy:drag", folder, resume=True),
        lambda: certify(spec, "toy", "toy:drag", folder, resume=True),
        lambda: s2r.check_measure(lambda t, p: 1.0, "m", "toy", search(), folder, fall=-1.0, resume=True),
    ):
        with pytest.raises(UsageError, match=naming(str(folder))):
            call()
    assert not list(tmp_path.rglob("journal.jsonl"))


def raising(trace, test):
    raise KeyError("speed")


MEASURES = {
    "None": lambda trace, test: None,
    "type str": lambda trace, test: "0.3",
    "type str_": lambda trace, test: np.str_("0.3"),
    r"shape \(151,\)": lambda trace, test: trace["vx"],
    r"shape \(1,\)": lambda trace, test: np.array([0.3]),
    "type complex": lambda trace, test: 1j,
    "type list": lambda trace, test: [0.3],
    "ndarray": lambda trace, test: np.array(None),
    "KeyError: 'speed'": raising,
    "nan": lambda trace, test: float("nan"),
    "inf": lambda trace, test: np.float64("-inf"),
    "type int": lambda trace, test: 10**400,
}


@pytest.mark.parametrize("words", MEASURES)
def test_a_measure_that_gives_no_number_names_rollout_and_test_and_keeps_the_trace(tmp_path, words):
    with pytest.raises(BackendError, match=rf"rollout \d\.\d at vd = .*{words}") as caught:
        s2r.check_measure(MEASURES[words], "m", "toy", search(), tmp_path, fall=-1.0, executor=one_thread)
    assert "\n" not in str(caught.value)
    (kept,) = (tmp_path / "unscored").iterdir()
    assert str(kept) in str(caught.value)
    assert len(s2r.read_trace(kept)) == 151


@pytest.mark.parametrize("value", [1, True, np.float32(0.5), np.array(0.5), np.bool_(True), Decimal("0.5")])
def test_a_measure_may_give_any_number(tmp_path, value):
    found = s2r.check_measure(
        lambda trace, test: value, "m", "toy", search(B=5), tmp_path, fall=-1.0, executor=one_thread
    )
    assert found.rollouts == 8


@pytest.mark.parametrize("fall", [float("nan"), "-1", None])
def test_what_a_failed_rollout_is_worth_is_a_finite_number(tmp_path, fall):
    with pytest.raises(UsageError, match=naming("fall")):
        s2r.check_measure(lambda t, p: 1.0, "m", "toy", search(), tmp_path, fall=fall)


@pytest.mark.parametrize(
    "outcomes", [None, "0.1", ["a", "b"], [None, 0.1], [[0.1], [0.2, 0.3]], {"a": 1}, [1j], ["0.1", "0.2"]]
)
def test_a_search_is_told_numbers(outcomes):
    run = search()
    query = run.ask()[0]
    with pytest.raises(UsageError, match=f"query {query.index} at"):
        run.tell(query, outcomes)
    with pytest.raises(UsageError, match=naming("{'vd': 0.1}")):
        search().observe([({"vd": 0.1}, outcomes)])


def test_a_search_is_told_of_a_query():
    run = search()
    run.ask()
    with pytest.raises(UsageError, match="query"):
        run.tell(None, [0.1])
