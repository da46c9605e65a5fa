"""A pilot proposes a certify line: the models on known functions, and runs on small backends."""

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.pilot.design import design
from s2r_spec.certify.pilot.noise import noise_of
from s2r_spec.certify.pilot.proposal import Evidence, Outcomes, propose, propose_fall
from s2r_spec.certify.pilot.run import pilot
from s2r_spec.certify.pilot.surface import LONGEST, Means, fit_kernel
from s2r_spec.errors import UsageError
from s2r_spec.runs.journal import Journal
from s2r_spec.space import Space
from s2r_spec.spec import CertifySettings
from s2r_spec.workers.pools import in_this_process
from tests.certify.rkhs import RandomFunction
from tests.errors import naming

LINE = Space.of({"vd": (0.0, 1.0)}, {"vd": "m/s"})
PLANE = Space.of({"x": (0.0, 1.0), "y": (0.0, 30.0)})
THREAD = {"executor": in_this_process}
SPEC = """\
signal vx {m/s}
param  vd {m/s} in [-0.2, 0.3]
require walking: always[0.5 s, 1.5 s] (abs(vx - vd) <= 0.1 {m/s})
"""


def proposed(groups, space=LINE, declared=None, failures=0, fall=None):
    """Return the proposal from the outcomes at the tests of a grid."""
    tests = design(space, 4 * len(groups))
    outcomes = {"ρ": Outcomes(tuple(map(np.asarray, groups)), failures)}
    evidence = Evidence(space, tests.points, tests.spacing, outcomes, None, "m")
    fall = propose_fall(fall, np.concatenate(groups)) if fall is None else fall
    return propose(evidence, declared or CertifySettings(), fall)


def sampled(mean, noise, rng, space=LINE, tests=15):
    """Return four outcomes of a function of (n, dim) points at each test, with Gaussian noise."""
    values = mean(design(space, 4 * tests).points)
    return [value + noise * rng.normal(size=4) for value in values]


def slope(points):
    return 0.2 + 0.1 * points[:, 0]


class TestNoise:
    def test_its_upper_limit_covers_the_deviation_as_often_as_it_says(self):
        rng = np.random.default_rng(0)
        noises = [noise_of(list(rng.normal(size=(10, 4)))) for _ in range(400)]
        assert 0.92 < np.mean([noise.upper >= 1 for noise in noises]) < 0.98
        assert np.mean([noise.std**2 for noise in noises]) == pytest.approx(1, rel=0.03)
        assert sum(noise.noisiest is not None for noise in noises) <= 12

    def test_a_test_with_more_noise_than_the_others_is_found(self):
        rng = np.random.default_rng(0)
        groups = list(rng.normal(size=(15, 4)))
        groups[7] = 8 * groups[7]
        noise = noise_of(groups)
        assert noise.noisiest == 7
        assert noise.upper > 4 > noise.std

    def test_rare_large_noise_is_warned_of(self):
        rng = np.random.default_rng(0)
        scatter = 0.003 * rng.normal(size=(30, 10))
        scatter[4, 2] = -0.5
        assert noise_of(list(scatter)).warning
        assert noise_of(list((rng.uniform(size=(50, 10)) < 0.01) * 1.0)).warning
        assert not noise_of(list(rng.normal(size=(30, 10)))).warning

    def test_too_few_replicates_are_refused(self):
        with pytest.raises(UsageError, match=r"\b2\b.*replicates"):
            noise_of([[1.0, 2.0, 3.0]])


class TestKernel:
    def test_three_times_the_norm_covers_what_further_tests_show(self):
        """A kernel as rough as the function would not: its norm grows with every further test."""
        covered = []
        tests, dense = design(LINE, 60), design(LINE, 4 * 121).points
        for seed in range(24):
            rng = np.random.default_rng(seed)
            function = RandomFunction(Kernel(("matern32", "matern52", "rbf")[seed % 3], 0.3), LINE, 1.0, rng)
            values = function(tests.points) + 0.02 * rng.normal(size=15)
            means = Means(tests.points, values, np.full(15, 4.0), 0.04)
            kernel = fit_kernel(LINE, [means], tests.spacing).kernel
            exact = Means(dense, function(dense), np.full(121, 1.0), 1e-3)
            covered.append(exact.norm(kernel) <= 3 * means.norm(kernel))
        assert sum(covered) >= 23

    def test_each_axis_has_its_own_lengthscale(self):
        rng = np.random.default_rng(0)
        tests = design(PLANE, 4 * 49)
        means = np.sin(8 * tests.points[:, 0]) + 0.01 * tests.points[:, 1]
        means += 0.01 * rng.normal(size=len(means))
        surface = fit_kernel(PLANE, [Means(tests.points, means, np.full(49, 4.0), 0.02)], tests.spacing)
        x, y = surface.kernel.lengthscales(2)
        assert x < 0.6
        assert y == pytest.approx(LONGEST * tests.spacing[1])

    def test_the_norm_is_below_the_true_one_and_not_far(self):
        kernel = Kernel("matern52", 0.3)
        ratios = []
        for seed in range(20):
            rng = np.random.default_rng(seed)
            tests = design(LINE, 60)
            function = RandomFunction(kernel, LINE, 2.0, rng)
            means = function(tests.points) + 0.01 * rng.normal(size=15)
            ratios.append(Means(tests.points, means, np.full(15, 4.0), 0.02).norm(kernel) / 2)
        assert 0.4 < np.median(ratios) <= 1.05


