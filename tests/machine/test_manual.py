"""A person as the backend: what is asked, what is refused and why, and what is in the folder after each step."""

import json
import os
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.backend import Backend, Coming, HasAttendance, Needs, NeedsSpec, is_exclusive
from s2r_spec.errors import NotBegunError, S2RError, StoppedError, TraceNote, UsageError
from s2r_spec.machine.manual import ManualBackend, checks
from s2r_spec.machine.manual.checks import RequestedTest, refusal
from s2r_spec.recordings.recorded import LogBackend
from s2r_spec.runs.journal import Journal
from s2r_spec.runs.scorer import Scorer
from s2r_spec.trace import Trace
from tests.errors import naming, states

SPEC = """\
signal vx {m/s}
signal q[2] {rad}
param vd {m/s} in [-0.2, 0.3]
param load {kg} = 2
require tracks: always[0 s, 2 s] (abs(vx - vd) <= 0.1 {m/s} and q[0] <= 3 {rad})
certify tracks: delta = 1e-3, epsilon = 0.05, B = 0.5, R = 0.02, kernel = rbf(0.2 {m/s}), fall = -0.5
"""
TEST = {"vd": 0.2, "load": 2.0}
TIMES = np.linspace(0.0, 2.0, 101)


def log(level=0.2, times=TIMES, **changes) -> Trace:
    """Return the log of a test at ``level`` m/s; a channel that is None is left out."""
    channels = {
        "vx": np.full(len(times), level),
        "q": np.zeros((len(times), 2)),
        "vx_cmd": np.full(len(times), level),
    }
    units = {"vx": "m/s", "q": "rad", "vx_cmd": "m/s"} | changes.pop("units", {})
    meta = changes.pop("meta", {})
    channels = {name: values for name, values in (channels | changes).items() if values is not None}
    return Trace(times, channels, {name: unit for name, unit in units.items() if name in channels}, meta)


@pytest.fixture
def spec():
    return s2r.parse_spec(SPEC, "spec.stl")


@pytest.fixture
def question(spec):
    return RequestedTest(TEST, Scorer.for_spec(spec, "tracks", "manual:nowhere").backend.needs, 2.0)


def shifted(step=1.0, gap=0.0) -> np.ndarray:
    return TIMES * step + np.where(TIMES > 1.0, gap, 0.0)


def test_the_log_of_the_test_is_accepted_in_any_unit_and_with_more_than_is_needed(question):
    assert refusal(log(), question) is None
    assert refusal(log(times=TIMES + 1e6, extra=TIMES), question) is None
    assert refusal(log(vx=np.full(101, 20.0), units={"vx": "cm/s"}), question) is None
    assert refusal(log(vx_cmd=None), question) is None
    assert refusal(log(times=np.arange(500) * 0.02), question) is None  # longer than needed
    assert refusal(log(meta={"params": {"vd": 0.2, "other": 7}}), question) is None


NAN = np.where(np.arange(101) == 50, np.nan, 0.2)


