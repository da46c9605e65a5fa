"""Stopping rules: a search ends when ε is reached, when its verdict is known, or when its budget is spent."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.base.verdict import Verdict
from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.gap import gap
from s2r_spec.certify.real_machine import certify
from s2r_spec.certify.search.search import Search
from s2r_spec.errors import UsageError
from s2r_spec.report.recompute import recompute, recompute_certify, recompute_gap
from s2r_spec.runs.journal import Journal
from s2r_spec.space import Space
from s2r_spec.workers.pools import in_this_process
from tests.certify.rkhs import run
from tests.errors import naming

LINE = Space.of({"vd": (0.0, 1.0)}, {"vd": "m/s"})
KERNEL = Kernel("matern52", 0.3)
USUAL = {"kernel": KERNEL, "B": 1.5, "R": 0.05, "delta": 0.01, "epsilon": 0.15}
THREAD = {"executor": in_this_process}
TURTLEBOT = Path(__file__).parents[2] / "specs" / "turtlebot.stl"
SPEC = """\
signal vx {m/s}
param  vd {m/s} in [-0.2, 0.3]
require walking: always[0.5 s, 1.5 s] (abs(vx - vd) <= LIMIT {m/s})
certify walking: delta = 1e-3, epsilon = 0.05, B = 0.5, R = 0.02, kernel = rbf(0.2 {m/s}), fall = -0.5
"""


def searched(level, scatter=0.02, **changes):
    """Return a finished search whose J is near ``level`` everywhere."""
    search = Search(LINE, **(USUAL | changes))

    def function(points):
        return np.full(len(np.atleast_2d(points)), level)

    run(search, function, scatter, np.random.default_rng(0))
    return search


def check(tmp_path, limit=0.1, backend="toy", run="run", **words):
    spec = s2r.parse_spec(SPEC.replace("LIMIT", str(limit)), "spec.stl")
    return s2r.check(spec, backend, tmp_path / run, **THREAD, **words)


@pytest.fixture(scope="module")
def whole_runs(tmp_path_factory):
    """Return what copies a run of 700 rollouts to a folder and returns its result; each limit runs once."""
    results = {}

    def run_of(limit, folder):
        if limit not in results:
            results[limit] = check(tmp_path_factory.mktemp("whole"), limit, stop="budget", budget=700)
        shutil.copytree(results[limit].folder, folder)
        return results[limit]

    return run_of


def facts(result):
    """Return a result without clocks and folders."""
    return replace(result, seconds=0.0, folder=Path(), lowest=replace(result.lowest, seconds=0.0))


def assert_counts(result, records):
    """Compare every number on rollouts with one from the records."""
    tests = {}
    for record in records:
        tests.setdefault(tuple(record.params.values()), []).append(record.rho)
    certificate, worst = result.certificate, tests[tuple(result.worst.params.values())]
    assert (certificate.rollouts, certificate.points) == (len(records), len(tests))
    assert (result.worst.rollouts, result.worst.lowest, result.worst.highest) == (
        len(worst),
        min(worst),
        max(worst),
    )
    assert result.worst.mean == pytest.approx(np.mean(worst))
    assert result.lowest.rho == min(record.rho for record in records)
    assert sum(result.failures.values()) == sum(record.failure is not None for record in records)
    assert result.seconds == pytest.approx(sum(record.seconds for record in records))
    search = s2r.Search(result.spec.space, **{
        name: certificate.settings[name] for name in ("B", "R", "delta", "epsilon")
    }, kernel=Kernel("rbf", (0.2,)))  # fmt: skip
    search.observe([(record.params, [-record.rho]) for record in records], final=True)
    assert certificate.lower >= search.certificate().lower - 1e-9  # the run intersected earlier bounds


class TestSearch:
    @pytest.mark.parametrize("level", [-0.4, 0.4])
    def test_it_ends_with_the_batch_that_excludes_0(self, level):
        decided, usual = searched(level, stop="decided").certificate(), searched(level).certificate()
        assert decided.label is Label.DECIDED
        assert decided.label.bounds
        assert decided.upper <= 0 or decided.lower > 0
        assert decided.lower <= level <= decided.upper
        assert decided.rollouts < usual.rollouts
        assert (usual.label, decided.settings) == (Label.CERTIFIED, usual.settings)
        assert set(usual.assumptions) < set(decided.assumptions)

    def test_near_0_it_ends_when_epsilon_is_reached(self):
        decided, usual = searched(0.0, stop="decided").certificate(), searched(0.0).certificate()
        assert decided.label is Label.CERTIFIED
        assert (decided.rollouts, decided.lower, decided.upper) == (usual.rollouts, usual.lower, usual.upper)

    def test_the_test_of_r_has_20_degrees_of_freedom_before_a_verdict_ends_the_search(self):
        """One batch is enough for the sign of 0.9."""
        known = searched(0.9, stop="decided", repeats=True, B=4.0)
        assert known.certificate().label is Label.DECIDED
        assert known.degrees == 20
        assert (known.certificate().rollouts, len(known.tested)) == (27, 4)  # what is lacking are repeats
        one_batch = searched(0.9, stop="decided", B=4.0, budget=8)
        assert one_batch.certificate().lower > 0
        assert one_batch.degrees < 20
        assert one_batch.certificate().label is Label.BUDGET

    def test_an_r_that_is_too_small_is_refuted_before_a_verdict_counts(self):
        certificate = searched(0.9, scatter=0.25, stop="decided", B=2.0).certificate()
        assert certificate.label is Label.REFUSED

    def test_every_eighth_of_a_long_axis_is_tested_before_a_verdict_ends_the_search(self):
        long = searched(0.5, stop="decided", kernel=Kernel("matern52", 1.5), B=2.0)
        assert long.certificate().label is Label.DECIDED
        assert len(set((long.tested[:, 0] * 8).astype(int).clip(0, 7))) == 8

    def test_only_a_budget_ends_a_search_under_the_rule_budget(self):
        spent, usual = searched(0.3, stop="budget", budget=1000), searched(0.3)
        assert usual.certificate().rollouts < 900 < spent.certificate().rollouts <= 1000
        assert spent.certificate().epsilon < usual.certificate().epsilon <= usual.epsilon
        assert spent.certificate().label is Label.CERTIFIED
        assert searched(0.3, stop="budget", budget=40).certificate().label is Label.BUDGET

    def test_the_tests_are_the_same_under_every_rule(self):
        usual = searched(0.3).tested
        for rule in ("decided", "budget"):
            other = searched(0.3, stop=rule, budget=600).tested
            shorter = min(len(usual), len(other))
            assert np.array_equal(other[:shorter], usual[:shorter])

    def test_another_rule_gets_a_sentence(self):
        with pytest.raises(UsageError, match=naming("stop", "'soon'", "budget, decided, epsilon")):
            Search(LINE, **USUAL, stop="soon")


def test_the_turtlebot_holds_before_350_rollouts(tmp_path):
    result = s2r.check(s2r.load_spec(TURTLEBOT), "turtlebot", tmp_path / "run", stop="decided", **THREAD)
    assert (result.verdict, result.certificate.label) == (Verdict.HOLDS, Label.DECIDED)
    assert result.certificate.rollouts < 350


@pytest.mark.usefixtures("toy")
class TestRuns:
    @pytest.mark.parametrize(("limit", "verdict"), [(0.1, Verdict.HOLDS), (-0.05, Verdict.VIOLATED)])
    def test_the_verdict_is_the_one_of_epsilon_and_its_report_the_same(self, tmp_path, limit, verdict):
        usual = check(tmp_path, limit, stop="epsilon", run="usual")
        decided = check(tmp_path, limit)
        assert decided.verdict is usual.verdict is verdict
        assert decided.certificate.rollouts < usual.certificate.rollouts
        assert facts(recompute(tmp_path / "run").result) == facts(decided)

    def test_a_resumed_run_keeps_its_rule_and_its_next_test(self, tmp_path):
        whole = check(tmp_path, stop="decided", run="whole")
        check(tmp_path, stop="decided", budget=20)
        resumed = check(tmp_path, resume=True)
        assert facts(resumed) == facts(whole)

    def test_a_decided_run_may_go_on_to_epsilon(self, tmp_path):
        whole = check(tmp_path, stop="epsilon", repeats=True, run="whole")
        early = check(tmp_path)
        resumed = check(tmp_path, stop="epsilon", resume=True)
        assert early.certificate.rollouts < resumed.certificate.rollouts
        assert facts(resumed) == facts(whole)
        assert facts(recompute(tmp_path / "run").result) == facts(whole)
        assert facts(check(tmp_path, resume=True)) == facts(whole)

    @pytest.mark.parametrize("limit", [0.1, -0.05])
    @pytest.mark.parametrize("words", [{"stop": "decided"}, {"budget": 30}, {"stop": "epsilon"}])
    def test_a_rule_that_needs_fewer_rollouts_than_are_on_disk_gets_all_of_them(
        self, tmp_path, whole_runs, limit, words
    ):
        whole = whole_runs(limit, tmp_path / "run")
        assert check(tmp_path, limit, run="few", **words).certificate.rollouts < whole.certificate.rollouts
        resumed = check(tmp_path, limit, resume=True, **words)
        records = Journal.read(tmp_path / "run").records()
        assert resumed.certificate.rollouts == len(records) == whole.certificate.rollouts
        assert_counts(resumed, records)
        assert (resumed.lower, resumed.upper, resumed.certificate.ladder) == (
            whole.lower,
            whole.upper,
            whole.certificate.ladder,
        )
        assert facts(recompute(tmp_path / "run").result) == facts(resumed)

    def test_an_incomplete_batch_beyond_the_rule_is_left_out_of_every_number(self, tmp_path, whole_runs):
        whole_runs(0.1, tmp_path / "run")
        journal = tmp_path / "run" / "journal.jsonl"
        lines = journal.read_bytes().splitlines(keepends=True)
        journal.write_bytes(b"".join(lines[:-1]))
        resumed = check(tmp_path, stop="decided", resume=True)
        records = Journal.read(tmp_path / "run").records()
        assert len(records) == len(lines) - 2  # nothing ran
        assert 0 < resumed.certificate.rollouts < len(records)
        assert_counts(resumed, records[: resumed.certificate.rollouts])
        left = len(records) - resumed.certificate.rollouts
        assert any(text.startswith(f"{left} rollouts") for text in resumed.assumptions)
        assert facts(recompute(tmp_path / "run").result) == facts(resumed)

    def test_a_journal_with_an_unknown_rule_gets_a_sentence(self, tmp_path):
        check(tmp_path, stop="decided")
        journal = Journal.read(tmp_path / "run")
        journal._write("the rule", {"kind": "stop", "stop": "soon"})
        with pytest.raises(UsageError, match=naming("stop", "soon")):
            check(tmp_path, resume=True)

    def test_a_rule_needs_what_it_waits_for(self, tmp_path):
        with pytest.raises(UsageError, match=naming("stop", "'budget'")):
            check(tmp_path, stop="budget")
        spec = s2r.parse_spec(SPEC.replace("LIMIT", "0.1"), "spec.stl")
        with pytest.raises(UsageError, match=naming("stop", "'decided'", "certify")):
            gap(spec, "toy", "toy:drag", tmp_path / "run", stop="decided")
        with pytest.raises(UsageError, match=naming("stop", "'soon'")):
            gap(spec, "toy", "toy:drag", tmp_path / "run", stop="soon")

    def test_a_gap_may_spend_its_budget(self, tmp_path):
        spec = s2r.parse_spec(SPEC.replace("LIMIT", "0.1").replace("0.05, B", "0.1, B"), "spec.stl")
        usual = gap(spec, "toy", "toy:drag", tmp_path / "usual", **THREAD)
        spent = gap(spec, "toy", "toy:drag", tmp_path / "run", stop="budget", budget=200, **THREAD)
        assert usual.certificate.rollouts < spent.certificate.rollouts
        assert spent.certificate.epsilon < usual.certificate.epsilon
        assert replace(recompute_gap(tmp_path / "run").result, seconds=0) == replace(spent, seconds=0)

    def test_certify_ends_the_real_rollouts_when_the_verdict_on_the_machine_is_known(self, tmp_path):
        spec = s2r.parse_spec(SPEC.replace("LIMIT", "0.2"), "spec.stl")
        usual = certify(spec, "toy", "toy:drag", tmp_path / "usual", **THREAD)
        early = certify(spec, "toy", "toy:drag", tmp_path / "run", stop="decided", **THREAD)
        assert early.verdict is usual.verdict is Verdict.HOLDS
        assert early.composition.lower >= 0
        assert early.simulated.certificate == usual.simulated.certificate
        assert early.gap.certificate.label is Label.DECIDED
        assert early.gap.certificate.rollouts < usual.gap.certificate.rollouts
        again = recompute_certify(tmp_path / "run").result
        assert (again.verdict, again.composition, again.gap.certificate) == (
            early.verdict,
            early.composition,
            early.gap.certificate,
        )
        assert recompute_gap(tmp_path / "run" / "gap").result.certificate == early.gap.certificate
        resumed = certify(spec, "toy", "toy:drag", tmp_path / "run", resume=True, **THREAD)
        assert (resumed.composition, resumed.gap.certificate) == (early.composition, early.gap.certificate)

    def test_a_run_without_repeats_as_all_were_once_is_read_and_goes_on_without_them(self, tmp_path):
        without, usual = check(tmp_path, repeats=False), check(tmp_path, run="usual")
        assert "repeats" not in without.certificate.settings
        assert usual.certificate.rollouts < without.certificate.rollouts
        assert facts(recompute(tmp_path / "run").result) == facts(without)
        assert facts(check(tmp_path, resume=True)) == facts(without)

    @pytest.mark.parametrize(("R", "refused"), [(0.004, "gap_R = 0.004 "), (0.01, "gap_B = 0.004 ")])
    def test_a_refused_setting_of_the_gap_has_its_own_name(self, tmp_path, R, refused):
        own = f"-0.5, gap_B = 0.004, gap_epsilon = 0.002, gap_R = {R}"
        spec = s2r.parse_spec(SPEC.replace("LIMIT", "0.2").replace("-0.5", own), "spec.stl")
        certificate = gap(spec, "toy", "toy:drag", tmp_path / "run", **THREAD).certificate
        assert certificate.label is Label.REFUSED
        assert certificate.reason.startswith(refused)

    def test_a_smaller_bound_on_the_gap_saves_real_rollouts(self, tmp_path):
        def certified(own):
            spec = s2r.parse_spec(SPEC.replace("LIMIT", "0.2").replace("-0.5", f"-0.5{own}"), "spec.stl")
            return certify(spec, "toy", "toy:drag", tmp_path / str(len(own)), stop="decided", **THREAD)

        usual, small = map(certified, ("", ", gap_B = 0.15"))
        assert small.simulated.certificate == usual.simulated.certificate
        assert small.gap.certificate.rollouts < usual.gap.certificate.rollouts
        assert small.verdict is Verdict.HOLDS
        assert small.gap.certificate.ladder[0].B == 0.15


@pytest.mark.usefixtures("toy")
class TestSeeds:
    def test_a_resumed_run_keeps_its_seed(self, tmp_path):
        whole = check(tmp_path, seed=3, run="whole")
        check(tmp_path, seed=3, budget=20)
        resumed = check(tmp_path, resume=True)
        assert resumed.provenance["seed"] == 3
        assert facts(resumed) == facts(whole)
        assert facts(check(tmp_path, seed=3, resume=True)) == facts(whole)

    def test_another_seed_is_refused(self, tmp_path):
        check(tmp_path, seed=3, budget=20)
        for seed in (0, 4):
            with pytest.raises(UsageError, match=naming("seed 3", str(seed), "run")):
                check(tmp_path, seed=seed, budget=20, resume=True)
        assert len(Journal.read(tmp_path / "run")) <= 20

    def test_a_new_run_has_the_seed_0(self, tmp_path):
        assert check(tmp_path, budget=20).provenance["seed"] == 0

    def test_gap_and_certify_keep_it_too(self, tmp_path):
        spec = s2r.parse_spec(SPEC.replace("LIMIT", "0.2"), "spec.stl")
        for call, place in ((gap, "gap"), (certify, "certify")):
            first = call(spec, "toy", "toy:drag", tmp_path / place, seed=3, budget=20, **THREAD)
            again = call(spec, "toy", "toy:drag", tmp_path / place, budget=20, resume=True, **THREAD)
            assert str(again) == str(first)
            with pytest.raises(UsageError, match=naming("seed 3", "5")):
                call(spec, "toy", "toy:drag", tmp_path / place, seed=5, budget=20, resume=True, **THREAD)