class TestProposal:
    def test_r_covers_the_known_noise_and_the_test_of_r_does_not_refute_it(self):
        for seed in range(20):
            proposal = proposed(sampled(slope, 0.01, np.random.default_rng(seed)))
            assert 0.01 * 2 < proposal.settings.R < 0.01 * 6
            assert not proposal.warnings

    def test_epsilon_is_half_of_the_worst_mean(self):
        proposal = proposed(sampled(slope, 1e-3, np.random.default_rng(0)))
        assert proposal.settings.epsilon == pytest.approx(0.1, rel=0.05)
        assert proposal.worst["vd"] < 0.1
        below = proposed(sampled(lambda points: slope(points) - 0.5, 1e-3, np.random.default_rng(0)))
        assert below.settings.epsilon == pytest.approx(0.15, abs=0.011)

    def test_a_worst_mean_near_0_is_warned_of(self):
        proposal = proposed(sampled(lambda points: 0.1 * points[:, 0], 0.1, np.random.default_rng(0)))
        assert proposal.warnings
        assert proposal.settings.epsilon > 0.01

    def test_a_certificate_with_the_line_holds_on_functions_of_the_kernel(self):
        """The certificate's rollouts are new ones."""
        refused = 0
        for seed in range(12):
            rng = np.random.default_rng(seed)
            function = RandomFunction(Kernel("matern52", 0.3), LINE, 1.0, rng)

            def mean(points, function=function):
                return 0.5 + 0.3 * function(points)

            line = proposed(sampled(mean, 0.02, rng)).settings
            search = s2r.Search(
                LINE,
                kernel=Kernel(line.kernel.name, line.kernel.lengthscales),
                B=line.B, R=line.R, delta=line.delta, epsilon=line.epsilon, stop="decided",
            )  # fmt: skip
            while not search.done:
                for query in search.ask():
                    value = -mean(LINE.vector(query.point)[None])[0]
                    search.tell(query, value + 0.02 * rng.normal(size=query.replicates))
            refused += search.certificate().label is Label.REFUSED
        assert refused <= 1

    def test_a_declared_delta_and_fall_stay_and_a_fall_among_the_outcomes_does_not(self):
        groups = sampled(slope, 0.01, np.random.default_rng(0))
        declared = CertifySettings(delta=1e-6, fall=-2.0)
        proposal = proposed(groups, declared=declared, fall=-2.0)
        assert (proposal.settings.delta, proposal.settings.fall) == (1e-6, -2.0)
        assert propose_fall(-0.1, np.array([-0.3, 0.2])) == -0.6
        assert propose_fall(-0.5, np.array([-0.3, 0.2])) == -0.5
        with pytest.raises(UsageError, match="failed"):
            propose_fall(None, np.zeros(0))

    def test_without_noise_r_follows_from_epsilon(self):
        values = slope(design(LINE, 60).points)
        proposal = proposed([np.full(4, value) for value in values])
        assert pytest.approx(proposal.settings.epsilon / 100, rel=0.1) == proposal.settings.R
        assert "no noise" in proposal.reasons["R"]
        assert proposal.expected[0] < 100

    def test_a_fall_makes_r_the_half_range(self):
        groups = sampled(slope, 0.01, np.random.default_rng(0))
        groups[3] = np.append(groups[3][1:], -0.6)
        proposal = proposed(groups, failures=1, fall=-0.6)
        highest = max(group.max() for group in groups)
        assert pytest.approx((highest + 0.6) / 2, rel=0.1) == proposal.settings.R
        assert proposal.warnings


class TestDesign:
    @pytest.mark.parametrize(("dim", "tests"), [(1, 15), (2, 25), (3, 27), (4, 40)])
    def test_it_covers_the_space(self, dim, tests):
        space = Space.of({f"d{i}": (0.0, 1.0) for i in range(dim)})
        points = design(space, None).points
        assert points.shape == (tests, dim)
        assert ((points >= 0) & (points <= 1)).all()
        assert (points.min(axis=0) < 0.1).all()
        assert (points.max(axis=0) > 0.9).all()
        assert len(np.unique(points, axis=0)) == tests

    def test_a_budget_is_not_exceeded_and_may_be_too_small(self):
        assert 4 * len(design(PLANE, 200).points) <= 200
        with pytest.raises(UsageError, match=naming("budget = 19", "20 rollouts")):
            design(LINE, 19)