@pytest.mark.parametrize(
    ("trace", "facts"),
    [
        (log(meta={"params": {"vd": 0.1}}), ["vd = 0.1 m/s", "vd = 0.2 m/s"]),
        (log(vx=None), ["'vx'"]),
        (log(q=np.zeros((101, 3))), ["'q'", "3", "2"]),
        (log(q=np.zeros(101)), ["'q'", "1", "2"]),
        (log(units={"vx": "kg"}), ["vx", "kg", "m/s"]),
        (log(units={"vx": "furlongs"}), ["vx", "furlongs"]),
        (log(times=TIMES * 1000), ["2000 s", "20 s", "2 s", "time-unit=ms"]),
        (log(times=TIMES / 2), ["1 s", "2 s"]),
        (log(times=np.array([0.0])), ["0 s", "2 s"]),
        (log(times=shifted(gap=0.5)), ["0.52 s"]),
        (log(vx=NAN), ["'vx'", "1 s", "nan=hold"]),
        (log(0.2, vx_cmd=np.full(101, 0.1)), ["vx_cmd", "0.1 m/s", "vd = 0.2 m/s"]),
        (log(0.2, vx_cmd=None, vd_cmd=np.full(101, 0.3)), ["vd_cmd", "0.3 m/s", "vd = 0.2 m/s"]),
        (log(0.2, vx_cmd=None, vd=np.full(101, 0.3)), ["vd", "0.3 m/s", "vd = 0.2 m/s"]),
        (log(0.2, vx_cmd=np.full(101, 30.0), units={"vx_cmd": "cm/s"}), ["vx_cmd", "0.3 m/s"]),
        (log(0.2, units={"vx_cmd": "kg"}), ["vx_cmd", "kg"]),
        (log(0.2, load_cmd=np.full(101, 3.0)), ["load_cmd", "3 kg", "load = 2 kg"]),
        (log(0.2, vx_cmd=np.where(TIMES < 1.5, 0.2, 0.0)), ["vx_cmd", "0 m/s", "1.52 s", "vd = 0.2 m/s"]),
        (log(0.2, vx_cmd=np.where(TIMES < 1.5, 20.0, 15.0), units={"vx_cmd": "cm/s"}), ["vx_cmd", "0.15 m/s"]),
        (log(vx=np.where(TIMES > 1.0, np.inf, 0.2)), ["inf"]),
        (log(0.1, meta={"failure": "fall"}), ["vx_cmd", "0.1 m/s"]),
    ],
)  # fmt: skip
def test_a_log_that_is_not_of_the_test_is_refused_with_the_reason(question, trace, facts):
    said = refusal(trace, question)
    assert states(said, *facts), said


def test_what_is_measured_is_no_command_and_a_ramp_is_the_command_it_ends_at(question):
    measured = log(0.2, vd=0.1 + 0.01 * TIMES)
    assert refusal(measured, question) is None
    ramp = log(0.2, vx_cmd=np.minimum(0.2, 0.5 * TIMES))
    assert refusal(ramp, question) is None
    noisy = log(0.2, vx_cmd=0.2 + 0.01 * np.random.default_rng(0).normal(size=101))
    assert refusal(noisy, question) is None
    after = log(0.2, times=np.linspace(0, 8, 401), vx=np.full(401, 0.2), q=np.zeros((401, 2)), vx_cmd=None)
    assert refusal(after, question) is None


def test_what_failed_is_judged_by_no_sample(question):
    assert refusal(log(times=TIMES / 2, vx=None, meta={"failure": "fall"}), question) is None
    let_go = log(0.2, vx_cmd=np.where(TIMES < 1.5, 0.2, 0.0), meta={"failure": "fall"})
    assert refusal(let_go, question) is None


def test_a_spec_that_looks_at_the_whole_rest_takes_a_log_of_any_length():
    text = SPEC.replace("always[0 s, 2 s]", "always")
    backend = Scorer.for_spec(s2r.parse_spec(text, "spec.stl"), "tracks", "manual:nowhere").backend
    question = RequestedTest(TEST, backend.needs, backend.duration)
    assert backend.duration == 0.0
    for seconds in (0.5, 100.0):
        assert refusal(log(times=np.linspace(0, seconds, 101)), question) is None
    assert states(refusal(log(times=shifted(gap=0.5)), question), "0.52 s")
    assert states(refusal(log(vx_cmd=np.full(101, 0.1)), question), "vx_cmd", "0.1 m/s")


def test_a_failed_log_gets_the_channels_that_it_lacks(question):
    trace = checks.in_common_form(
        log(vx=None, q=np.zeros((101, 3)), meta={"failure": "fall"}), question.needs.channels
    )
    assert np.isnan(trace["vx"]).all()
    assert trace["q"].shape == (101, 2)
    assert trace.units["vx"] == "m/s"
    assert trace.failure == "fall"


