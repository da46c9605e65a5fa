"""A run's folder: named once, gone on with as the advice says, and refused when its files were changed."""

import json
import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path

import pytest

import s2r_spec as s2r_
from s2r_spec.certify.gap import gap
from s2r_spec.cli.terminal import common
from s2r_spec.runs import layout
from s2r_spec.runs.journal import FILE
from tests.cli.conftest import SPEC
from tests.conftest import rewrite
from tests.errors import states

TWO = SPEC.replace("LIMIT", "0.1") + (
    "signal extra\n"
    "require still: always[0, 1 s] (abs(extra) <= 1)\n"
    "certify still: delta = 1e-3, epsilon = 0.5, B = 3, R = 0.1, kernel = rbf(0.2 {m/s}), fall = -1\n"
)
CHECK = ("check", "spec.stl", "-b", "toy", "-q", "--budget", 8)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run of eight rollouts, made once in this process."""
    from tests.report.conftest import plugin

    spec = s2r_.parse_spec(SPEC.replace("LIMIT", "0.1"), "spec.stl")
    folder = tmp_path_factory.mktemp("made") / "walking"
    with plugin():
        s2r_.check(spec, "toy", folder, budget=8, executor=lambda: ThreadPoolExecutor(1))
    return folder


@pytest.fixture
def small(s2r, made):
    """The same in the folder ``r``, as the command line would have made it of ``spec.stl``."""
    s2r.spec()
    return Path(shutil.copytree(made, s2r.folder / "r" / "walking"))


def one_sentence(done, *words):
    """See that a command refused with one sentence, and that it has these words."""
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert states(done.stderr, *map(str, words)), done.stderr


# -- names ---------------------------------------------------------------------------------------


def test_runs_that_begin_in_the_same_second_have_folders_of_their_own(tmp_path, monkeypatch):
    class Stopped(datetime):
        @classmethod
        def now(cls, tz=None):
            return cls(2026, 1, 2, 3, 4, 5)

    monkeypatch.setattr(layout, "datetime", Stopped)
    monkeypatch.chdir(tmp_path)
    made = [common.new_or_old(None, None, "spec-log:/a/b\n\x1b[2J", 0) for _ in range(3)]
    assert len(set(made)) == 3
    assert all(folder.is_dir() for folder in made)
    assert all(folder.name.isprintable() and folder.parent == Path("s2r-runs") for folder in made)
    assert common.new_or_old(None, None, "x" * 1000, 0).is_dir()


def test_a_command_that_refuses_leaves_no_empty_folder(s2r):
    one_sentence(s2r(*CHECK[:2], "-b", "nowhere", "-q"), "spec.stl", "No such file")
    s2r("check", s2r.spec(), "-b", "nowhere", "-q", code=2)
    assert not (s2r.folder / "s2r-runs").exists()


def test_a_run_cannot_begin_in_a_file(s2r):
    (s2r.folder / "r").write_text("mine")
    s2r.spec()
    one_sentence(s2r(*CHECK, "--run", "r"), "r", "folder")
    one_sentence(s2r(*CHECK, "--run", "r/deeper"), "r/deeper")
    one_sentence(s2r(*CHECK, "--resume", "r"), "r", "run")
    assert (s2r.folder / "r").read_text() == "mine"


# -- going on ------------------------------------------------------------------------------------


@pytest.mark.parametrize("given", ["r", "r/walking", "r/walking/", "./r/"])
def test_either_folder_of_a_check_goes_on_with_it(s2r, small, given):
    before = (small / FILE).read_bytes()
    found = s2r.json(*CHECK, "--resume", given, code=3)["results"][0]
    assert found["search"]["rollouts"] == 8
    assert (small / FILE).read_bytes() == before
    assert len(list(s2r.folder.rglob(FILE))) == 1


def test_the_folder_that_an_error_advises_is_one_that_works(s2r, small):
    done = s2r(*CHECK, "--run", "r", code=2)
    advised = done.stderr.split("--resume ")[1].split(",")[0].split(";")[0]
    assert advised == "r"
    s2r(*CHECK, "--resume", advised, code=3)


def test_a_run_from_python_goes_on_from_the_command_line(s2r, small):
    small.rename(s2r.folder / "mine")
    assert s2r.json(*CHECK, "--resume", "mine", code=3)["results"][0]["folder"] == "mine"


def test_the_other_requirements_of_a_run_that_was_cut_off_begin(s2r, small):
    s2r.spec(text=TWO)
    shutil.rmtree(small.parent)
    s2r(*CHECK, "--run", "r", "-r", "still", code=None)
    found = s2r.json(*CHECK, "--resume", "r/still", code=3)["results"]
    assert [Path(one["folder"]) for one in found] == [Path("r/walking"), Path("r/still")]


def test_the_folder_of_another_requirement_is_refused(s2r, small):
    s2r.spec(text=TWO)
    one_sentence(s2r(*CHECK, "--resume", "r/walking", "-r", "still"), "walking", "still")


@pytest.mark.parametrize("command", ["check", "gap", "certify", "diagnose"])
def test_there_is_nothing_to_resume_in_a_folder_without_a_run(s2r, command):
    s2r.spec()
    (s2r.folder / "empty").mkdir()
    machines = ("-b", "toy") if command == "check" else ("--sim", "toy", "--real", "toy:drag")
    done = s2r(command, "spec.stl", *machines, "-q", "--resume", "empty")
    one_sentence(done, "empty")
    assert not list((s2r.folder / "empty").iterdir())


def test_the_folder_of_one_side_of_a_gap_goes_on_with_both(s2r):
    spec = s2r_.load_spec(s2r.folder / s2r.spec())
    gap(spec, "toy", "toy:drag", s2r.folder / "made", budget=8, executor=lambda: ThreadPoolExecutor(1))
    shutil.copytree(s2r.folder / "made", s2r.folder / "g")
    before = {path: path.read_bytes() for path in s2r.folder.rglob(FILE)}
    words = ("spec.stl", "--sim", "toy", "--real", "toy:drag", "-q", "--budget", 8, "--resume", "g/real")
    s2r("gap", *words, code=3)
    assert {path: path.read_bytes() for path in s2r.folder.rglob(FILE)} == before
    one_sentence(s2r("certify", *words), "g/real")
    one_sentence(s2r("check", *CHECK[1:], "--resume", "g/real"), "g/real", "gap")


# -- what is kept ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "imported",
    [
        "../above.stl",
        "journal.jsonl",
        "lock",
        "spec.stl",
        "traces/00000.0000.npz",
        "imports/0.stl",
        "deep/x.stl",
    ],
)
def test_an_import_of_any_name_breaks_neither_run_nor_report(s2r, imported):
    home = s2r.folder / "home"
    home.mkdir()
    (home / imported).parent.mkdir(parents=True, exist_ok=True)
    (home / imported).write_text(f'import "{os.path.relpath(home / "more.stl", (home / imported).parent)}"\n')
    (home / "more.stl").write_text(SPEC.splitlines()[0] + "\n")
    body = "\n".join(SPEC.splitlines()[1:]).replace("LIMIT", "0.1")
    (home / "main.stl").write_text(f'import "{imported}"\n{body}\n')
    spec = s2r_.load_spec(home / "main.stl")
    found = s2r_.check(spec, "toy", s2r.folder / "run", budget=8, executor=lambda: ThreadPoolExecutor(1))
    shutil.rmtree(home)
    again = s2r.json("report", "run", "--format", "json", code=3)["results"][0]
    assert again["search"]["rollouts"] == 8
    assert again["provenance"]["spec_hash"] == spec.hash
    assert s2r.json("replay", f"run#{found.lowest.query}.{found.lowest.replicate}", code=0)["same"] is True
    (s2r.folder / "run" / "imports" / "1.stl").write_text("signal w {m/s}\n")
    one_sentence(s2r("report", "run", "--format", "text"), "run/imports/1.stl", "changed")


def test_a_run_with_imports_of_an_older_version_is_read(s2r):
    (s2r.folder / "parts").mkdir()
    (s2r.folder / "parts" / "signals.stl").write_text(SPEC.splitlines()[0] + "\n")
    body = "\n".join(SPEC.splitlines()[1:]).replace("LIMIT", "0.1")
    s2r.spec(text=f'import "parts/signals.stl"\n{body}\n')
    spec = s2r_.load_spec(s2r.folder / "spec.stl")
    s2r_.check(spec, "toy", s2r.folder / "old", budget=8, executor=lambda: ThreadPoolExecutor(1))
    # As it was stored before: under its own name, without a list, and without checksums of traces.
    shutil.rmtree(s2r.folder / "old" / "imports")
    (s2r.folder / "old" / "imports.json").unlink()
    shutil.copytree(s2r.folder / "parts", s2r.folder / "old" / "parts")
    rewrite(s2r.folder / "old", lambda line: {k: v for k, v in line.items() if k != "trace_crc32"})
    shutil.rmtree(s2r.folder / "parts")
    assert s2r.json("report", "old", "--format", "json", code=3)["results"][0]["search"]["rollouts"] == 8


COMMANDS = {
    "report": ("report", "r", "--format", "text"),
    "page": ("report", "r"),
    "odds": ("odds", "r", "--B", 2),
    "replay": ("replay", "r/walking#0.0"),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_specification_that_was_edited_after_the_check_is_refused(s2r, small, command):
    kept = small / "spec.stl"
    kept.write_text(kept.read_text().replace("0.1 {m/s}", "0.2 {m/s}"))
    one_sentence(s2r(*COMMANDS[command]), "r/walking/spec.stl", "changed")


@pytest.mark.parametrize("command", ["report", "odds"])
def test_a_trace_that_was_exchanged_is_refused(s2r, small, command):
    traces = sorted((small / "traces").iterdir())
    shutil.copy(traces[1], traces[0])
    one_sentence(s2r(*COMMANDS[command]), f"r/walking/traces/{traces[0].name}", f"{FILE}:")


def test_a_journal_in_the_folder_of_another_run_is_refused(s2r, small):
    other = s2r.folder / "other" / "walking"
    spec = s2r_.load_spec(s2r.folder / s2r.spec(0.2))
    s2r_.check(spec, "toy", other, budget=8, executor=lambda: ThreadPoolExecutor(1))
    shutil.copy(other / FILE, small / FILE)
    one_sentence(s2r(*COMMANDS["report"]), "r/walking/spec.stl")


def test_a_missing_trace_is_done_without(s2r, small):
    shutil.rmtree(small / "traces")
    s2r(*COMMANDS["report"], code=3)
    s2r(*COMMANDS["replay"], code=0)


def no_spec(run):
    (run / "spec.stl").unlink()


def a_folder_for_a_spec(run):
    no_spec(run)
    (run / "spec.stl").mkdir()


def a_pipe_for_a_journal(run):
    (run / FILE).unlink()
    os.mkfifo(run / FILE)


def a_folder_for_a_journal(run):
    (run / FILE).unlink()
    (run / FILE).mkdir()


def an_endless_line(run):
    with (run / FILE).open("ab") as file:
        file.write(b'{"query": 1, "x": "' + b"x" * 100_000_000)


@pytest.mark.parametrize(
    "damage", [no_spec, a_folder_for_a_spec, a_pipe_for_a_journal, a_folder_for_a_journal, an_endless_line]
)
def test_a_damaged_folder_is_one_sentence_in_every_command(s2r, small, damage):
    damage(small)
    for command in ("report", "odds", "replay"):
        one_sentence(s2r(*COMMANDS[command]), "r/walking")
    if damage not in (no_spec, a_folder_for_a_spec):  # to go on takes the specification that is given
        one_sentence(s2r(*CHECK, "--resume", "r"), "r/walking")


def test_a_lock_that_cannot_be_had_is_one_sentence(s2r, small):
    (small / "lock").unlink()
    (small / "lock").mkdir()
    one_sentence(s2r(*CHECK, "--resume", "r"), "r/walking")


def test_a_name_that_is_too_long_for_the_system_is_one_sentence(s2r):
    for words in (("report", "x" * 300), ("odds", "x" * 300, "--B", 1), ("replay", "x" * 300 + "#0.0")):
        one_sentence(s2r(*words), "File name too long")


def test_a_run_of_a_measure_says_what_it_is(s2r, small):
    rewrite(small, lambda line: line | {"measure": "distance"} if "settings" in line else line)
    one_sentence(s2r(*COMMANDS["report"]), "check_measure")


def test_a_pilot_says_that_it_has_no_certificate(s2r):
    s2r("pilot", s2r.spec(), "-b", "toy", "-q", "--run", "p", code=0)
    for words in (("report", "p"), ("odds", "p", "--B", 1), ("choose", "p", "p")):
        one_sentence(s2r(*words), "p", "--resume p")


# -- writers ---------------------------------------------------------------------------------------


def test_a_specification_is_not_cut_by_a_full_disk(s2r):
    import resource
    import signal

    body = "signal v {m/s}\n" + "".join(f"require r{n}: always (v<=1 {{m/s}})\n" for n in range(20))
    (s2r.folder / "a.stl").write_text(body)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handled = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300, before[1]))
    try:
        import subprocess

        # Python would cut the bytecode of its modules, too, and say nothing.
        alone = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(
            s2r.command("fmt", "a.stl"),
            cwd=s2r.folder,
            capture_output=True,
            text=True,
            check=False,
            env=alone,
        )
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handled)
    one_sentence(done, "a.stl")
    assert (s2r.folder / "a.stl").read_text() == body
    assert [path.name for path in s2r.folder.iterdir()] == ["a.stl"]


def test_files_that_a_command_rewrites_keep_their_permissions(s2r, small):
    for name in ("out.json", "spec.stl"):
        (s2r.folder / name).touch()
        (s2r.folder / name).chmod(0o604)
    (s2r.folder / "spec.stl").write_text(SPEC.replace("LIMIT", "0.1").replace("<=", "  <= "))
    s2r("fmt", "spec.stl", code=0)
    s2r("report", "r", "--format", "json", "-o", "out.json", code=3)
    assert json.loads((s2r.folder / "out.json").read_text())["exit_code"] == 3
    assert {(s2r.folder / name).stat().st_mode & 0o777 for name in ("out.json", "spec.stl")} == {0o604}
