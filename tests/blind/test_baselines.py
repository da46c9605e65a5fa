"""The methods beside which the diagnosis is scored name a large effect of the simulator's own law."""

import numpy as np

from benchmarks.blind.baselines import METHODS, named, rates
from benchmarks.blind.development import axes, spec_of
from benchmarks.blind.emps.generate import write_case
from benchmarks.blind.outsiders.cases import Case, stratified
from benchmarks.blind.scoring import Scored
from s2r_spec.backend import load_backend
from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.spec import load_spec


def test_all_methods_name_a_large_bias_and_a_healthy_robot_has_no_large_single_effect(tmp_path):
    label = {"kind": "single", "effects": {"position_bias": {"left": 0.05}}}
    tests = stratified(load_spec(spec_of("turtlebot")), np.random.default_rng(0), 12)
    for folder, values in (("biased", label["effects"]), ("healthy", {})):
        robot = load_backend("turtlebot").with_effects(values)
        runs = [(test, robot.rollout(test, 100 + k)) for k, test in enumerate(tests)]
        write_case(Case(runs, [], label), folder, tmp_path, spec_of("turtlebot"))
    known, cache = {}, Cache(tmp_path / "cache")
    found = named(tmp_path / "public" / "biased", "turtlebot", cache, known)
    assert found == {method: ["position_bias"] for method in METHODS}
    assert named(tmp_path / "public" / "healthy", "turtlebot", cache, known)["single"] == []


def test_a_name_counts_by_the_size_of_its_effect():
    label = {"kind": "pair", "effects": {"motor_lag": {"time": 0.18}, "latency": {"delay": 0.05}}}
    answers = [{"verdict": "", "which": {"answer": [name]}} for name in ("motor_lag", "axle_length")]
    cases = [Scored("case", label, answer, axes("turtlebot")) for answer in answers]
    assert rates(cases) == {"must be named, and are": "1 of 4", "machines with a false name": "1 of 2"}
