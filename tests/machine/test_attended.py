"""Rollouts of a machine: what happens to it, what the journal has, and what is never run again by itself."""

import json
import shutil
from dataclasses import dataclass, field
from pathlib import Path

import pytest

import s2r_spec as s2r
from s2r_spec import logs
from s2r_spec.base.json_values import document, to_json
from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.gap import gap
from s2r_spec.certify.measure import check_measure
from s2r_spec.certify.real_machine import certify
from s2r_spec.errors import BackendError, NotBegunError, StoppedError, UsageError
from s2r_spec.machine.attendance import Terms
from s2r_spec.machine.machine_runner import MachineRunner
from s2r_spec.report import check as check_report
from s2r_spec.report.recompute import recompute, recompute_gap
from s2r_spec.runs.journal import FILE, Journal, JournalError
from s2r_spec.runs.replay import replay
from s2r_spec.runs.runner import Runner
from s2r_spec.runs.task import Task, run_task
from s2r_spec.workers.pools import process_pool
from tests.cli.conftest import FINE
from tests.conftest import rewrite
from tests.errors import naming, states
from tests.report.conftest import one_thread, plugin


@dataclass
class Operator:
    """Says yes until ``answers`` says otherwise: "stop" ends the run at that question."""

    answers: list = field(default_factory=list)
    said: list = field(default_factory=list)
    there: bool = True

    def say(self, text):
        self.said.append(text)

    def type_word(self, question, word):
        self.choose(question, {word: ""})

    def choose(self, question, answers):
        self.said.append(question)
        if self.answers and self.answers.pop(0) == "stop":
            raise StoppedError("the operator stopped the run")
        return next(iter(answers))


@pytest.fixture
def robot(toy, tmp_path, monkeypatch):
    """Return what happened to the robot so far, a line each."""
    file = tmp_path / "robot.log"
    file.touch()
    monkeypatch.setenv("S2R_ROBOT", str(file))
    return lambda *kinds: [
        line for line in file.read_text().splitlines() if not kinds or line.split()[0] in kinds
    ]


def parsed():
    return s2r.parse_spec(FINE.replace("LIMIT", "0.1"), "spec.stl")


@pytest.fixture
def spec():
    return parsed()


