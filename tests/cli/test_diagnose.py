"""``s2r diagnose``: a campaign, protocols, logs, and what is refused before anything runs."""

import json

import jsonschema
import pytest
from s2r_cart import SPEC

from s2r_spec import load_backend, logs
from s2r_spec.report.records.schema import schema
from tests.errors import states

CART = ("diagnose", "cart.stl", "--sim", "cart")
TOY = """
param  v in [0, 1]
signal x {N}
require small: always[0, 0.9 s] (abs(x) <= 2 {N})
certify small: delta = 0.1, epsilon = 0.05, B = 1, R = 0.05, kernel = rbf(0.5), fall = -1
"""


@pytest.fixture
def cart(s2r, tmp_path, monkeypatch, cache):
    monkeypatch.setenv("S2R_CACHE", str(cache))
    (tmp_path / "cart.stl").write_text(SPEC)
    (tmp_path / "swing.stl").write_text(TOY)
    return s2r


SWING = ("diagnose", "swing.stl", "--sim", "swing", "--real", "swing:a=2", "--budget", 20, "-q")


def test_a_cause_is_named_applied_and_used(cart):
    done = cart(*SWING, "--run", "run", "--apply", "patched.json", "--report", "gap.html", code=0)
    assert states(done.stdout.splitlines()[0], "NAMED", "a")
    assert "patched:patched.json" in done.stderr
    found = json.loads((cart.folder / "run" / "diagnosis.json").read_text())
    assert found["which"]["answer"] == ["a"]
    jsonschema.validate(found, schema("s2r/diagnosis/2"))
    assert found["next"] in done.stdout
    page = (cart.folder / "gap.html").read_text()
    assert "NAMED: a" in page
    assert page.count("<svg") >= 2
    assert json.loads((cart.folder / "patched.json").read_text())["effects"] == found["patch"]
    again = json.loads(cart(*SWING, "--resume", "run", "--json", code=0).stdout)
    assert again == found
    assert states(cart(*SWING, "--resume", "run", "--seed", 5, code=2).stderr, "seed 0", "5")


def test_without_a_machine_it_says_what_runs_would_identify(cart, monkeypatch):
    monkeypatch.setenv("S2R_CACHE", str(cart.folder / "cache"))
    before = ("diagnose", "swing.stl", "--sim", "swing", "--no-protocols")
    first, *others = cart(*before, code=0).stderr.splitlines()
    assert "--real" in first
    cost = next(k for k, line in enumerate(others) if states(line, "toy", "on one core"))
    assert cost < next(k for k, line in enumerate(others) if line.startswith("simulating"))
    assert not any("held out" in line for line in others)
    before = (*before, "-q")
    found = json.loads(cart(*before, "--json", code=0).stdout)
    jsonschema.validate(found, schema("s2r.before/1"))
    assert {one["effect"]: one["run"] for one in found["effects"]} == {
        "a": "split",
        "b": "split",
        "c": "show",
        "d": "show",
    }
    lines = cart(*before, code=0).stdout.splitlines()
    assert states(next(line for line in lines if line.startswith("  a.size")), "2 N", "b.size", "split")
    for option, value in (("--next", "next.csv"), ("--seed", 1), ("--run", "run"), ("--resume", "run")):
        assert states(cart(*before, option, value, code=2).stderr, option, "--real")
    assert states(cart(*before, "--when", "x > 0", code=2).stderr, "log:FOLDER")
    assert states(cart(*before, "--real", "", code=2).stderr, "--real", "empty")
    assert states(cart(*before, "--format", "markdown", code=2).stderr, "markdown")


