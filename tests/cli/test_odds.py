import json

from tests.cli.conftest import FINE


def test_how_likely_a_rollout_of_a_check_is_to_fail(s2r):
    s2r("check", s2r.spec(text=FINE), "-b", "toy", "-q", "--stop", "epsilon", "--run", "r", code=0)
    done = s2r("odds", "r", "--B", 0.5, "--below", 0, "--below", 0.09, code=0).stdout
    assert "walking: " in done
    assert "P(ρ < 0 m/s) ≤ 0." in done
    assert "0 of" in done
    found = json.loads(s2r("odds", "r/walking", "--B", 0.5, "--json", code=0).stdout)
    (level,) = found["results"]["walking"]["levels"]
    assert (level["level"], level["seen"], level["lower"]) == (0.0, 0, 0.0)
    assert 0 < level["upper"] < 0.5
    assert " ." in s2r("odds", ".", "--B", 0.5, code=2).stderr


def test_a_refused_bound_is_said_as_a_sentence(s2r):
    s2r("check", s2r.spec(-0.05), "-b", "toy", "-q", "--run", "r", code=1)
    assert "no bound" in s2r("odds", "r", "--B", 0.3, code=0).stdout
