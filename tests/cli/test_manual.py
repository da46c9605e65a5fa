"""A person at a pseudo-terminal runs the tests of ``manual:FOLDER``, as the page on it says."""

import json
import os
import re
import shlex
import signal
from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r_library
from s2r_spec.recordings.recorded import LogBackend
from s2r_spec.runs.journal import Journal
from s2r_spec.trace import Trace
from tests.forked import started
from tests.terminals import person

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "manual.md").read_text()
COMMANDS = [
    shlex.split(line)[1:]
    for block in re.findall(r"```sh\n(.*?)```", PAGE, re.S)
    for line in block.splitlines()
]
BLOCK = re.findall(r"```text\n(.*?)```", PAGE, re.S)[0]
PROMPT = "> "


@pytest.fixture
def lab(s2r):
    """The command line in a folder that has the specifications."""
    (s2r.folder / "specs").symlink_to(ROOT / "specs")
    return s2r


@pytest.fixture
def live(lab):
    """What the backend itself does in the place of the person: the rollouts of its journal, and the certificate."""
    words = ["turtlebot" if word == "manual:night" else word for word in COMMANDS[0]]
    found = lab.json(*words, "--run", "live", code=3)
    return Journal.read(lab.folder / "live" / "real").records(), found


def asked(folder):
    return json.loads((folder / "night" / "next.json").read_text())


