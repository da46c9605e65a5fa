import json
import os
import re
import subprocess

import pytest

from tests.cli.conftest import FINE, SPEC, held_rollouts, rollouts_in, waiting
from tests.conftest import rewrite
from tests.errors import states
from tests.processes import until


def without_timing(result: dict) -> dict:
    """Drop what may differ between two runs of the same search: clocks and folders."""
    one = dict(result["results"][0])
    for key in ("seconds", "folder", "replay"):
        del one[key]
    one["lowest"] = {key: value for key, value in one["lowest"].items() if key != "seconds"}
    return one


def test_a_requirement_that_holds(s2r):
    done = s2r("check", s2r.spec(0.1), "--backend", "toy", "--workers", 2, code=0)
    assert states(done.stdout, "walking  HOLDS", "1 − 0.001", "seed 0")
    assert len(done.stdout.splitlines()) <= 9
    assert states(done.stderr, "rollouts", "ρ in [", "m/s")


def test_the_assumptions_and_the_rows_for_larger_norms_are_printed_on_request_and_in_a_file(s2r):
    words = ("check", s2r.spec(0.1), "--backend", "toy", "-q")
    assert states(s2r(*words, "-v", code=0).stdout, "This assumes", "B = 0.5", "B = 4")
    s2r(*words, "--output", "answer.txt", code=0)
    assert states((s2r.folder / "answer.txt").read_text(), "This assumes", "B = 0.5", "B = 4")


def test_a_requirement_that_is_violated_and_its_worst_case_again(s2r):
    result = s2r.json("check", s2r.spec(-0.05), "-b", "toy", "-q", code=1)["results"][0]
    bound = result["worst_expected_robustness"]
    assert result["verdict"] == "violated"
    assert bound["lower"] <= bound["upper"] < 0
    assert bound["unit"] == "m/s"
    again = s2r.json(*result["replay"].split()[1:], code=0)
    assert again["same"] is True
    assert again["rho"] == result["lowest"]["rho"]


def test_a_budget_too_small_to_tell_says_unknown(s2r):
    result = s2r.json("check", s2r.spec(), "-b", "toy", "--budget", 10, "-q", code=3)["results"][0]
    assert result["verdict"] == "unknown"
    assert result["label"] == "budget exhausted (valid interval)"
    assert result["search"]["rollouts"] <= 10


def test_a_known_verdict_ends_the_search_unless_the_interval_is_wanted(s2r):
    words = ("check", s2r.spec(text=FINE.replace("LIMIT", "0.1")), "-b", "toy", "-q")
    usual = s2r.json(*words, "--stop", "epsilon", code=0)["results"][0]
    result = s2r.json(*words, "--run", "r", code=0)["results"][0]
    assert result["label"] == result["search"]["label"] == "decided (valid interval)"
    assert result["provenance"]["stop"] == "decided"
    assert result["search"]["rollouts"] < usual["search"]["rollouts"]
    assert result["worst_expected_robustness"]["lower"] >= 0
    again = s2r.json("report", "r", code=0)["results"][0]
    assert (again["label"], again["search"]) == (result["label"], result["search"])
    on = s2r.json(*words, "--stop", "epsilon", "--resume", "r", code=0)["results"][0]
    assert (on["label"], on["provenance"].get("stop")) == (usual["label"], None)
    assert on["search"]["rollouts"] > result["search"]["rollouts"]
    assert s2r.json("report", "r", code=0)["results"][0]["search"] == on["search"]


def test_the_result_depends_on_the_seed_and_not_on_the_workers(s2r):
    words = ("check", s2r.spec(), "-b", "toy", "-q")
    in_a_thread, in_processes, other = (
        without_timing(s2r.json(*words, *more, code=0)) for more in ((), ("--workers", 2), ("--seed", 1))
    )
    assert in_a_thread == in_processes
    assert in_a_thread["search"] != other["search"]