def test_protocols_are_run_restricted_or_left_out(cart):
    for more in (("--protocols", "show"), ("--passive",)):
        done = cart(*SWING, *more, "--json", code=3)
        found = json.loads(done.stdout)
        assert (found["verdict"], found["exit_code"]) == ("confounded", 3)
        assert set(found["which"]["set"]) == {"a", "b"}
        assert found["passive"] is (more != ("--protocols", "show"))
    done = cart(*SWING, "--budget", 7, code=2)
    assert states(done.stderr, "7", "8", "--budget", "--protocols")
    done = cart(*SWING, "--protocols", "shwo", code=2)
    assert states(done.stderr, "'shwo'", "show")
    done = cart(*SWING, "--protocols", "show", "--passive", code=2)
    assert states(done.stderr, "--protocols", "--passive")


@pytest.mark.parametrize("more", [(), ("--open-loop",)], ids=" ".join)
def test_the_next_experiment_is_printed_and_played_from_a_file(cart, more):
    # Recorded commands are of tests whose parameters the simulator need not have.
    name = "moment" if more else "v"
    (cart.folder / "swing.stl").write_text(TOY.replace("param  v", f"param {name}"))
    (cart.folder / "logs").mkdir()
    machine, rows = load_backend("swing:a=2"), [f"id,{name}"]
    for k in range(12):
        logs.write(machine.rollout({"v": k / 11}, k), cart.folder / "logs" / f"r{k}.npz")
        rows.append(f"r{k},{k / 11}")
    (cart.folder / "logs" / "rollouts.csv").write_text("\n".join(rows) + "\n")
    words = ("diagnose", "swing.stl", "--sim", "swing", "--real", "log:logs", "-q", *more)
    done = cart(*words, "--next", "next.csv", code=3)
    assert states(done.stderr, "protocol split", "next.csv")
    assert states((cart.folder / "next.csv").read_text().splitlines()[0], "q_0", "kp")


MACHINE_ALONE_PLAYS = """
from s2r_spec.backend import Recording
from s2r_swing import Toy, swing

class Simulator(Toy):
    playable = None

class Machine(Toy):
    recordings = tuple(
        Recording(str(k), {"v": k / 11}, swing("a=2").rollout({"v": k / 11}, k)) for k in range(12)
    )
"""


def test_the_next_protocol_is_written_by_a_machine_where_the_simulator_has_no_references(cart):
    (cart.folder / "lab.py").write_text(MACHINE_ALONE_PLAYS)
    words = ("diagnose", "swing.stl", "--sim", "lab.py:Simulator", "-q", "--next", "next.csv")
    done = cart(*words, "--real", "lab.py:Machine", code=3)
    assert states(done.stderr, "protocol split", "next.csv")
    assert states((cart.folder / "next.csv").read_text().splitlines()[0], "q_0", "kp")


def test_files_of_its_own_are_written_by_a_robot_file_alone_and_over_nothing(cart):
    done = cart(*SWING, "--as-found", "found", code=2)
    assert states(done.stderr, "--as-found", "robot.toml", "swing", "--apply")
    done = cart(*SWING, "--as-found", ".", code=2)
    assert states(done.stderr, "nothing is overwritten")


def test_a_missing_patch_is_a_sentence(s2r):
    done = s2r("check", s2r.spec(), "--backend", "patched:none.json", code=2)
    assert states(done.stderr, "none.json", "No such file")
    (s2r.folder / "odd.json").write_text("{}")
    done = s2r("check", s2r.spec(), "--backend", "patched:odd.json", code=2)
    assert "odd.json" in done.stderr


def test_formats_and_places_that_cannot_be_are_said_before_anything_runs(cart):
    words = (*CART, "--real", "cart:real.coulomb=1.5", "-q")
    for more, facts in (
        (("--format", "junit"), ("'junit'", "json, markdown, text")),
        (("--report", "nowhere/gap.html"), ("nowhere",)),
        (("--json", "--format", "markdown"), ("--json", "--format markdown")),
        (("--tuned",), ("--tuned", "--apply")),
        (("--apply", "nowhere/better.json"), ("nowhere",)),
        (("--next", "next.txt"), ("next.txt", ".csv")),
        (("--next", "nowhere/next.csv"), ("nowhere",)),
        (("--budget", 5), ("--budget", "6")),
    ):
        assert states(cart(*words, *more, code=2).stderr, *facts)