def test_settings_of_a_gap_that_the_new_line_lacks_are_named():
    groups = sampled(slope, 0.01, np.random.default_rng(0))
    assert not proposed(groups, declared=CertifySettings(delta=1e-3)).warnings
    (words,) = proposed(groups, declared=CertifySettings(gap_B=0.1)).warnings
    assert words.startswith("gap_B ")


@pytest.mark.parametrize(("tests", "warned"), [(5, True), (9, False)])
def test_a_pilot_without_tests_at_the_ends_of_the_ranges_says_so(tests, warned):
    rng = np.random.default_rng(0)
    found = proposed(sampled(slope, 0.01, rng, PLANE, tests), PLANE)
    assert any("ends" in words for words in found.warnings) is warned


@pytest.mark.usefixtures("toy")
class TestRun:
    def test_the_line_makes_a_certificate_on_other_seeds(self, tmp_path):
        found = pilot(s2r.parse_spec(SPEC, "spec.stl"), "toy", tmp_path / "pilot", **THREAD)
        spec = s2r.parse_spec(f"{SPEC}{found.line}\n", "spec.stl")
        assert spec.certify["walking"] == found.proposal.settings
        assert 0.01 < found.proposal.settings.R < 0.06
        checked = s2r.check(spec, "toy", tmp_path / "run", stop="decided", **THREAD)
        assert checked.certificate.label.bounds
        seeds = [{one.seed for one in Journal.read(tmp_path / run).records()} for run in ("pilot", "run")]
        assert len(seeds[0]) == found.rollouts
        assert not seeds[0] & seeds[1]

    def test_it_is_repeatable_and_resumes(self, tmp_path):
        spec = s2r.parse_spec(SPEC, "spec.stl")
        first = pilot(spec, "toy", tmp_path / "run", budget=40, seed=3, **THREAD)
        journal = tmp_path / "run" / "journal.jsonl"
        whole = journal.read_text()
        journal.write_text("".join(whole.splitlines(keepends=True)[:-5]))
        again = pilot(spec, "toy", tmp_path / "run", resume=True, **THREAD)
        assert again.line == first.line
        assert (again.rollouts, again.tests) == (40, 10)
        with pytest.raises(UsageError, match="40"):
            pilot(spec, "toy", tmp_path / "run", resume=True, budget=80, **THREAD)

    def test_falls_are_counted_and_enter_as_fall(self, tmp_path):
        found = pilot(s2r.parse_spec(SPEC, "spec.stl"), "toy:fall", tmp_path / "run", **THREAD)
        assert sum(found.failures.values()) == 4  # the test at the upper end, at which every rollout falls
        assert found.proposal.lowest_mean == found.proposal.settings.fall
        assert found.proposal.warnings

    def test_a_gap_has_rollouts_of_both(self, tmp_path):
        spec = s2r.parse_spec(SPEC, "spec.stl")
        found = pilot(spec, "toy", tmp_path / "run", real="toy:drag", **THREAD)
        assert found.backends == ("toy", "toy:drag")
        assert found.rollouts == 15 * 4 * 3
        line = s2r.parse_spec(f"{SPEC}{found.line}\n", "spec.stl")
        result = s2r.gap(line, "toy", "toy:drag", tmp_path / "gap", budget=800, **THREAD)
        assert result.certificate.label.bounds
        settings = found.proposal.settings
        assert settings.gap_B < settings.B  # the drag changes E ρ by less than E ρ is
        assert settings.gap_epsilon <= settings.gap_B
        assert [result.certificate.settings[name] for name in "BR"] == [settings.gap_B, settings.gap_R]
        seeds = [
            {one.seed for one in Journal.read(tmp_path / run / side).records()}
            for run in ("run", "gap")
            for side in ("sim", "real")
        ]
        assert sum(map(len, seeds)) == len(set.union(*seeds))

    def test_what_is_no_pilot_is_refused(self, tmp_path):
        fixed = SPEC.replace("in [-0.2, 0.3]", "= 0.1")
        with pytest.raises(UsageError, match=naming("test space")):
            pilot(s2r.parse_spec(fixed, "spec.stl"), "toy", tmp_path / "run", **THREAD)
        with pytest.raises(UsageError, match=naming("budget = 8")):
            pilot(s2r.parse_spec(SPEC, "spec.stl"), "toy", tmp_path / "run", budget=8, **THREAD)


def test_the_seeds_of_the_streams_differ():
    from s2r_spec.runs.seeds import SeedStream, rollout_seed

    seeds = {rollout_seed(0, q, r, stream) for stream in SeedStream for q in range(8) for r in range(4)}
    assert len(seeds) == 32 * len(SeedStream)