def test_kill_9_in_the_middle_leaves_no_workers_and_resume_gives_the_same_certificate(s2r):
    words = ("check", s2r.spec(), "-b", "toy:waits", "-q")
    whole = without_timing(s2r.json(*words, "--run", "whole", code=0))
    with waiting(s2r, *words, "--workers", 2, "--run", "cut") as command:
        pid, journal = command.process.pid, s2r.folder / "cut" / "walking" / "journal.jsonl"
        until(lambda: rollouts_in(journal) > 10, 300)
        assert members(pid) > {pid}
        command.process.kill()
        command.process.join()
        until(lambda: not members(pid))  # no worker is left behind
    before = journal.read_bytes().count(b"\n")
    assert before < whole["search"]["rollouts"]
    resumed = s2r.json(*words, "--resume", "cut", code=0)
    assert without_timing(resumed) == whole
    assert journal.read_bytes().count(b"\n") == whole["search"]["rollouts"] + 1
    # What had been recorded was not run again: the old lines are still the first ones.
    # A trace that was being written has another, hidden name.
    kept = [path for path in (journal.parent / "traces").iterdir() if not path.name.startswith(".")]
    assert len(kept) == whole["search"]["rollouts"]


def members(session: int) -> set[int]:
    """Return the living processes of a session: a command's workers have process groups of their own."""
    listed = subprocess.run(
        ["ps", "-eo", "sess=,stat=,pid="], capture_output=True, text=True, check=True
    ).stdout
    rows = [line.split() for line in listed.splitlines()]
    return {int(pid) for sess, state, pid in rows if int(sess) == session and not state.startswith("Z")}


def test_a_fall_counts_as_the_declared_value(s2r):
    done = s2r("check", s2r.spec(), "-b", "toy:fall", "-q", code=None)
    # A cliff of −0.5 in a run with R = 0.02: either the interval shows it, or R or B is refuted. Never "holds".
    assert done.returncode in (1, 3)
    assert "× fell [/leg]" in done.stdout


@pytest.mark.parametrize(
    ("habit", "words", "facts"),
    [
        pytest.param("die", (), ["crash", "3"], marks=pytest.mark.slow),
        ("hang", ("--timeout", 0.5), ["crash", "0.5 s", "CPU"]),
    ],
)
def test_a_worker_that_dies_or_hangs_counts_as_a_crash(s2r, habit, words, facts):
    # A test at 0.3 m/s, the end of the range, is in the first batch of this seed.
    words = ("check", s2r.spec(), "-b", f"toy:{habit}", *words, "--budget", 8, "--seed", 4, "--json")
    words = (*words, "--workers", 1)
    # Every rollout there counts as a fall, which no B explains away.
    done = s2r(*words, "--run", "r", code=1)
    result = json.loads(done.stdout)["results"][0]
    ((failure, count),) = result["failures"].items()
    assert states(failure, *facts)
    assert count > 0
    assert result["lowest"]["rho"] == -0.5
    assert states(done.stderr, "vd = 0.3 m/s", failure, "ρ = -0.5")
    # What was recorded is not run again: nothing hangs any more.
    again = json.loads(s2r(*words, "-q", "--resume", "r", code=1).stdout)["results"][0]
    assert again["search"] == result["search"]


def test_a_resumed_run_keeps_its_seed_and_refuses_another(s2r):
    words = ("check", s2r.spec(), "-b", "toy", "--budget", 20)
    first = s2r(*words, "--seed", 7, "--run", "r", "--json", code=None)
    again = s2r(*words, "--resume", "r", "--json", code=first.returncode)
    assert states(again.stderr, "seed 7")
    assert without_timing(json.loads(again.stdout)) == without_timing(json.loads(first.stdout))
    assert states(s2r(*words, "--resume", "r", "--seed", 0, code=2).stderr, "seed 7", "0")


def test_dask_gives_the_numbers_of_this_machine(s2r):
    distributed = pytest.importorskip("distributed", reason="the extra [dask] is not installed")
    spec = s2r.spec()
    quiet = {"processes": False, "protocol": "tcp", "dashboard_address": ":0", "silence_logs": 50}
    with distributed.LocalCluster(1, threads_per_worker=2, **quiet) as cluster:
        words = ("check", spec, "-b", "toy", "--scheduler", cluster.scheduler_address, "-q")
        there = without_timing(s2r.json(*words, code=0))
        assert states(s2r(*words, "--workers", 2, code=2).stderr, "--workers", "--scheduler")
    assert there == without_timing(s2r.json("check", spec, "-b", "toy", "-q", code=0))