@dataclass
class Script:
    """An operator whose every answer is a key and what was done before it was typed; then the run is stopped."""

    answers: list = field(default_factory=list)
    said: list = field(default_factory=list)
    asked: list = field(default_factory=list)
    paths: list = field(default_factory=list)

    def say(self, text):
        self.said.append(text)

    def choose(self, question, answers):
        self.asked.append(question)
        if not self.answers:
            raise StoppedError("the operator stopped the run")
        key, act = self.answers.pop(0)
        assert key in answers
        if act is not None:
            act()
        return key

    def line(self, question):
        return self.paths.pop(0)


class Desk:
    """A folder, a person, and what a runner does with them."""

    def __init__(self, spec, options=""):
        self.root = Path("night")
        self.name = f"manual:{self.root}{options}"
        self.backend = Scorer.for_spec(spec, "tracks", self.name).backend
        self.operator = Script()
        self.attended = None
        self.seed = 100

    def drop(self, trace, name="log.csv"):
        """Return what puts a log into the folder."""
        return lambda: s2r.write_trace(trace, self.root / "incoming" / name)

    def begin(self):
        self.attended = self.backend.attendance(self.operator)
        self.attended.begin(Coming(30))

    def run(self, *answers, params=TEST, seed=None):
        """Ask for one test and hand it to a worker; return its trace, after a look at the folder as ``log:``."""
        self.operator.answers = list(answers)
        if self.attended is None:
            self.begin()
        self.attended.before(params)
        assert not self.operator.answers
        self.seed += 1
        trace = self.worker().rollout(params, self.seed if seed is None else seed)
        self.attended.after(trace)
        return trace

    def worker(self):
        """Return the backend as a worker opens it: by its name alone."""
        backend = s2r.load_backend(self.name).with_duration(2.0)
        assert backend.model_hash == self.backend.model_hash
        return backend

    def again(self):
        """Go on as a new process does."""
        self.attended.end()
        self.attended = None

    @property
    def recordings(self):
        return LogBackend(str(self.root)).recordings

    @property
    def rows(self):
        return (self.root / "rollouts.csv").read_text().splitlines()


