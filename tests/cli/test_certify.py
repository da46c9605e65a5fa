from functools import cache

import numpy as np
import pytest

import s2r_spec as s2r_lib
from tests.cli.conftest import FINE, SPEC, rollouts_in, waiting
from tests.errors import states
from tests.processes import until

SPEED = np.linspace(-0.2, 0.3, 6)


@cache
def expected(spec_text: str, backend: str, rollouts: int = 300) -> np.ndarray:
    """Return (6,) mean ρ over the test space, by brute force."""
    spec, machine = s2r_lib.parse_spec(spec_text), s2r_lib.load_backend(backend)
    return np.array(
        [
            np.mean(
                [
                    spec.robustness(machine.rollout({"vd": v}, 10_000 + i), params={"vd": v})["walking"]
                    for i in range(rollouts)
                ]
            )
            for v in SPEED
        ]
    )


def comparable(result: dict) -> dict:
    """Drop clocks and folders, at any depth."""
    if isinstance(result, dict):
        skip = ("seconds", "folder", "replay")
        return {key: comparable(value) for key, value in result.items() if key not in skip}
    return [comparable(value) for value in result] if isinstance(result, list) else result


def test_the_gap_contains_the_true_one(s2r):
    text = SPEC.replace("LIMIT", "0.1")
    result = s2r.json("gap", s2r.spec(text=text), "--sim", "toy", "--real", "toy:drag", "-q", code=0)
    delta = expected(text, "toy:drag") - expected(text, "toy")
    noise = 4 * 0.01 / np.sqrt(300)
    bound, band = result["worst_expected_gap"], result["band"]
    assert bound["lower"] - noise <= delta.min() <= bound["upper"] + noise
    assert band["low"] - noise <= delta.min() <= delta.max() <= band["high"] + noise
    assert result["worst"]["params"]["vd"] == pytest.approx(0.3, abs=0.1)
    assert result["worst"]["mean"] < -0.01
    assert result["label"] == "certified under the stated assumptions"


def test_two_equal_systems_have_no_signed_gap_but_an_absolute_one(s2r):
    result = s2r.json("gap", s2r.spec(text=FINE), "--sim", "toy", "--real", "toy", "-q", code=0)
    assert result["worst_expected_gap"]["lower"] <= 0 <= result["band"]["high"]
    assert abs(result["worst"]["mean"]) < 0.01
    assert result["largest_mean_absolute_gap"] > 0


def test_the_promise_is_true_of_the_real_side(s2r):
    text = SPEC.replace("LIMIT", "0.15")
    done = s2r(
        "certify", s2r.spec(text=text), "--sim", "toy", "--real", "toy:drag", "--run", "r", "-q", code=0
    )
    assert states(done.stdout, "walking  HOLDS", "1 − 0.002")
    result = s2r.json(
        "certify", "spec.stl", "--sim", "toy", "--real", "toy:drag", "--resume", "r", "-q", code=0
    )
    promise = result["promise"]
    truth = expected(text, "toy:drag").min()
    assert promise["paper_lower"] <= promise["lower"] <= truth <= promise["upper"]
    assert promise["delta"] == 0.002
    assert result["simulation"]["verdict"] == "holds"


def test_what_simulation_promises_the_gap_may_take_back(s2r):
    result = s2r.json("certify", s2r.spec(0.05), "--sim", "toy", "--real", "toy:drag", "-q", code=3)
    assert result["simulation"]["worst_expected_robustness"]["upper"] > 0
    assert result["promise"]["lower"] < 0
    assert result["verdict"] == "unknown"


def test_a_failure_of_the_real_side_is_shown(s2r):
    done = s2r("certify", s2r.spec(-0.05, FINE), "--sim", "toy", "--real", "toy:drag", "-q", code=1)
    assert "walking  VIOLATED" in done.stdout


def test_a_refused_simulation_costs_no_rollout_of_the_real_machine(s2r):
    text = SPEC.replace("LIMIT", "0.1").replace("R = 0.02", "R = 0.002")
    words = ("certify", s2r.spec(text=text), "--sim", "toy", "--real", "toy:drag", "-q")
    done = s2r(*words, "--run", "r", code=3)
    assert states(done.stdout, "R = 0.002", "toy:drag")
    assert not (s2r.folder / "r" / "gap").exists()
    result = s2r.json(*words, "--resume", "r", code=3)
    assert (result["promise"], result["gap"], result["verdict"]) == (None, None, "unknown")


def test_search_1_of_certify_is_check(s2r):
    both = s2r.json("certify", s2r.spec(0.15), "--sim", "toy", "--real", "toy", "-q", code=0)
    alone = s2r.json("check", "spec.stl", "-b", "toy", "--stop", "epsilon", "-q", code=0)["results"][0]
    assert comparable(both["simulation"]) == comparable(alone)


def test_kill_9_then_resume_gives_the_same_promise(s2r):
    words = ("certify", s2r.spec(0.15), "--sim", "toy", "--real", "toy:waits", "-q")
    whole = s2r.json(*words, "--run", "whole", code=0)
    with waiting(s2r, *words, "--run", "cut") as command:
        until(lambda: rollouts_in(s2r.folder / "cut" / "gap" / "real" / "journal.jsonl") > 5, 300)
        command.process.kill()
        command.process.join()
    assert comparable(s2r.json(*words, "--resume", "cut", code=0)) == comparable(whole)


def test_a_known_verdict_on_the_machine_may_end_its_rollouts(s2r):
    words = (s2r.spec(0.15, FINE), "--sim", "toy", "--real", "toy:drag", "-q")
    usual = s2r.json("certify", *words, code=0)
    result = s2r.json("certify", *words, "--stop", "decided", code=0)
    assert result["gap"]["label"] == "decided (valid interval)"
    assert result["gap"]["search"]["rollouts"] < usual["gap"]["search"]["rollouts"]
    assert comparable(result["simulation"]) == comparable(usual["simulation"])
    assert result["promise"]["lower"] >= 0
    assert states(s2r("gap", *words, "--stop", "decided", code=2).stderr, "stop", "'decided'", "certify")


@pytest.mark.parametrize("command", ["gap", "certify"])
def test_bad_input_gets_a_sentence(s2r, command):
    spec = s2r.spec()
    assert "--real" in s2r(command, spec, code=2).stderr
    assert states(s2r(command, spec, "--sim", "toy", "--real", "tay", code=2).stderr, "'tay'", "toy")
    done = s2r(command, spec, "--sim", "toy", "--real", "toy", "--resume", "nowhere", code=2)
    assert "nowhere" in done.stderr
    assert "Traceback" not in done.stderr