@pytest.mark.parametrize(
    ("text", "words", "facts"),
    [
        (SPEC.replace("signal vx {m/s}", "signal vx {kg}"), (), ["vx", "kg", "m/s"]),
        (SPEC.replace("vx", "speed"), (), ["'speed'", "'toy'"]),
        (SPEC.replace("vd", "vdd"), (), ["'vdd'", "'toy'", "did you mean 'vd'"]),
        (SPEC.replace("0.3]", "0.7]"), (), ["vd = 0.7 m/s", "[-0.5, 0.5] m/s"]),
        (SPEC, ("-b", "simm"), ["'simm'", "did you mean 'sim'", "toy"]),
        (SPEC, ("-b", "needy"), ["'needy'", "'a_package_that_nobody_has'"]),
        (SPEC, ("-r", "walk"), ["'walk'", "walking"]),
        (SPEC.replace(", fall = -0.5", ""), (), ["'walking'", "fall"]),
        (SPEC.replace("certify walking: ", "# "), (), ["spec.stl", "certify"]),
        (SPEC, ("--budget", "3"), ["3", "8 rollouts"]),
        (SPEC, ("--stop", "soon"), ["stop", "'soon'", "decided"]),
        (SPEC, ("--stop", "budget"), ["stop", "'budget'"]),
        (SPEC, ("--engine", "magic"), ["'magic'", "gpytorch", "spectral"]),
        ("solid mesh\n facet normal 0 0 1\nendsolid mesh\n", (), ["spec.stl", "mesh"]),
        ("require a: always (x <= 1", (), ["E01", "spec.stl:1:19"]),
    ],
)
def test_bad_input_gets_one_sentence_and_exit_2(s2r, text, words, facts):
    words = words if "-b" in words else ("-b", "toy", *words)
    spec = s2r.spec(text=text)
    done = s2r("check", spec, *words, code=2)
    assert states(done.stderr, *facts), done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert s2r.json("check", spec, *words, code=2)["exit_code"] == 2
    assert not list(s2r.folder.glob("s2r-runs/*/*/traces/*"))


def test_a_spec_that_is_not_there(s2r):
    assert states(s2r("check", "nowhere.stl", code=2).stderr, "nowhere.stl", "No such file")


def test_a_backend_that_raises_exits_4_and_keeps_what_was_recorded(s2r):
    done = s2r("check", s2r.spec(), "-b", "toy:raise", "-q", "--run", "r", code=4)
    assert states(done.stderr, "'toy:raise'", "ValueError", "the gyroscope is upside down")
    assert (s2r.folder / "r" / "walking" / "journal.jsonl").exists()


def test_resuming_another_run_names_the_field(s2r):
    s2r("check", s2r.spec(0.1), "-b", "toy", "-q", "--run", "r", code=0)
    other = s2r("check", "spec.stl", "-b", "toy", "--seed", 5, "--resume", "r", code=2)
    assert states(other.stderr, "seed", "0", "5")
    assert "--resume r" in s2r("check", "spec.stl", "-b", "toy", "--run", "r", code=2).stderr
    s2r.spec(0.2)
    assert "spec_hash" in s2r("check", "spec.stl", "-b", "toy", "--resume", "r", code=2).stderr


def test_resuming_a_finished_run_runs_nothing(s2r):
    first = without_timing(s2r.json("check", s2r.spec(), "-b", "toy", "-q", "--run", "r", code=0))
    journal = s2r.folder / "r" / "walking" / "journal.jsonl"
    before = journal.read_bytes()
    assert without_timing(s2r.json("check", "spec.stl", "-b", "toy", "-q", "--resume", "r", code=0)) == first
    assert journal.read_bytes() == before


def test_units_are_converted_between_spec_and_backend(s2r):
    text = SPEC.replace("param  vd {m/s} in [-0.2, 0.3]", "param  vd {cm/s} in [-20, 30]").replace(
        "rbf(0.2 {m/s})", "rbf(20 {cm/s})"
    )
    metres = s2r.json("check", s2r.spec(), "-b", "toy", "-q", code=0)["results"][0]
    centimetres = s2r.json("check", s2r.spec(text=text.replace("LIMIT", "0.1")), "-b", "toy", "-q", code=0)[
        "results"
    ][0]
    assert centimetres["worst"]["params"]["vd"] == pytest.approx(100 * metres["worst"]["params"]["vd"])
    assert centimetres["lowest"]["rho"] == pytest.approx(metres["lowest"]["rho"], abs=1e-9)


