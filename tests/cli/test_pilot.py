"""``s2r pilot``: what it prints, writes, keeps and refuses."""

import json

import pytest

import s2r_spec as s2r_package
from tests.cli.conftest import SPEC, rollouts_in
from tests.errors import states

COMMENTED = """\
# What it is about.
signal vx {m/s}                 # speed
param  vd {m/s} in [-0.2, 0.3]  # test space

require walking: always[0.5 s, 1.5 s] (abs(vx - vd) <= 0.1 {m/s})
# Why these numbers.
certify walking: delta = 1e-3, epsilon = 0.1,
                 B = 0.5, R = 0.02, kernel = rbf(0.2 {m/s}), fall = -0.5  # kept
# The end.
"""
BARE = "".join(line for line in SPEC.splitlines(keepends=True) if not line.startswith("certify"))


def test_it_prints_a_line_that_is_one(s2r):
    shown = s2r("pilot", s2r.spec(text=BARE), "-b", "toy", "-q", code=0).stdout
    found = s2r.json("pilot", s2r.spec(text=BARE), "-b", "toy", "-q", code=0)
    assert found["line"] in shown
    assert (found["rollouts"], found["tests"], found["written"]) == (60, 15, None)
    spec = s2r_package.parse_spec(BARE.replace("LIMIT", "0.1") + found["line"] + "\n")
    settings = spec.certify["walking"]
    assert found["proposal"]["settings"]["R"] == settings.R
    assert all(reason in " ".join(shown.split()) for reason in found["proposal"]["reasons"].values())


def test_write_replaces_the_requirement_s_line_and_nothing_else(s2r):
    name = s2r.spec(text=COMMENTED)
    found = s2r.json("pilot", name, "-b", "toy", "-q", "--write", code=0)
    written = (s2r.folder / name).read_text()
    before = COMMENTED[: COMMENTED.index("certify")]
    assert written == f"{before}{found['line']}  # kept\n# The end.\n"
    assert found["written"] == f"{name}:7"
    s2r("check", name, "-b", "toy", "-q", "--stop", "decided", code=0)


def test_write_adds_the_line_if_there_is_none_and_keeps_line_ends(s2r):
    (s2r.folder / "spec.stl").write_bytes(
        BARE.replace("LIMIT", "0.1").rstrip().replace("\n", "\r\n").encode()
    )
    found = s2r.json("pilot", "spec.stl", "-b", "toy", "-q", "--write", code=0)
    written = (s2r.folder / "spec.stl").read_bytes().decode()
    assert "\n" not in written.replace("\r\n", "")
    assert written.replace("\r\n", "\n").endswith(f"\n{found['line']}\n")


def test_a_finished_pilot_is_read_again_and_an_unfinished_one_goes_on(s2r):
    name = s2r.spec(text=BARE)
    first = s2r.json("pilot", name, "-b", "toy", "-q", "--run", "p", "--seed", 4, code=0)
    again = s2r.json("pilot", name, "-b", "toy", "-q", "--resume", "p", code=0)
    assert again == first
    journal = s2r.folder / "p" / "journal.jsonl"
    journal.write_text("".join(journal.read_text().splitlines(keepends=True)[:31]))
    assert s2r.json("pilot", name, "-b", "toy", "-q", "--resume", "p", code=0)["line"] == first["line"]
    assert rollouts_in(journal) == 60
    header = json.loads(journal.read_text().splitlines()[0])
    assert header["seed"] == 4


def test_a_rollout_of_a_pilot_can_be_replayed(s2r):
    name = s2r.spec(text=BARE)
    s2r("pilot", name, "-b", "toy", "-q", "--run", "p", code=0)
    assert s2r.json("replay", "p#3.1", code=0)["same"]


def test_a_gap_names_both(s2r):
    found = s2r.json("pilot", s2r.spec(text=BARE), "--sim", "toy", "--real", "toy:drag", "-q", code=0)
    assert found["backends"] == ["toy", "toy:drag"]
    assert found["rollouts"] == 180


@pytest.mark.parametrize(
    ("words", "facts"),
    [
        (("--budget", 8), ["budget = 8", "20 rollouts"]),
        (("-r", "flying"), ["'flying'"]),
        (("--resume", "nowhere"), ["nowhere"]),
        (("-b", "log:nowhere"), ["nowhere"]),
    ],
)
def test_bad_input_gets_a_sentence(s2r, words, facts):
    done = s2r("pilot", s2r.spec(text=BARE), "-b", "toy", "-q", *words, code=None)
    assert done.returncode in (2, 4)
    assert states(done.stderr, *facts), done.stderr
    assert "Traceback" not in done.stderr


def test_a_test_space_without_axes_gets_a_sentence(s2r):
    text = BARE.replace("in [-0.2, 0.3]", "= 0.1")
    assert "test space" in s2r("pilot", s2r.spec(text=text), "-b", "toy", code=2).stderr
