"""A verdict reaches every terminal, and no name commands it."""

import io
import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.base.printable import lines, one_line
from s2r_spec.cli.options import output
from s2r_spec.cli.terminal import terminal
from s2r_spec.errors import BackendError, UsageError
from s2r_spec.report import REPORTERS, reporter
from s2r_spec.report import check as check_report
from s2r_spec.workers.pools import in_this_process
from tests.cli.conftest import SPEC

STEP = "signal v {m/s}\nrequire slow: always (v <= 1 {m/s})\n"
HOSTILE = "\x1b[2J\n::error::owned\r\x9b31m\u202e\u2028x##[error]y"


@pytest.fixture
def streams(monkeypatch):
    """Return a function that gives this process streams of an encoding, prepared as the command line does."""

    def of(encoding: str, errors: str = "strict") -> io.BytesIO:
        raw = io.BytesIO()
        for name in ("stdout", "stderr"):
            monkeypatch.setattr(sys, name, io.TextIOWrapper(raw, encoding, errors, write_through=True))
        terminal.prepare()
        return raw

    return of


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252", "cp437", "iso8859-15", "utf-8"])
def test_every_letter_that_s2r_writes_has_one_in_every_encoding(streams, encoding):
    raw = streams(encoding)
    print("ρ ≥ 0, Δ − δ ≤ ε ± 3 °, E ρ̂* → ✓ … 漢 caf\udce9")
    terminal.console().print("worst expected ρ in [−1, 1]")
    terminal.console(stderr=True).print("ρ")
    shown = raw.getvalue().decode(encoding)
    letters = {"ρ": "rho", "≥": ">=", "−": "-", "→": "->", "°": "deg", "漢": "?"}
    for letter, other in letters.items():
        try:
            letter.encode(encoding)
        except UnicodeEncodeError:
            assert letter not in shown
            assert other in shown
        else:
            assert letter in shown


def test_json_says_the_same_in_every_encoding(streams):
    record = {"text": 'ρ ≥ 0 "é" 🤖', "control": "\x9b\u202e"}
    for encoding in ("ascii", "latin-1", "utf-8"):
        raw = streams(encoding)
        terminal.print_json(json.dumps(record, ensure_ascii=False, indent=2))
        assert json.loads(raw.getvalue().decode(encoding)) == record
        assert not {"\x9b", "\u202e"} & set(raw.getvalue().decode(encoding))


@pytest.mark.parametrize(
    "environment",
    [
        pytest.param({"PYTHONIOENCODING": "ascii"}, marks=pytest.mark.slow),
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    ],
    ids=lambda words: ",".join(words),
)
def test_a_verdict_keeps_its_exit_code_in_a_terminal_that_is_not_utf8(s2r, environment):
    (s2r.folder / "v.stl").write_text(STEP, encoding="utf-8")
    (s2r.folder / "v.csv").write_text("t,v\n0,0.5\n1,1.5\n")
    env = {name: value for name, value in os.environ.items() if name not in ("LC_ALL", "LANG")} | environment
    done = subprocess.run(
        s2r.command("monitor", "v.stl", "v.csv"), cwd=s2r.folder, env=env, capture_output=True, check=False
    )
    assert done.returncode == 1
    assert done.stderr == b""
    assert b"slow violated: rho = -0.5 m/s" in done.stdout


def safe(text: str, commands: int = 0) -> bool:
    """Return whether nothing in a text commands a terminal or, beyond so many lines, a CI runner."""
    begun = sum(line.lstrip().startswith("::") for line in text.splitlines())
    return begun == commands and not any(c != "\n" and not c.isprintable() for c in text)


def test_one_line_is_one_line_and_says_what_was_there():
    shown = one_line(HOSTILE)
    assert safe(shown)
    assert len(shown.splitlines()) == 1
    assert "##[" not in shown
    assert json.loads(f'"{shown}"') == HOSTILE
    assert one_line(shown) == shown
    assert safe(one_line("  ::warning::x"))
    assert one_line("vx − 3 °C, 漢字 é") == "vx − 3 °C, 漢字 é"
    assert lines("a\nb") == "a\nb"
    assert safe(lines(HOSTILE))


@pytest.mark.parametrize("error", [UsageError, BackendError, s2r.S2RError])
def test_every_error_is_one_safe_line(error):
    shown = str(error(f"the channel {HOSTILE} is missing"))
    assert safe(shown)
    assert len(shown.splitlines()) == 1