def test_replay_says_what_is_wrong(s2r):
    assert states(s2r("replay", "somewhere", code=2).stderr, "somewhere", "FOLDER#QUERY.REPLICATE")
    assert "somewhere" in s2r("replay", "somewhere#1.2", code=2).stderr
    s2r("check", s2r.spec(), "-b", "toy", "-q", "--run", "r", code=0)
    assert "999.0" in s2r("replay", "r/walking#999.0", code=2).stderr
    s2r("replay", "r/walking#0.0", "--save", "again.csv", code=0)
    assert (s2r.folder / "again.csv").exists()


def test_replay_notices_that_the_model_has_changed(s2r, monkeypatch):
    s2r("check", s2r.spec(), "-b", "toy", "-q", "--run", "r", code=0)
    rewrite(s2r.folder / "r" / "walking", lambda line: line | ({"rho": 0.123} if "rho" in line else {}))
    monkeypatch.setenv("S2R_TOY_MODEL", "toy-2")
    done = s2r("replay", "r/walking#0.0", code=4)
    assert states(done.stdout, "toy-1", "toy-2")


def test_backends_lists_names_and_details(s2r):
    shown = s2r("backends", code=0).stdout
    assert "sim " in shown
    assert "toy " in shown
    assert "vd " in s2r("backends", "toy", code=0).stdout
    toy = s2r.json("backends", "toy", code=0)
    assert toy["model_hash"] == "toy-1"
    assert toy["effects"] == []
    shown = s2r("backends", "emps", code=0).stdout
    assert states(shown, "coulomb (friction)", "force", "[0, 80] N", "half-normal, 20 N")
    first = s2r.json("backends", "emps", code=0)["effects"][0]
    assert (first["name"], first["parameters"][0]["unit"]) == ("viscous", "N*s/m")


def test_backends_lists_protocols(s2r):
    shown = s2r("backends", "sim", code=0).stdout
    assert "squeeze (ground, 1.9 s)" in shown
    assert "risk: feet slip" in shown
    (first, *_) = s2r.json("backends", "sim", code=0)["protocols"]
    assert (first["name"], first["place"], first["duration"]) == ("air_sine", "air", 2.0)
    assert "protocols" not in s2r.json("backends", "toy", code=0)


def test_backends_check_exits_with_one_if_a_promise_is_broken(s2r):
    done = s2r("backends", "toy", "--check", code=0)
    assert "4 of 4" in done.stdout.splitlines()[-1]
    found = s2r.json("backends", "toy", "--check", code=0)
    assert [p["broken"] for p in found["promises"]] == [[]] * 4
    assert "backend" in s2r("backends", "--check", code=2).stderr
    done = s2r("backends", "toy:raise", "--check", code=1)
    assert states(done.stdout, "BROKEN", "ValueError: the gyroscope is upside down")


def test_help_and_version(s2r):
    shown = s2r("check", "--help", code=0).stdout
    assert "Exit codes" in shown
    assert re.findall(r"^(\w.*):$", shown, re.M) == ["What is asked", "The search", "The logs", "Output"]
    logs = shown.partition("The logs:")[2].partition("Output:")[0]
    assert len(re.findall(r"^  -", logs, re.M)) == 11
    assert s2r("--version", code=0).stdout.startswith("s2r ")
    assert "No such option" in s2r("check", "x.stl", "--sed", "1", code=2).stderr


def test_replay_plots_the_signals_against_their_tolerances(s2r):
    pytest.importorskip("matplotlib")
    s2r("check", s2r.spec(), "-b", "toy", "-q", "--run", "r", code=0)
    s2r("replay", "r/walking#0.0", "--plot", "again.svg", code=0)
    assert "</svg>" in (s2r.folder / "again.svg").read_text()
    assert states(s2r("replay", "r/walking#0.0", "--plot", "again.stl", code=2).stderr, "again.stl", ".svg")
    # It plots also where the backend draws no pictures.
    done = s2r("replay", "r/walking#0.0", "--plot", "again.png", "--render", "again.gif", code=2)
    assert "'toy'" in done.stderr
    assert (s2r.folder / "again.png").exists()


