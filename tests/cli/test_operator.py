"""The dialogue with a machine's operator, typed at a terminal: what counts as a word, and what ends the run."""

import json
import os
import re
import signal

import pytest

from s2r_spec.runs.journal import FILE, Journal
from tests.errors import states
from tests.forked import started
from tests.processes import lives, until
from tests.terminals import person

CONSENT, NEXT = "Type hangs to go on", "> "


@pytest.fixture
def happened(tmp_path, monkeypatch):
    """Return the lines of what happened to the robot."""
    file = tmp_path / "robot.log"
    file.touch()
    monkeypatch.setenv("S2R_ROBOT", str(file))
    return lambda *kinds: [
        line for line in file.read_text().splitlines() if not kinds or line.split()[0] in kinds
    ]


@pytest.fixture
def at_terminal(s2r):
    """Return what starts ``s2r check`` at a terminal, with its person; whatever a failed test leaves is killed."""

    class Session:
        def __enter__(self):
            self._person = person()
            someone = self._person.__enter__()

            def start(backend, *more):
                words = ["check", s2r.spec(), "-b", backend, "--budget", "8", "--run", "r", *map(str, more)]
                self._command = started(words, s2r.folder, terminal=someone.name)
                return self._command.__enter__()

            return someone, start

        def __exit__(self, *error):
            self._command.__exit__(*error)
            self._person.__exit__(*error)

    return Session


def test_only_the_word_is_consent_and_a_run_goes_to_its_end(at_terminal, happened, s2r):
    with at_terminal() as (someone, start):
        command = start("robot", "--json")
        someone.reads(CONSENT)
        for wrong in ("\n", "yes\n", "Hangs\n", "hang\n", "hangs!\n"):
            someone.types(wrong)
            someone.reads(CONSENT)
            assert happened("before") == []
        someone.types("hangs\n")
        someone.reads(NEXT)
        someone.types("go\n")  # only Enter is offered here
        someone.reads(NEXT)
        assert happened("rollout") == []
        for count in range(8):
            someone.types("\n")
            if count < 7:
                someone.reads(NEXT)
        done = command.finish()
    assert done.returncode == 3, done.stderr  # eight rollouts say nothing yet
    found = json.loads(done.stdout)
    assert found["results"][0]["voids"] == {}
    assert CONSENT not in done.stderr + done.stdout


@pytest.mark.parametrize("typed", ["q\n", "\x04", "\x03"], ids=["q", "end-of-input", "ctrl-c"])
def test_what_stops_a_run_is_no_error_and_it_goes_on(at_terminal, happened, s2r, typed):
    with at_terminal() as (someone, start):
        command = start("robot", "--json")
        someone.reads(CONSENT)
        someone.types("hangs\n")
        someone.reads(NEXT)
        someone.types("\n")
        someone.reads(NEXT)
        someone.types(typed)
        done = command.finish()
    assert done.returncode == 130
    assert "--resume r" in done.stderr
    assert "Traceback" not in done.stderr
    assert json.loads(done.stdout)["exit_code"] == 130
    order = [line.split()[0] for line in happened("begin", "before", "rollout", "after", "end")]
    assert order == ["begin", "before", "rollout", "after", "before", "end"]
    assert len(Journal.read(s2r.folder / "r" / "walking")) == 1


def test_what_was_typed_before_a_question_is_no_answer_to_it(at_terminal, happened):
    with at_terminal() as (someone, start):
        someone.types("hangs\n\n\n\n")
        command = start("robot")
        someone.reads(CONSENT)
        someone.types("q\n")
        assert command.finish().returncode == 130
    assert happened("before") == []


def test_a_void_rollout_is_asked_about(at_terminal, happened):
    with at_terminal() as (someone, start):
        command = start("robot:link=1")
        someone.reads(CONSENT)
        someone.types("hangs\n")
        someone.reads(NEXT)
        someone.types("\n")
        asked = someone.reads(NEXT)
        assert "link" in asked
        assert len(happened("rollout")) == 1
        someone.types("a\n")
        someone.reads(NEXT)
        someone.types("q\n")
        assert command.finish().returncode == 130
    assert len(happened("before")) == 2


def test_without_a_terminal_a_machine_is_refused_and_nothing_is_opened(s2r, happened):
    for words in (
        ["check", s2r.spec(), "-b", "robot"],
        ["certify", s2r.spec(), "--sim", "toy", "--real", "robot"],
    ):
        found = json.loads(s2r(*words, "--json", code=2).stdout)
        assert "terminal" in found["error"]
    assert happened() == []
    assert not (s2r.folder / "s2r-runs").exists()


