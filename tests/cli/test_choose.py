import json

from tests.cli.conftest import FINE
from tests.errors import states


def test_the_controller_with_the_best_certified_worst_case_is_chosen(s2r):
    spec = s2r.spec()
    s2r("check", spec, "-b", "toy:drag", "-q", "--run", "a")
    s2r("check", spec, "-b", "toy", "-q", "--run", "b", code=0)
    found = json.loads(s2r("choose", "a", "b", "--json", code=0).stdout)
    bounds = {one["backend"]: one for one in found["candidates"]}
    assert set(bounds) == {"toy:drag", "toy"}
    assert found["best"] == max(bounds, key=lambda name: bounds[name]["lower"]) == "toy"
    assert found["delta"] == 2e-3  # the spec's, of each
    assert found["regret"] == max(0.0, bounds["toy:drag"]["upper"] - bounds["toy"]["lower"])
    text = s2r("choose", "a", "b", code=0).stdout
    assert states(next(line for line in text.splitlines() if "toy" in line and "ρ" in line), "toy")
    assert text.count("→") == 1


def test_a_choice_needs_checks_that_can_be_compared(s2r):
    spec = s2r.spec()
    s2r("check", spec, "-b", "toy", "-q", "--run", "a", code=0)
    assert "two" in s2r("choose", "a", code=2).stderr
    assert "'toy'" in s2r("choose", "a", "a", code=2).stderr


def test_where_nothing_can_be_chosen_both_forms_exit_with_3(s2r):
    spec = s2r.spec(text=FINE.replace("B = 0.5", "B = 0.03"))
    for backend, run in (("toy", "a"), ("toy:drag", "b")):
        s2r("check", spec, "-b", backend, "-q", "--run", run, "--budget", 60, code=3)
    assert "refused" in s2r("choose", "a", "b", code=3).stdout
    assert json.loads(s2r("choose", "a", "b", "--json", code=3).stdout)["best"] is None