@pytest.fixture
def desk(spec, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    desk = Desk(spec)
    yield desk
    if desk.attended is not None:
        desk.attended.end()


def enter(act=None):
    return "", act


def test_the_backend_says_what_it_is_and_constructing_it_makes_nothing(desk, spec):
    assert isinstance(desk.backend, Backend)
    assert isinstance(desk.backend, NeedsSpec)
    assert isinstance(desk.backend, HasAttendance)
    assert is_exclusive(desk.backend)
    assert [(c.name, c.unit, c.width) for c in desk.backend.channels] == [("vx", "m/s", 1), ("q", "rad", 2)]
    assert [(p.name, p.unit, p.low, p.high) for p in desk.backend.parameters] == [
        ("vd", "m/s", -0.2, 0.3),
        ("load", "kg", 2, 2),
    ]
    assert desk.backend.duration == 2.0
    s2r.load_backend(desk.name).channels  # noqa: B018
    assert not list(Path().iterdir())
    for name in ("manual", "manual:", "manual:x?colour=red"):
        with pytest.raises(UsageError):
            Scorer.for_spec(spec, "tracks", name)
    with pytest.raises(UsageError, match="specification"):
        s2r.load_backend("manual:night").attendance(Script())


def test_a_log_is_accepted_recorded_and_read_back_as_it_was(desk):
    trace = desk.run(enter(desk.drop(log())))
    assert np.array_equal(trace["vx"], log()["vx"])
    assert trace.meta["params"] == TEST
    assert desk.rows == ["id,vd [m/s],load [kg],seed", "0001,0.2,2.0,101"]
    (recording,) = desk.recordings
    assert recording.params == TEST
    assert np.array_equal(recording.trace["q"], log()["q"])
    assert not list((desk.root / "incoming").iterdir())
    assert (desk.root / "originals" / "0001-log.csv").exists()


@pytest.mark.parametrize("name", ["a.csv", "a.npz", "a.parquet", "A.CSV"])
def test_every_format_is_taken_and_stays_what_it_is(desk, name):
    if name.endswith("parquet"):
        pytest.importorskip("pyarrow")
    desk.run(enter(desk.drop(log(), name)))
    assert (desk.root / f"0001{Path(name).suffix.lower()}").exists()
    assert len(desk.recordings) == 1


def test_logs_of_other_units_and_names_make_one_folder_that_needs_no_options(spec, desk):
    other = Desk(spec, "?time-unit=ms&map=t=stamp&map=vx=speed&map=vd_cmd=asked&nan=hold")
    text = "stamp,speed [cm/s],q_0,q_1,asked [cm/s],note\n"
    text += "".join(f"{20 * i},{20 + 0.01 * i if i != 7 else ''},0,{i},20,x\n" for i in range(101))

    def foreign():
        (other.root / "incoming" / "a.csv").write_text(text)

    first = other.run(enter(foreign))
    assert first.duration == pytest.approx(2.0)
    assert first["vx"][100] == pytest.approx(0.21)
    assert first["vx"][7] == first["vx"][6]
    text = text.replace(",20,x", ",10,x")
    other.operator.answers = [enter(foreign)]
    with pytest.raises(StoppedError):
        other.attended.before(TEST)
    assert any(states(text, "vd_cmd", "0.1 m/s") for text in other.operator.said)
    other.again()
    desk.run(enter(desk.drop(log())))
    with pytest.warns(TraceNote) as notes:
        backend = LogBackend(str(desk.root))
    assert any(states(str(note.message), "vd_cmd") for note in notes)  # only one of them has it
    units = {channel.name: channel.unit for channel in backend.channels}
    assert (units["vx"], units["q"]) == ("m/s", "rad")
    assert len(backend.recordings) == 2


def test_what_is_refused_is_asked_again_and_kept(desk):
    wrong = (
        log(0.1),
        log(times=TIMES / 2),
        log(vx=None),
        log(vx_cmd=np.full(101, 0.3)),
        log(times=TIMES * 1000),
    )
    answers = [enter(desk.drop(trace)) for trace in (*wrong, log())]
    desk.run(*answers)
    assert len(desk.operator.asked) == 6
    assert sum(states(text, "log.csv", "refused") for text in desk.operator.said) == 5
    assert len(list((desk.root / "refused").iterdir())) == 5
    assert len(desk.recordings) == 1


def test_an_unreadable_log_none_and_several_are_said(desk):
    incoming = desk.root / "incoming"
    desk.run(
        enter(),
        enter(lambda: (incoming / "a.csv").write_text("nonsense")),
        enter(lambda: (desk.drop(log(), "a.csv")(), desk.drop(log(), "b.csv")())),
        enter(lambda: (incoming / "b.csv").unlink()),
    )
    for facts in ((str(incoming), "no log"), ("a.csv", "refused"), ("a.csv", "b.csv")):
        assert any(states(text, *facts) for text in desk.operator.said), facts
    assert len(desk.recordings) == 1


def test_a_path_can_be_typed_and_its_file_stays(desk, tmp_path):
    s2r.write_trace(log(), tmp_path / "far.npz")
    s2r.write_trace(log(0.1), tmp_path / "wrong.npz")
    desk.operator.paths = ["nowhere.npz", str(tmp_path / "wrong.npz"), str(tmp_path / "far.npz")]
    desk.run(("p", None), ("p", None), ("p", None))
    assert (tmp_path / "far.npz").exists()
    assert (tmp_path / "wrong.npz").exists()
    assert len(desk.recordings) == 1


def test_a_name_that_a_format_cannot_hold_costs_no_rollout(spec, desk):
    other = Desk(spec, "?map=t=stamp")
    one = log(vx=0.2 + 0.01 * TIMES)
    names = ["stamp", "vx [m/s]", "q_0", "q_1", "vx_cmd", "t"]
    columns = [TIMES, one["vx"], *one["q"].T, one["vx_cmd"], TIMES + 7]

    def foreign():
        rows = [
            ",".join(names),
            *(",".join(map(repr, map(float, row))) for row in zip(*columns, strict=True)),
        ]
        (other.root / "incoming" / "a.csv").write_text("\n".join(rows) + "\n")

    assert np.array_equal(other.run(enter(foreign))["vx"], one["vx"])
    other.again()
    assert [path.suffix for path in desk.root.glob("0001*")] == [".npz"]
    assert set(desk.recordings[0].trace.channels) == {"vx", "q"}


def test_a_log_counts_once(desk):
    desk.run(enter(desk.drop(log(vx=0.2 + 0.01 * TIMES))))
    again = desk.drop(log(vx=0.2 + 0.01 * TIMES), "other.npz")
    desk.run(enter(again), enter(desk.drop(log(vx=0.2 - 0.01 * TIMES))))
    assert "earlier test" in " ".join(desk.operator.said)
    desk.again()
    desk.run(enter(again), enter(desk.drop(log(vx=0.2 - 0.02 * TIMES))))
    assert len(desk.recordings) == 3


def test_a_log_that_goes_on_from_an_earlier_one_is_that_one_again(desk):
    """As of a recorder that was not stopped between two tests: what the spec looks at is the first test."""
    times = np.arange(301) * 0.02
    vx = 0.2 + 0.01 * np.sin(times)

    def until(count):
        return log(times=times[:count], vx=vx[:count], q=np.zeros((count, 2)), vx_cmd=np.full(count, 0.2))

    desk.run(enter(desk.drop(until(110))))
    desk.run(enter(desk.drop(until(201))), enter(desk.drop(log(vx=0.2 - 0.01 * TIMES))))
    assert "earlier test" in " ".join(desk.operator.said)
    desk.again()
    desk.run(enter(desk.drop(until(301))), enter(desk.drop(log(vx=0.2 - 0.02 * TIMES))))
    assert len(desk.recordings) == 3


def test_of_a_log_that_is_a_link_the_original_is_kept(desk, tmp_path):
    s2r.write_trace(log(), tmp_path / "far.csv")
    desk.run(enter(lambda: (desk.root / "incoming" / "log.csv").symlink_to(tmp_path / "far.csv")))
    (kept,) = (desk.root / "originals").iterdir()
    assert not kept.is_symlink()
    assert kept.read_text() == (tmp_path / "far.csv").read_text()
    assert not list((desk.root / "incoming").iterdir())


def test_falls_are_failures_of_the_log_folder_whether_there_is_a_log_or_not(desk, spec):
    desk.run(("f", None))
    assert desk.recordings[0].trace.failure == "fall"
    desk.run(("f", None), seed=7)
    desk.run(enter(desk.drop(log())))
    short = log(vx=0.2 + 0.01 * TIMES, times=TIMES / 4)
    trace = desk.run(("f", desk.drop(short)), ("y", None))
    assert trace.failure == "fall"
    assert trace.duration == 0.5
    own = log(times=TIMES / 3, meta={"failure": "torque"}, units={"q": "no unit at all"})
    assert desk.run(enter(desk.drop(own))).failure == "torque"
    desk.run(("f", desk.drop(log(0.2, vx=0.2 + 0.02 * TIMES))), ("n", None))
    assert [recording.trace.failure for recording in desk.recordings] == [
        "fall", "fall", None, "fall", "torque", "fall",
    ]  # fmt: skip
    scorer = Scorer.for_spec(spec, "tracks", f"log:{desk.root}")
    assert {channel.name for channel in scorer.backend.channels} == {"vx", "q", "vx_cmd"}


def test_a_broken_robot_is_no_rollout_and_the_same_test_is_asked_again(desk):
    desk.run(("s", None), enter(), enter(desk.drop(log())))
    assert len(desk.recordings) == 1
    assert len((desk.root / "skipped.txt").read_text().splitlines()) == 2


def test_a_test_without_a_log_is_void_and_no_recording(desk):
    trace = desk.run(("n", None))
    assert trace.meta["void"] == "log"
    assert not (desk.root / "rollouts.csv").exists()
    desk.run(enter(desk.drop(log())))
    assert len(desk.recordings) == 1


def test_to_stop_keeps_the_test_and_what_was_recorded(desk):
    desk.run(enter(desk.drop(log())))
    with pytest.raises(StoppedError):
        desk.run(params={"vd": 0.1, "load": 2.0})
    asked = json.loads((desk.root / "next.json").read_text())
    assert (asked["id"], asked["params"], asked["seconds"]) == ("0002", {"vd": 0.1, "load": 2.0}, 2.0)
    desk.again()
    desk.run(enter(desk.drop(log(0.1))), params={"vd": 0.1, "load": 2.0})
    assert [row.split(",")[0] for row in desk.rows] == ["id", "0001", "0002"]


def killed_after(desk, name, monkeypatch):
    """Accept a log, and be killed when a method of the folder is called: before it, or after it."""
    from s2r_spec.machine.manual import table
    from s2r_spec.machine.manual.folder import TestFolder

    class Killed(BaseException):
        pass

    def kill(*_, **__):
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(table if name == "add" else TestFolder, name, kill)
        with pytest.raises(Killed):
            desk.run(enter(desk.drop(log())))
    desk.again()


def test_a_log_that_was_taken_before_a_kill_is_not_asked_for_again(desk, monkeypatch):
    from s2r_spec.machine.manual import folder

    desk.begin()
    real = folder.TestFolder.write

    def fails(self, step, about):
        if step.state == "accepted":
            raise KeyboardInterrupt
        return real(self, step, about)

    with monkeypatch.context() as patch:
        patch.setattr(folder.TestFolder, "write", fails)
        with pytest.raises(KeyboardInterrupt):
            desk.run(enter(desk.drop(log())))
    desk.again()
    desk.run()
    assert len(desk.recordings) == 1


@pytest.mark.parametrize("method", ["record", "add", "close"])
def test_a_kill_at_any_point_after_the_log_was_accepted_loses_nothing_and_asks_nothing_twice(
    desk, monkeypatch, method
):
    killed_after(desk, method, monkeypatch)
    desk.begin()
    if (desk.root / "rollouts.csv").exists():
        assert len(desk.recordings) == 1
    desk.run(seed=101)
    assert len(desk.recordings) == 1
    assert desk.rows[1:] == ["0001,0.2,2.0,101"]
    desk.run(enter(desk.drop(log(vx=0.2 + 0.01 * TIMES))))
    assert len(desk.recordings) == 2


def test_a_recorded_log_is_never_the_outcome_of_another_rollout(desk, monkeypatch):
    killed_after(desk, "close", monkeypatch)
    desk.begin()
    desk.attended.before(TEST)
    with pytest.raises(NotBegunError):
        desk.worker().rollout(TEST, 102)  # the next replicate of the same test
    desk.run(enter(desk.drop(log(vx=0.2 + 0.01 * TIMES))), seed=102)
    assert [row.rpartition(",")[2] for row in desk.rows] == ["seed", "101", "102"]


def test_without_an_accepted_log_there_is_no_rollout(desk):
    desk.begin()
    for _ in range(2):
        with pytest.raises(NotBegunError):
            desk.worker().rollout(TEST, 1)
        with pytest.raises(StoppedError):
            desk.attended.before(TEST)


def test_an_accepted_log_of_a_run_that_is_gone_is_no_rollout_of_another(desk):
    desk.begin()
    desk.operator.answers = [enter(desk.drop(log()))]
    desk.attended.before(TEST)
    desk.again()
    desk.run(enter(desk.drop(log(0.1))), params={"vd": 0.1, "load": 2.0})
    assert [recording.params["vd"] for recording in desk.recordings] == [0.1]
    assert len(list((desk.root / "originals").iterdir())) == 2


def test_a_log_that_was_changed_after_it_was_accepted_is_asked_for_again(desk):
    desk.begin()
    desk.operator.answers = [enter(desk.drop(log()))]
    desk.attended.before(TEST)
    (desk.root / "originals" / "0001-log.csv").unlink()
    desk.run(enter(desk.drop(log())))
    assert len(desk.recordings) == 1


def test_a_kill_while_an_outcome_is_handed_over_makes_nothing_void(desk, spec):
    class Runs(Script):
        def choose(self, question, answers):
            self.asked.append(question)
            if len(self.asked) == 3:
                raise StoppedError("the operator stopped the run")
            level = json.loads((desk.root / "next.json").read_text())["params"]["vd"]
            desk.drop(log(vx=level + 1e-3 * len(self.asked) * TIMES, vx_cmd=None))()
            return ""

    for resume in (False, True):
        with pytest.raises(StoppedError):
            s2r.check(spec, desk.name, "run", budget=20, operator=Runs(), resume=resume)
        journal = Journal.read(Path("run"))
        assert len(journal) == 2 * (1 + resume)
        if not resume:
            journal.begin((9, 0), {"vd": 0.0}, 1)
    assert journal.voids == ()
    assert journal.open == ()
    assert len(desk.recordings) == 4


def test_two_runs_do_not_share_a_folder(desk, spec):
    import subprocess
    import sys

    desk.begin()
    code = "import fcntl, sys; fcntl.flock(open(sys.argv[1]), fcntl.LOCK_EX | fcntl.LOCK_NB)"
    lock = [sys.executable, "-c", code, str(desk.root / "lock")]
    assert subprocess.run(lock, capture_output=True, check=False).returncode != 0
    desk.attended.end()
    assert subprocess.run(lock, capture_output=True, check=False).returncode == 0


def test_a_folder_that_cannot_be_used_is_said(desk, spec):
    other = s2r.parse_spec(SPEC.replace("vd", "wd").replace("load", "mass"), "other.stl")
    desk.run(enter(desk.drop(log())))
    desk.again()
    attended = Scorer.for_spec(other, "tracks", "manual:night").backend.attendance(Script())
    with pytest.raises(UsageError, match=naming("night", "wd")):
        attended.begin(Coming(None))
    attended.end()
    s2r.write_trace(log(0.3), desk.root / "stray.csv")
    with pytest.raises(UsageError, match=r"stray\.csv"):
        desk.begin()
    (desk.root / "stray.csv").unlink()
    desk.attended.end()
    (desk.root / "next.json").write_text("{")
    with pytest.raises(UsageError, match=naming("next.json")):
        desk.begin()
    Path("file").write_text("")
    with pytest.raises(S2RError, match=naming("file")):
        ManualBackend("file")


def test_a_numberless_stand_in_is_no_copy_and_hidden_files_are_nobodys(desk):
    desk.run(("f", None))
    desk.run(("f", None))
    (desk.root / ".0003.abcd.part.csv").write_text("half")
    os.utime(desk.root / "rollouts.csv")
    assert len(desk.recordings) == 2


def test_the_page_quotes_what_is_said(question):
    root = Path(__file__).parents[2]
    turtlebot = s2r.load_spec(root / "specs" / "turtlebot.stl")
    backend = Scorer.for_spec(turtlebot, "delivers", "manual:nowhere").backend
    asked = RequestedTest({"ox": 0.22, "oy": 0.1875}, backend.needs, backend.duration)
    trace = s2r.load_backend("turtlebot").with_duration(4.0).rollout(asked.params, 0)
    other = Trace(trace.times, trace.channels, trace.units, {"params": {"ox": 0.3}})
    said = [refusal(one, asked) for one in (trace, other, trace.only(["d_obs"]))]
    wrong = log(vx_cmd=np.full(101, 0.1)), log(times=TIMES * 1000), log(vx=NAN), log(vx=np.full(101, np.inf))
    said += [refusal(one, question) for one in wrong]
    said += ["it is the log of an earlier test, sample for sample"]
    table = (
        (root / "docs" / "how-to" / "manual.md")
        .read_text()
        .split("| the log is refused if")[1]
        .split("\n\n")[0]
    )
    quotes = re.findall(r"\| \*([^*]+)\* \|", table)
    assert len(quotes) == 8
    for quote in quotes:
        assert any(quote in sentence for sentence in said), quote


def test_needs_are_those_of_the_requirement(spec):
    needs = Scorer.for_spec(spec, "tracks", "manual:nowhere").backend.needs
    assert isinstance(needs, Needs)
    assert needs.score(log(), TEST) == pytest.approx(0.1)
