"""A journal is read without trust: whatever its lines hold, one sentence names the line."""

import json
import shutil
from concurrent.futures import ThreadPoolExecutor

import pytest

import s2r_spec as s2r
from s2r_spec.errors import UsageError
from s2r_spec.report.recompute import kind, recompute
from s2r_spec.runs.journal import FILE
from s2r_spec.runs.layout import runs_in
from s2r_spec.runs.replay import replay
from tests.cli.conftest import SPEC
from tests.conftest import rewrite


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    from tests.report.conftest import plugin

    folder = tmp_path_factory.mktemp("lines") / "walking"
    spec = s2r.parse_spec(SPEC.replace("LIMIT", "0.1"), "spec.stl")
    with plugin():
        s2r.check(spec, "toy", folder, budget=8, executor=lambda: ThreadPoolExecutor(1))
    return folder


@pytest.fixture
def run(recorded, tmp_path, toy):
    shutil.copytree(recorded, tmp_path / "walking")
    return tmp_path / "walking"


def refused(run, where):
    """See that report and replay refuse the run with one sentence that says where."""
    for use in (recompute, lambda folder: replay(f"{folder}#0.0")):
        with pytest.raises(UsageError) as caught:
            use(run)
        assert caught.value.exit_code == 2
        assert where in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1
        assert len(str(caught.value)) < 600


NESTED = json.loads("[" * 50 + "]" * 50)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("query", 1.0), ("query", -1), ("query", True), ("query", "1"), ("query", 1 << 70), ("query", None),
        ("replicate", 0.5), ("replicate", []), ("seed", "7"), ("seed", -1), ("seed", 1.5),
        ("rho", "0.1"), ("rho", True), ("rho", None), ("rho", [0.1]), ("rho", 10**400),
        ("params", []), ("params", {"vd": "0.1"}), ("params", {"vd": None}), ("params", {"vd": NESTED}),
        ("params", {"other": 0.1}), ("params", {}), ("params", {"vd": 0.1, "more": 1}), ("params", {"vd": 1e308}),
        ("failure", 3), ("failure", False), ("failure", {"word": "fall"}),
        ("trace", 7), ("trace", "../../secret.npz"), ("trace", "/etc/passwd"), ("trace", "traces/../spec.stl"),
        ("seconds", -1), ("seconds", "0.2"), ("trace_crc32", 5), ("unknown", 1),
    ],
)  # fmt: skip
def test_a_rollout_of_wrong_types_names_its_line(run, field, value):
    third = json.loads((run / FILE).read_text().splitlines()[2])
    same = {key: third[key] for key in ("query", "replicate")}
    rewrite(run, lambda line: line | {field: value} if same.items() <= line.items() else line)
    refused(run, f"{FILE}:3")


@pytest.mark.parametrize("field", ["query", "params", "rho", "seconds", "failure"])
def test_a_rollout_that_lacks_a_field_names_it(run, field):
    rewrite(run, lambda line: {key: value for key, value in line.items() if key != field})
    refused(run, field)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("requirement", 3), ("requirement", "other"), ("settings", None), ("settings", {}),
        ("settings", {"mode": [], "engine": "spectral"}), ("seed", "0"), ("seed", -1), ("spec_hash", 5),
        ("backend", ["toy"]), ("model_hash", {}), ("duration", "long"), ("recorded", "all"), ("recorded", [1]),
        ("side", "left"), ("side", "real"), ("s2r", 7), ("spec", None),
    ],
)  # fmt: skip
def test_a_header_of_wrong_types_is_refused(run, field, value):
    rewrite(run, lambda line: line | {field: value} if "settings" in line else line)
    with pytest.raises(UsageError, match="walking") as caught:
        recompute(run)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    "field", ["requirement", "settings", "seed", "spec_hash", "backend", "duration", "s2r"]
)
def test_a_header_that_lacks_a_field_names_it(run, field):
    rewrite(run, lambda line: {key: value for key, value in line.items() if key != field})
    refused(run, f"{FILE}:1" if field != "seed" else "seed")


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000, '{"a":' * 100_000, '{"query": 1e400}', '{"rho": NaN}', '{"rho": -Infinity}', "9" * 5000,
        '{"rho": ' + "9" * 5000 + "}", "[]", "null", '"text"', "\ufeff{}", "\x00", "{'rho': 1}",
    ],
)  # fmt: skip
def test_a_line_that_is_no_record_names_itself(run, text):
    lines = (run / FILE).read_text().splitlines()
    lines[3] = text
    (run / FILE).write_text("\n".join(lines) + "\n")
    refused(run, f"{FILE}:4")


def test_bytes_that_are_no_text_name_their_line(run):
    lines = (run / FILE).read_bytes().splitlines()
    lines[4] = b"\xff\xfe\x00{"
    (run / FILE).write_bytes(b"\n".join(lines) + b"\n")
    refused(run, f"{FILE}:5")


def test_rollouts_that_lasted_longer_than_any_are_not_run_again(run):
    rewrite(run, lambda line: line | {"duration": 1e300} if "settings" in line else line)
    with pytest.raises(UsageError, match=r"1e\+300"):
        replay(f"{run}#0.0")


def test_a_failure_word_of_a_journal_is_no_command(run):
    words = "fell\n::error::x\x1b[2J"
    rewrite(run, lambda line: line | {"failure": words} if "rho" in line else line)
    from s2r_spec.report import check as check_report
    from s2r_spec.report import reporter

    found = recompute(run)
    shown = reporter("text")(check_report.report([(found.spec, found.result)]))
    assert "\x1b" not in shown
    assert not any(line.startswith("::") for line in shown.splitlines())


def test_a_check_of_requirements_called_as_the_sides_of_a_gap_is_a_check(run, tmp_path):
    for side in ("sim", "real"):
        shutil.copytree(run, tmp_path / "both" / side)
    assert kind(tmp_path / "both").value == "s2r check"
    assert len(runs_in(tmp_path / "both")) == 2
