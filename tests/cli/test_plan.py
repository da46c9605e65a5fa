import pytest

from tests.cli.conftest import SPEC
from tests.errors import states

SETTINGS = ("--R", 0.05, "--eps", 0.1, "--delta", 1e-3, "--B", 1.5)


def test_settings_by_hand(s2r):
    plan = s2r.json("plan", *SETTINGS, "--budget", 40, code=0)
    assert plan["floor"] < plan["minimax"]
    assert plan["peaked"] <= plan["expected"] <= plan["flat"]
    assert plan["reachable"][0][0] == plan["reachable_range"][0][0] == 40
    assert 0 < plan["reachable_range"][0][1] < plan["reachable"][0][1] < plan["reachable_range"][0][2]


def test_settings_from_a_spec_and_times_from_a_backend(s2r):
    plan = s2r.json("plan", s2r.spec(), "--backend", "toy", code=0)
    assert (plan["R"], plan["epsilon"], plan["delta"], plan["B"]) == (0.02, 0.1, 1e-3, 0.5)
    assert plan["seconds_per_rollout"] > 0
    assert "about" in s2r("plan", s2r.spec(), "--backend", "toy", code=0).stdout


def test_what_is_impossible_is_said(s2r):
    done = s2r("plan", "--R", 0.1, "--eps", 0.03, "--delta", 1e-6, "--B", 1.5, "--kernel", "rbf", code=0)
    assert states(done.stdout, "307 rollouts", "1004 rollouts")
    assert states(done.stderr, "estimates")


def test_what_nobody_can_run_is_called_larger_than_any_number(s2r):
    words = ("--R", 0.1, "--eps", 0.003, "--delta", 1e-6, "--B", 1.5)
    assert states(s2r("plan", *words, code=0).stdout, "30701 rollouts", "more than 2000000")
    assert s2r.json("plan", *words, "-q", code=0)["flat"] is None


def test_a_proven_range_gives_the_proxy(s2r):
    words = ("--eps", 0.5, "--delta", 1e-3, "--B", 1.5)
    assert s2r.json("plan", "--range", -0.5, 0.1, *words, code=0)["R"] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("words", "facts"),
    [
        (("--R", 1), ["--eps, --delta, --B"]),
        ((*SETTINGS, "--range", 0, 1), ["--range", "--R"]),
        ((*SETTINGS, "--kernel", "rfb"), ["'rfb'", "did you mean 'rbf'"]),
        ((*SETTINGS[:-1], -1), ["B = -1"]),
    ],
)
def test_bad_input_gets_a_sentence(s2r, words, facts):
    done = s2r("plan", *words, code=2)
    assert states(done.stderr, *facts), done.stderr
    assert "Traceback" not in done.stderr


def test_a_spec_without_settings_names_what_is_missing(s2r):
    spec = s2r.spec(text=SPEC.replace("certify walking: ", "# "))
    assert "--R, --eps, --delta, --B" in s2r("plan", spec, code=2).stderr