def test_mistakes_of_a_specification_are_drawn_and_safe():
    with pytest.raises(UsageError) as caught:
        s2r.parse_spec("signal v {m/s}\nrequire r: v <= \x1b[2J::error:: 1 # \u202e\n", f"a{HOSTILE}.stl")
    shown = str(caught.value)
    assert safe(shown)
    assert "-->" in shown


def test_reports_of_hostile_names_are_safe_in_every_form(toy, tmp_path, streams):
    spec = s2r.parse_spec(SPEC.replace("LIMIT", "0.1"), "spec.stl")
    result = s2r.check(spec, "toy", tmp_path / "walking", budget=8, executor=in_this_process)
    nasty = replace(
        result,
        reason=HOSTILE,
        failures={HOSTILE: 2},
        assumptions=(HOSTILE, "::set-env::"),
        provenance=result.provenance | {"backend": HOSTILE, "spec": HOSTILE},
    )
    found = check_report.report([(replace(spec, name=HOSTILE), nasty)])
    for name in REPORTERS:
        shown = reporter(name)(found)
        if name == "json":
            assert json.loads(shown)["results"][0]["reason"] == HOSTILE
        else:
            assert safe(shown, commands=name == "github"), name
    raw = streams("ascii")
    for name in REPORTERS:
        output.emit(found, name, None)
        output.emit(found, name, tmp_path / "report")
        # A file is UTF-8 whatever the terminal is.
        assert (tmp_path / "report").read_text(encoding="utf-8") == reporter(name)(found) + "\n"
    assert "worst expected rho in [" in raw.getvalue().decode("ascii")


def test_a_trace_with_hostile_names_is_monitored_safely(s2r):
    from s2r_spec import logs
    from s2r_spec.trace import Trace

    (s2r.folder / "v.stl").write_text(STEP)
    name = "::error::\x1b]0;x\x07.npz"
    words = {"units": {HOSTILE: HOSTILE}, "meta": {"failure": HOSTILE}}
    logs.write(Trace([0.0, 1.0], {"w": np.zeros(2), HOSTILE: np.zeros(2)}, words["units"]), s2r.folder / name)
    missing = s2r("monitor", "v.stl", name, code=2)
    assert "'v'" in missing.stderr
    assert len(missing.stderr.splitlines()) == 1
    logs.write(Trace([0.0, 1.0], {"v": np.zeros(2)}, {}, words["meta"]), s2r.folder / name)
    fallen = s2r("monitor", "v.stl", name)
    logs.write(Trace([0.0, 1.0], {"v": np.zeros(2)}), s2r.folder / name)
    fine = s2r("monitor", "v.stl", name, code=0)
    for done in (missing, fallen, fine):
        assert safe(done.stdout)
        assert safe(done.stderr)
        assert "Traceback" not in done.stderr


def test_what_the_command_line_is_given_is_quoted_safely(s2r):
    for words in (
        ("monitor", "a\n::error::b.stl", "v.csv"),
        ("check", s2r.spec(), "-b", "toy:x\n::error::\x1b[2J", "-r", "no\n::error::"),
        ("backends", "no\n::error::\x1b[2J"),
        ("report", "nowhere\n::error::\x1b[2J"),
        ("check", s2r.spec(), "-b", "toy\n::error::y", "-q"),
    ):
        done = s2r(*words, code=2)
        assert safe(done.stderr), done.stderr
        assert len(done.stderr.splitlines()) == 1
        assert done.stdout == ""


def test_an_exception_of_a_backend_stays_in_its_line(s2r, monkeypatch):
    monkeypatch.setenv("S2R_TOY_SAYS", HOSTILE)
    done = s2r("check", s2r.spec(), "-b", "toy:raise", "-q", "--budget", 8, code=4)
    assert "ValueError" in done.stderr
    assert safe(done.stderr)
    assert len([line for line in done.stderr.splitlines() if line.startswith("error")]) == 1


def test_what_a_stream_that_is_no_terminal_is_given_cannot_command(streams):
    raw = streams("utf-8")
    print("a\x1b[2Jb\n  ::error::c")
    terminal.print_commands("::notice::of s2r itself")
    assert raw.getvalue().decode() == "a\\u001b[2Jb\n  \\u003a:error::c\n::notice::of s2r itself\n"