@pytest.mark.parametrize(
    ("habit", "facts"),
    [
        ("exit", ["'toy:exit'", "SystemExit: 0", "{'vd': "]),
        ("missing", ["'toy:missing'", "'gyroscope'"]),
        ("dict", ["'toy:dict'", "dict", "Trace", "{'vd': "]),
    ],
)
def test_whatever_a_rollout_does_it_is_never_data_and_never_success(s2r, habit, facts):
    words = ("check", s2r.spec(), "-b", f"toy:{habit}", "--workers", 1, "--run", "r", "--json")
    result = s2r(*words, code=4)
    assert states(result.stderr, *facts), result.stderr
    assert json.loads(result.stdout)["exit_code"] == 4
    assert (s2r.folder / "r" / "walking" / "journal.jsonl").read_text().count("\n") == 1


def test_a_trace_that_cannot_be_scored_is_kept(s2r):
    done = s2r("check", s2r.spec(), "-b", "toy:nan", "-q", "--run", "r", code=4)
    assert states(done.stderr, "'vx'", "NaN"), done.stderr
    assert list((s2r.folder / "r" / "walking" / "unscored").glob("*.npz"))


def test_each_requirement_reads_only_what_it_needs(s2r):
    """Two requirements with different signals and horizons."""
    text = SPEC.replace("LIMIT", "0.1") + (
        "signal extra\n"
        "require still: always[0, 3 s] (abs(extra) <= 1)\n"
        "certify still: delta = 1e-3, epsilon = 0.5, B = 3, R = 0.1, kernel = rbf(0.2 {m/s}), fall = -1\n"
    )
    results = s2r.json("check", s2r.spec(text=text), "-b", "toy", "-q", code=0)["results"]
    assert [one["verdict"] for one in results] == ["holds", "holds"]


def test_two_processes_do_not_write_to_one_run(s2r):
    words = ("check", s2r.spec(), "-b", "toy:waits", "-q")
    with waiting(s2r, *words, "--run", "r") as first:
        until(lambda: rollouts_in(s2r.folder / "r" / "walking" / "journal.jsonl") > 2, 300)
        assert states(s2r(*words, "--resume", "r", code=2).stderr, "r/walking", "another process")
    assert first.process.exitcode == 0


@pytest.mark.parametrize("left", ["", '{"schema": "s2r.jour'])
def test_a_run_killed_while_it_began_can_be_resumed(s2r, left):
    (s2r.folder / "r" / "walking" / "traces").mkdir(parents=True)
    (s2r.folder / "r" / "walking" / "journal.jsonl").write_text(left)
    assert s2r.json("check", s2r.spec(), "-b", "toy", "-q", "--resume", "r", code=0)


def test_a_spec_with_imports_can_be_replayed(s2r):
    (s2r.folder / "parts").mkdir()
    (s2r.folder / "parts" / "signals.stl").write_text(SPEC.splitlines()[0] + "\n")
    text = 'import "parts/signals.stl"\n' + "\n".join(SPEC.splitlines()[1:]) + "\n"
    result = s2r.json("check", s2r.spec(text=text.replace("LIMIT", "0.1")), "-b", "toy", "-q", code=0)[
        "results"
    ][0]
    assert s2r.json(*result["replay"].split()[1:], code=0)["same"] is True


def test_a_wrong_name_is_said_before_anything_runs(s2r):
    done = s2r("check", s2r.spec(), "-b", "toy", "-r", "walking", "-r", "typo", code=2)
    assert states(done.stderr, "'typo'", "walking")
    assert not list(s2r.folder.glob("s2r-runs/*/*/journal.jsonl"))


def test_what_the_command_line_refuses_is_one_object_too(s2r):
    assert s2r.json("check", "x.stl", "--seed", "-1", code=2)["schema"] == "s2r.error/1"


def test_a_reader_that_goes_away_is_not_told_that_the_requirement_is_violated(s2r):
    words = ("check", s2r.spec(), "-b", "toy:waits", "--run", "cut")
    with held_rollouts(s2r):
        # A buffer that cannot be flushed at exit must not change the exit code.
        buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
        process = subprocess.Popen(s2r.command(*words), cwd=s2r.folder, stderr=subprocess.PIPE, env=buffered)
        process.stderr.readline()
        process.stderr.close()
    assert process.wait(300) == 141
    # It goes on from what there is.
    assert s2r.json("check", s2r.spec(), "-b", "toy:waits", "-q", "--resume", "cut", code=0)["results"]