@dataclass(frozen=True)
class Made:
    """A run of eight rollouts that was made once, its certificate, and a copy of its folder."""

    result: object
    folder: Path


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Runs of eight rollouts: one that nobody attends to, and one with an operator and a void rollout."""
    kept = tmp_path_factory.mktemp("made")
    with plugin(), pytest.MonkeyPatch.context() as patch:
        patch.setenv("S2R_ROBOT", str(kept / "robot.log"))
        runs = {}
        for name, habit in (("alone", "auto"), ("attended", "link=3")):
            (kept / "robot.log").write_text("")
            more = {} if name == "alone" else {"operator": Operator()}
            runs[name] = s2r.check(parsed(), f"robot:{habit}", kept / name, budget=8, **more)
    return kept, runs


@pytest.fixture
def alone(made, tmp_path):
    kept, runs = made
    return Made(runs["alone"], Path(shutil.copytree(kept / "alone", tmp_path / "r")))


@pytest.fixture
def attended(made, tmp_path):
    kept, runs = made
    return Made(runs["attended"], Path(shutil.copytree(kept / "attended", tmp_path / "attended")))


def lines(folder):
    return [json.loads(line) for line in (folder / FILE).read_text().splitlines()]


def kinds(folder):
    return [line.get("kind", "outcome") for line in lines(folder)[1:]]


def test_a_protocol_is_attended_to_like_a_test(robot, tmp_path):
    machine, person = s2r.load_backend("robot"), Operator()
    journal = Journal.create(tmp_path / "r", {"run": "protocols"}, {})
    with MachineRunner(machine, journal, None, Terms(operator=person), 2) as runner:
        tasks = [Task(0, k, "robot", {}, k, protocol="nod", timeout=60.0) for k in (1, 2)]
        traces = [done.trace for done in runner.run(tasks)]
    assert [trace.meta["protocol"] for trace in traces] == ["nod", "nod"]
    assert robot("before", "run") == ["before nod", "run nod 1", "before nod", "run nod 2"]
    assert any(states(text, "nods", "chin") for text in person.said)


def test_rollouts_run_one_at_a_time_in_one_process_whatever_the_pool(robot, spec, tmp_path):
    result = s2r.check(
        spec, "robot:auto", tmp_path / "r", budget=8, executor=process_pool(4), operator=Operator(there=False)
    )
    assert result.certificate.rollouts == 8
    assert result.voids == {}
    assert len({line.split()[-1] for line in robot("rollout")}) == 1
    order = [line.split()[0] for line in robot()]
    assert order == ["begin", *["prepare", "before", "rollout", "after"] * 8, "end"]
    assert robot("begin") == ["begin 8"]
    assert kinds(tmp_path / "r") == ["begun", "outcome"] * 8
    assert {path.name for path in (tmp_path / "r" / "raw").iterdir()} == {f"{n}.bytes" for n in range(1, 9)}


def test_the_outcomes_are_those_of_a_simulator_bit_for_bit(robot, spec, tmp_path):
    """Same seeds, same tests: what attends to a rollout changes no number."""
    machine = s2r.check(spec, "robot:auto", tmp_path / "r", budget=16)
    simulator = s2r.check(spec, "toy", tmp_path / "s", budget=16, executor=one_thread)
    assert (machine.lower, machine.upper, machine.worst) == (
        simulator.lower,
        simulator.upper,
        simulator.worst,
    )
    assert [record.rho for record in Journal.read(tmp_path / "r").records()] == [
        record.rho for record in Journal.read(tmp_path / "s").records()
    ]
    assert "voids" not in to_json(simulator)


def test_what_the_operator_answers_is_kept_with_the_rollout(alone, attended):
    begun = [line for line in lines(attended.folder) if line.get("kind") == "begun"]
    assert [line["answers"] for line in begun] == [{"battery": "full"}] * 9
    journal = Journal.read(attended.folder)
    (void,) = journal.voids
    assert void.rollout.answers == {"battery": "full"}
    for kept in (void.trace, journal.get(0, 0).trace):
        assert logs.read(attended.folder / kept).meta["answers"] == {"battery": "full"}
    assert not any("answers" in line for line in lines(alone.folder))


@pytest.mark.parametrize("answers", ["full", {"battery": 2}, None])
def test_answers_that_are_no_texts_are_no_line_of_a_journal(attended, answers):
    rewrite(attended.folder, lambda line: line | ({"answers": answers} if "answers" in line else {}))
    with pytest.raises(JournalError, match=naming(f"{FILE}:2", "answers")):
        Journal.read(attended.folder)


@pytest.mark.parametrize(("habit", "word"), [("link=3", "link"), ("die=3", "killed")])
def test_a_void_rollout_is_kept_and_its_test_runs_again(robot, spec, tmp_path, habit, word):
    operator = Operator()
    result = s2r.check(spec, f"robot:{habit}", tmp_path / "r", budget=40, operator=operator)
    assert result.voids == {word: 1}
    assert result.certificate.label.bounds
    all_runs = f"1 of {result.certificate.rollouts + 1}"
    assert any(states(text, word, all_runs) for text in result.assumptions)
    assert "the robot's clock is right" in result.assumptions
    ran = [line.split()[1:3] for line in robot("rollout")]
    assert ran[2] == ran[3]  # the same test and seed
    (void,) = Journal.read(tmp_path / "r").voids
    assert (void.rollout.key, void.rollout.attempt, void.word) == ((1, 0), 1, word)
    assert kinds(tmp_path / "r")[4:8] == ["begun", "void", "begun", "outcome"]
    assert lines(tmp_path / "r")[7]["attempt"] == 2
    if word == "link":
        trace = logs.read(tmp_path / "r" / void.trace)
        assert trace.meta["void"] == "link"
    # One question before each rollout, the consent, and one more after the void one.
    assert sum("void" in text for text in operator.said) == 1
    shown = json.loads(document(check_report.report([(spec, result)]).record))
    assert shown["results"][0]["voids"] == {word: 1}
    assert ("void", f"{all_runs} rollouts (1 × {word})") in check_report.finding(spec, result).facts
    again = recompute(tmp_path / "r").result
    assert (again.voids, again.assumptions, again.lower) == (result.voids, result.assumptions, result.lower)


def test_what_the_robot_ended_counts_whatever_else_came(robot, spec, tmp_path):
    result = s2r.check(spec, "robot:auto,fell=2,both=3", tmp_path / "r", budget=8)
    assert result.failures == {"fall": 2}
    assert result.voids == {}


def test_more_than_one_void_in_twenty_refuses_the_certificate(robot, attended):
    assert attended.result.certificate.label is Label.REFUSED
    assert states(attended.result.reason, "1", "20")
    assert attended.result.verdict.exit_code == 3
    assert recompute(attended.folder).result.certificate.label is Label.REFUSED


def test_counted_as_falls_voids_are_outcomes_and_one_refutes_the_proxy(robot, spec, tmp_path):
    counted = s2r.check(spec, "robot:auto,link=3", tmp_path / "r", budget=100, void="fall")
    assert counted.failures == {"void: link": 1}
    assert counted.voids == {}
    assert counted.lowest.rho == -0.5
    assert kinds(tmp_path / "r").count("void") == 0
    assert counted.certificate.label is Label.REFUSED
    assert "R = 0.02" in counted.reason
    again = s2r.check(spec, "robot:auto,link=3", tmp_path / "s", budget=100)
    assert again.certificate.label.bounds
    # Declared before the data: a run does not change its mind.
    with pytest.raises(JournalError, match="void"):
        s2r.check(spec, "robot:auto,link=3", tmp_path / "r", budget=100, resume=True)


def test_trouble_before_the_start_is_no_rollout_and_is_tried_again(robot, spec, tmp_path):
    operator = Operator()
    result = s2r.check(spec, "robot:shy=2,refuse", tmp_path / "r", budget=8, operator=operator)
    assert result.voids == {}
    assert kinds(tmp_path / "r")[:5] == ["begun", "outcome", "begun", "not begun", "begun"]
    assert sum("not begin" in text for text in operator.said) == 2
    assert len(robot("rollout")) == 9


def test_where_nobody_is_asked_trouble_before_the_start_ends_the_run_and_it_goes_on(robot, spec, tmp_path):
    with pytest.raises(NotBegunError, match="a leg is stuck"):
        s2r.check(spec, "robot:auto,shy=2", tmp_path / "r", budget=8)
    assert robot()[-1] == "end"
    result = s2r.check(spec, "robot:auto,shy=2", tmp_path / "r", budget=8, resume=True)
    assert result.certificate.rollouts == 8
    assert result.voids == {}


def test_where_nobody_is_asked_a_machine_that_is_out_of_order_is_left_alone(robot, spec, tmp_path):
    with pytest.raises(BackendError, match=naming("3", "rollout 0.1", "no state", "--resume")):
        s2r.check(spec, "robot:auto,link=2+3+4", tmp_path / "r", budget=8)
    assert len(Journal.read(tmp_path / "r").voids) == 3
    assert len(robot("rollout")) == 4


def test_an_error_of_the_backend_ends_the_run_and_the_rollout_is_void(robot, spec, tmp_path):
    with pytest.raises(BackendError, match="the gyroscope is upside down"):
        s2r.check(spec, "robot:auto,raise=4", tmp_path / "r", budget=8)
    assert [void.word for void in Journal.read(tmp_path / "r").voids] == ["error"]
    assert robot()[-1] == "end"


def test_a_machine_s_certificate_does_not_say_that_void_rollouts_are_counted(robot, alone, spec, tmp_path):
    simulated = s2r.check(spec, "toy", tmp_path / "toy", budget=8, executor=one_thread)
    for result, machine in ((alone.result, True), (simulated, False)):
        assert any("not void" in text for text in result.assumptions) == machine


def test_a_rollout_that_takes_too_long_is_ended_and_void(robot, spec, tmp_path):
    operator = Operator()
    # to stand up takes longer than the time-out, which counts from t = 0
    s2r.check(spec, "robot:slow=3,hang=2", tmp_path / "r", budget=8, timeout=1.0, operator=operator)
    assert [void.word for void in Journal.read(tmp_path / "r").voids] == ["killed"]
    assert len(robot("rollout")) == 9


def test_the_operator_stops_and_resumes(robot, spec, tmp_path):
    operator = Operator(answers=["yes"] * 4 + ["stop"])
    with pytest.raises(StoppedError, match="--resume") as caught:
        s2r.check(spec, "robot", tmp_path / "r", budget=8, operator=operator)
    assert caught.value.exit_code == 130
    assert len(robot("rollout")) == 3
    assert robot()[-1] == "end"
    result = s2r.check(spec, "robot", tmp_path / "r", budget=8, operator=Operator(), resume=True)
    assert robot("begin") == ["begin 8", "begin 5"]
    assert len(robot("rollout")) == 8
    assert result.voids == {}
    # All is there: the robot is left alone.
    s2r.check(spec, "robot", tmp_path / "r", budget=8, operator=Operator(), resume=True)
    assert len(robot("begin")) == 2


@pytest.mark.parametrize("void", ["again", "fall"])
def test_of_a_run_that_was_killed_the_rollout_is_void_and_asked_again(robot, spec, tmp_path, void):
    s2r.check(spec, "robot:auto", tmp_path / "r", budget=8, void=void)
    whole = (tmp_path / "r" / FILE).read_bytes().splitlines(keepends=True)
    # As a kill leaves it: begun, its trace even written, but without its line.
    (tmp_path / "r" / FILE).write_bytes(b"".join(whole[:12]))
    assert [begun.key for begun in Journal.read(tmp_path / "r").open] == [(2, 1)]
    before = len(robot("rollout"))
    result = s2r.check(spec, "robot:auto", tmp_path / "r", budget=8, void=void, resume=True)
    kept = Journal.read(tmp_path / "r")
    if void == "fall":
        assert kept.get(2, 1).failure == "void: killed"
        assert len(robot("rollout")) == before + 2
        return
    assert result.voids == {"killed": 1}
    assert logs.read(tmp_path / "r" / kept.voids[0].trace).times.size
    assert len(robot("rollout")) == before + 3
    assert (tmp_path / "r" / FILE).read_bytes().startswith(b"".join(whole[:12]))
    assert lines(tmp_path / "r")[13]["seed"] == json.loads(whole[11])["seed"]


def test_a_gap_counts_the_voids_of_the_machine(robot, spec, tmp_path):
    result = gap(
        spec, "toy", "robot:link=3", tmp_path / "g", budget=24, operator=Operator(), executor=one_thread
    )
    assert result.voids == {"link": 1}
    assert result.certificate.label.bounds
    assert any("1 × link" in text for text in result.assumptions)
    assert kinds(tmp_path / "g" / "sim").count("begun") == 0
    again = recompute_gap(tmp_path / "g").result
    assert (again.voids, again.assumptions) == (result.voids, result.assumptions)
    assert to_json(again)["voids"] == {"link": 1}


def test_without_a_terminal_nothing_is_opened(robot, spec, tmp_path):
    for run in (
        lambda: s2r.check(spec, "robot", tmp_path / "c", budget=8, operator=Operator(there=False)),
        lambda: certify(spec, "toy", "robot", tmp_path / "p", budget=8, operator=Operator(there=False)),
    ):
        with pytest.raises(UsageError, match="terminal"):
            run()
    assert robot() == []
    assert not (tmp_path / "p").exists()


@pytest.mark.parametrize(
    "run",
    [
        lambda spec, folder: gap(spec, "robot:auto", "toy", folder),
        lambda spec, folder: s2r.check(spec, "toy", folder, void="fall"),
        lambda spec, folder: s2r.check(spec, "robot:auto", folder, void="maybe"),
        lambda spec, folder: s2r.diagnose(spec, "cart", "robot:auto"),
    ],
    ids=["as-simulator", "void-of-none", "no-such-word", "diagnose"],
)
def test_what_a_machine_is_not_for_is_a_sentence(robot, spec, tmp_path, run):
    with pytest.raises(UsageError):
        run(spec, tmp_path / "r")
    assert robot() == []


def test_a_machine_that_names_no_attendance_waits_for_enter_before_each_rollout(robot, spec, tmp_path):
    operator = Operator()
    result = s2r.check(spec, "plain-robot", tmp_path / "r", budget=8, operator=operator)
    assert result.certificate.rollouts == 8
    assert sum("next test" in text for text in operator.said) == 8
    assert states(operator.said[0], "8 rollouts")
    with pytest.raises(UsageError, match="terminal"):
        s2r.check(spec, "plain-robot", tmp_path / "n", budget=8, operator=Operator(there=False))


def test_any_measure_of_a_machine_is_certified_alike(robot, tmp_path):
    search = s2r.Search(
        {"vd": (-0.2, 0.3)}, kernel=Kernel("rbf", 0.2), B=0.5, R=0.02, delta=1e-3, epsilon=0.05, budget=8
    )
    certificate = check_measure(
        lambda trace, params: 0.1 - abs(trace["vx"][-1] - params["vd"]),
        "aim",
        "robot:auto,link=3",
        search,
        tmp_path / "m",
        fall=-0.5,
    )
    assert certificate.label is Label.REFUSED
    assert states(certificate.reason, "1", "20")
    assert "the robot's clock is right" in certificate.assumptions


def test_no_pool_runs_a_machine(robot):
    task = Task(0, 0, "robot:auto", {"vd": 0.1}, 1)
    with pytest.raises(BackendError, match="operator"):
        run_task(task)
    with Runner(process_pool(1)) as runner, pytest.raises(BackendError, match="operator"):
        list(runner.run([task]))
    assert robot() == []


def test_a_replay_shows_what_was_recorded_and_sends_nothing(robot, spec, tmp_path):
    s2r.check(spec, "robot:auto,fell=2", tmp_path / "walking", budget=8)
    before = robot()
    found = replay(f"{tmp_path / 'walking'}#0.0")
    assert found.same
    assert not found.ran
    assert found.trace["extra"].shape == found.trace.times.shape
    assert replay(f"{tmp_path / 'walking'}#0.1").rho == -0.5
    with pytest.raises(UsageError, match="machine"):
        found.render(tmp_path / "x.png")
    (tmp_path / "walking" / "traces" / "00000.0000.npz").unlink()
    with pytest.raises(UsageError, match=naming("00000.0000.npz")):
        replay(f"{tmp_path / 'walking'}#0.0")
    assert robot() == before


@pytest.mark.parametrize(
    "change",
    [
        {"kind": "begun", "attempt": 0},
        {"kind": "begun", "seed": -1},
        {"kind": "begun", "more": 1},
        {"kind": "unknown"},
        {"kind": "void", "word": "link", "reason": "", "trace": "../x.npz", "seconds": 0.0},
        {"kind": "not begun", "reason": "x", "attempt": 9},
    ],
    ids=lambda change: "-".join(map(str, change.values())),
)
def test_a_line_that_is_none_is_named(alone, change):
    first = {"query": 0, "replicate": 0, "attempt": 1}
    rewrite(
        alone.folder,
        lambda line: line | change if {key: line.get(key) for key in first} == first else line,
    )
    with pytest.raises(JournalError, match=naming(f"{FILE}:2")):
        Journal.read(alone.folder)


def test_a_void_trace_that_was_exchanged_is_noticed(attended):
    journal = Journal.read(attended.folder)
    (void,) = journal.voids
    (attended.folder / void.trace).write_bytes(b"another")
    with pytest.raises(JournalError, match=naming(void.trace)):
        journal.check_traces()