def test_listing_planning_and_trying_move_nothing(s2r, happened):
    shown = s2r.json("backends", "robot", code=0)
    assert shown["exclusive"]
    assert shown["assumptions"] == ["the robot's clock is right"]
    assert "machine" in s2r("backends", "robot", code=0).stdout
    assert "machine" in s2r("backends", "robot", "--check", code=2).stderr
    plan = s2r("plan", s2r.spec(), "--backend", "robot", "--time", "30min", code=0).stdout
    alone = re.search(r"with 90 rollouts: ε = (\S+)", plan)
    of_gap = re.search(r"30min of robot \(90 rollouts of 20 s\): ε = (\S+) for the gap", plan)
    assert float(of_gap[1]) > float(alone[1]) > 0
    s2r("check", "--help", code=0)
    assert happened() == []


def test_a_machine_is_said_to_run_one_rollout_at_a_time(s2r, happened):
    said = s2r("check", s2r.spec(), "-b", "robot:auto", "--budget", 8, "--workers", 2, code=3).stderr
    assert "one rollout" in said
    assert "workers" not in said
    gap = ("gap", s2r.spec(), "--sim", "toy", "--real", "robot:auto", "--budget", 8, "--workers", 2)
    said = s2r(*gap).stderr.splitlines()[0]
    assert states(said, "2 workers", "one rollout", "robot:auto")
    assert len(happened("rollout")) == 16


@pytest.mark.parametrize(
    "words",
    [("check", "-b", "tooy"), ("gap", "--real", "tooy"), ("gap", "--sim", "tooy", "--real", "robot:auto")],
)
def test_nothing_is_said_of_a_run_that_is_refused(s2r, happened, words):
    command, *options = words
    done = s2r(command, s2r.spec(), *options)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("error: ")
    assert happened() == []


@pytest.mark.parametrize(
    ("words", "facts"),
    [
        (("--time", "30min"), ["--time", "--backend"]),
        (("--time", "30kg", "--backend", "robot"), ["--time", "30kg"]),
        (("--time", "soon", "--backend", "robot"), ["--time", "soon"]),
        (("--time", "1min", "--backend", "robot"), ["3 rollouts"]),
    ],
)
def test_a_time_that_buys_no_search_is_a_sentence(s2r, happened, words, facts):
    assert states(s2r("plan", s2r.spec(), *words, code=2).stderr, *facts)


def test_ctrl_c_brings_the_machine_to_rest_and_the_run_goes_on(s2r, happened):
    words = ["check", s2r.spec(), "-b", "robot:auto,hang=2", "--budget", "8", "--run", "r"]
    with started(words, s2r.folder) as command:
        until(lambda: len(happened("rollout")) == 2)
        os.kill(command.process.pid, signal.SIGINT)
        done = command.finish()
    assert done.returncode == 130, done.stderr
    assert "--resume r" in done.stderr
    assert happened("interrupt") == ["interrupt soft"], done.stderr
    assert happened()[-1] == "end"
    journal = Journal.read(s2r.folder / "r" / "walking")
    assert [void.word for void in journal.voids] == ["operator"]
    assert len(journal) == 1
    found = s2r.json("check", s2r.spec(), "-b", "robot:auto,hang=2", "--budget", 8, "--resume", "r", code=3)
    assert found["results"][0]["voids"] == {"operator": 1}
    assert found["results"][0]["label"] == "refused"


def test_the_third_ctrl_c_ends_the_worker(s2r, happened, monkeypatch):
    monkeypatch.setenv("S2R_ROBOT_DEAF", "1")
    words = ["check", s2r.spec(), "-b", "robot:auto,hang=1", "--budget", "8", "--run", "r"]
    with started(words, s2r.folder) as command:
        for count in range(3):
            until(lambda: len(happened("interrupt", "rollout")) == count + 1)  # noqa: B023
            os.kill(command.process.pid, signal.SIGINT)
        done = command.finish()
    assert done.returncode == 130, done.stderr
    assert happened("interrupt") == ["interrupt soft", "interrupt urgent"]
    assert [void.word for void in Journal.read(s2r.folder / "r" / "walking").voids] == ["killed"]
    assert not lives(int(happened("rollout")[0].split()[-1]))


def test_a_search_that_was_killed_in_a_rollout_resumes_with_the_same_test(s2r, happened):
    words = ["check", s2r.spec(), "-b", "robot:auto,hang=3", "--budget", "8", "--run", "r"]
    with started(words, s2r.folder) as command:
        until(lambda: len(happened("rollout")) == 3)
        os.kill(command.process.pid, signal.SIGKILL)
        command.process.join(120)
    worker = int(happened("rollout")[2].split()[-1])
    until(lambda: not lives(worker))
    before = (s2r.folder / "r" / "walking" / FILE).read_bytes()
    found = s2r.json("check", s2r.spec(), "-b", "robot:auto,hang=3", "--budget", 8, "--resume", "r", code=3)
    assert found["results"][0]["voids"] == {"killed": 1}
    assert (s2r.folder / "r" / "walking" / FILE).read_bytes().startswith(before)
    ran = [line.split()[1:3] for line in happened("rollout")]
    assert ran[2] == ran[3]
    assert len(ran) == 9