@pytest.mark.slow
def test_thirty_tests_with_a_kill_in_the_middle_are_the_rollouts_of_the_backend_itself(lab, live):
    robot = s2r_library.load_backend("turtlebot")
    records, certificate = live
    done = 0

    def hand_over(someone):
        """Run the test that is asked for, as the live backend did it, and press Enter."""
        nonlocal done
        someone.reads(PROMPT)
        if done:
            assert len(LogBackend(str(lab.folder / "night")).recordings) == done
        assert asked(lab.folder)["params"] == records[done].params
        trace = robot.rollout(asked(lab.folder)["params"], records[done].seed)
        s2r_library.write_trace(trace, lab.folder / "night" / "incoming" / f"{done}.npz")
        done += 1
        someone.types("\n")

    words = [*COMMANDS[0], "--json"]
    with person() as someone, started([*words, "--run", "r"], lab.folder, terminal=someone.name) as command:
        for _ in range(len(records) // 2):
            hand_over(someone)
        someone.reads(PROMPT)
        before = asked(lab.folder)
        os.kill(command.process.pid, signal.SIGKILL)
    kept = (lab.folder / "r" / "real" / "journal.jsonl").read_text()
    with (
        person() as someone,
        started([*words, "--resume", "r"], lab.folder, terminal=someone.name) as command,
    ):
        someone.reads("Test")
        assert asked(lab.folder) == before
        while done < len(records):
            hand_over(someone)
        ended = command.finish()
    assert ended.returncode == 3, ended.stderr
    assert done >= 30
    found = json.loads(ended.stdout)
    assert (lab.folder / "r" / "real" / "journal.jsonl").read_text().startswith(kept)
    own = Journal.read(lab.folder / "r" / "real").records()
    assert [(r.query, r.replicate, r.params, r.seed, r.rho) for r in own] == [
        (r.query, r.replicate, r.params, r.seed, r.rho) for r in records
    ]
    for part in ("worst_expected_gap", "band", "tested", "lowest", "label"):
        assert found[part] == certificate[part]
    assert len(LogBackend(str(lab.folder / "night")).recordings) == len(records)
    lab(*COMMANDS[1], "--run", "again", code=3)


def test_every_answer_at_the_terminal(lab):
    robot = s2r_library.load_backend("turtlebot")
    incoming = lab.folder / "night" / "incoming"
    with (
        person() as someone,
        started([*COMMANDS[0], "--run", "r"], lab.folder, terminal=someone.name) as command,
    ):
        assert BLOCK in someone.reads(PROMPT)
        good = robot.rollout(asked(lab.folder)["params"], 1)
        half = good.times <= 4.0
        wrong = {
            "of another test": changed(good, meta={"params": {"ox": 0.0}}),
            "too short": Trace(good.times[half], {n: v[half] for n, v in good.channels.items()}, good.units),
            "d_goal": good.only(["d_obs"]),
            "ox_cmd is 0.1 m": changed(good, ox_cmd=np.full(len(good), 0.1)),
            "time-unit=ms": Trace(1000 * good.times, good.channels, good.units),
        }
        for number, trace in enumerate(wrong.values()):
            s2r_library.write_trace(trace, incoming / f"{number}.csv")
            someone.types("\n")
            shown = someone.reads(PROMPT)
            sentences = [line for line in shown.splitlines() if "is refused" in line]
            assert len(sentences) == 1, shown
        assert not (lab.folder / "night" / "rollouts.csv").exists()
        someone.types("f\n")
        someone.reads("Test 0002")
        someone.reads(PROMPT)
        someone.types("n\n")
        someone.reads("void")
        someone.reads(PROMPT)
        someone.types("a\n")
        someone.reads(PROMPT)
        someone.types("s\n")
        someone.reads(PROMPT)
        someone.types("\n")
        someone.reads(PROMPT)
        s2r_library.write_trace(good, lab.folder / "far.npz")
        someone.types("p\n")
        someone.reads(": ")
        someone.types("far.npz\n")
        someone.reads("Test 0003")
        someone.reads(PROMPT)
        someone.types("q\n")
        ended = command.finish()
    assert ended.returncode == 130
    assert "--resume r" in ended.stderr
    assert "Traceback" not in ended.stderr
    journal = Journal.read(lab.folder / "r" / "real")
    assert [record.failure for record in journal.records()] == ["fall", None]
    assert [void.word for void in journal.voids] == ["log"]
    recordings = LogBackend(str(lab.folder / "night")).recordings
    assert [recording.trace.failure for recording in recordings] == ["fall", None]
    assert asked(lab.folder)["id"] == "0003"


def changed(trace, meta=None, **channels):
    return Trace(trace.times, {**trace.channels, **channels}, trace.units, meta or {})


@pytest.mark.parametrize(
    "words",
    [
        COMMANDS[0],
        ["check", "specs/turtlebot.stl", "-b", "manual:night", "--budget", 30],
        ["gap", "specs/turtlebot.stl", "--sim", "turtlebot", "--real", "manual"],
        ["gap", "specs/turtlebot.stl", "--sim", "turtlebot", "--real", "manual:night?colour=red"],
    ],
)
def test_without_a_terminal_or_a_folder_nothing_is_asked(lab, words):
    done = lab(*words, code=2)
    assert [line[:7] for line in done.stderr.splitlines() if not line.startswith(("run ", "delivers: "))] == [
        "error: "
    ]
    assert not (lab.folder / "night").exists()


def test_the_options_for_logs_are_those_of_manual_too(lab):
    with (
        person() as someone,
        started(
            [
                "check",
                "specs/turtlebot.stl",
                "-b",
                "manual:night",
                "--budget",
                "30",
                "--run",
                "r",
                "--time-unit",
                "ms",
            ],
            lab.folder,
            terminal=someone.name,
        ) as command,
    ):
        someone.reads(PROMPT)
        trace = s2r_library.load_backend("turtlebot").rollout(asked(lab.folder)["params"], 1)
        rows = zip(1000 * trace.times, trace["d_obs"], trace["d_goal"], strict=True)
        text = "t,d_obs,d_goal\n" + "".join(f"{t},{a},{b}\n" for t, a, b in rows)
        (lab.folder / "night" / "incoming" / "a.csv").write_text(text)
        someone.types("\n")
        someone.reads("Accepted as 0001: 8 s")
        someone.reads(PROMPT)
        someone.types("\x04")
        assert command.finish().returncode == 130
    (recording,) = LogBackend(str(lab.folder / "night")).recordings
    assert recording.trace.units["d_obs"] == "m"
