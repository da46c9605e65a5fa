"""A violation that needs no B: the certificate is refused because of B, and its upper end still holds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import s2r_spec as s2r
from s2r_spec.base.verdict import Verdict
from s2r_spec.certify.bound import confidence
from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.search.search import Search
from s2r_spec.report import check as check_report
from s2r_spec.report.recompute import recompute
from s2r_spec.space import Space
from s2r_spec.workers.pools import in_this_process
from tests.examples import examples

LINE = Space.of({"vd": (0.0, 1.0)})
USUAL = {"kernel": Kernel("matern52", 0.3), "B": 0.1, "R": 0.05, "delta": 0.01, "epsilon": 0.05}
SPEC = """\
signal x {m}
param  vd {m/s} in [0, 1]
require stays: always (x <= 1 {m})
certify stays: delta = 1e-3, epsilon = EPSILON, B = BOUND, R = 0.05, kernel = matern52(0.3 {m/s}), fall = -2
"""


def searched(level, scatter=0.04, drift=0.0, **changes):
    """Return a finished search whose J is near ``level``; each further batch is ``drift`` higher."""
    search, rng, batch = Search(LINE, **(USUAL | changes)), np.random.default_rng(0), 0
    while not search.done:
        for query in search.ask():
            search.tell(query, level + batch * drift + scatter * rng.normal(size=query.replicates))
        batch += 1
    return search


def cart(params, seed):
    """Return a trace that leaves its bound by 0.8 m at every test."""
    noise = np.random.default_rng(seed).normal(0, 0.03)
    return s2r.Trace([0.0, 0.5, 1.0], {"x": np.full(3, 1.8 + noise)})


def check(tmp_path, bound, epsilon=0.05):
    text = SPEC.replace("BOUND", str(bound)).replace("EPSILON", str(epsilon))
    spec = s2r.parse_spec(text, "cart.stl")
    return s2r.check(spec, s2r.FunctionBackend(cart), tmp_path / "run", executor=in_this_process)


@given(
    st.lists(st.tuples(st.integers(1, 50), st.floats(-30, 30)), min_size=1, max_size=12),
    st.floats(0.5, 200),
)
@settings(max_examples=examples(200), deadline=None)
def test_the_bound_is_the_smallest_maximum_that_fits(tests, radius):
    counts, means = (np.array(column, dtype=float) for column in zip(*tests, strict=True))
    bound = confidence.norm_free_lower(counts, means, radius)
    assert bound < means.max()
    assert (counts * np.maximum(means - bound, 0) ** 2).sum() == pytest.approx(radius, rel=1e-6)


class TestSearch:
    def test_it_bounds_a_maximum_whose_norm_is_larger_than_b(self):
        search = searched(0.8)
        assert search.certificate().label is Label.REFUSED
        found = search.one_sided()
        assert found.label is Label.ONE_SIDED
        assert found.label.certifies
        assert not found.label.bounds
        assert 0.5 < found.lower < 0.8
        assert found.worst["vd"] in search.tested
        assert found.delta == USUAL["delta"]
        norm, *others = search.certificate().assumptions
        assert set(found.assumptions) <= set(others)
        assert norm not in found.assumptions

    @pytest.mark.parametrize(
        "changes",
        [
            {"level": -0.8},  # it holds as far as one sees; a lower end of ρ needs B
            {"level": 0.8, "scatter": 0.4},  # R is refuted
            {"level": 0.8, "fitted": ("R",)},
            {"level": 0.8, "mode": "paper"},
            {"level": 0.1, "B": 1.5},  # nothing is refused
        ],
    )
    def test_it_needs_a_violation_and_a_noise_that_is_not_refuted(self, changes):
        search = searched(**changes)
        assert (search.certificate().label is Label.REFUSED) == ("B" not in changes)
        assert search.one_sided() is None

    def test_missing_rollouts_leave_nothing(self):
        search = Search(LINE, **USUAL)
        for query in search.ask():
            search.tell(query, [0.8] * (query.replicates - 1))
        assert search.certificate().label is Label.REFUSED
        assert search.one_sided() is None

    def test_means_that_no_b_explains_leave_nothing(self):
        """The replicates of a test agree, and the test gave something else an hour later."""
        search = Search(LINE, **USUAL)
        for level in (0.8, 3.0):
            search.observe([({"vd": 0.5}, level + 0.04 * np.array([-1, 1, -1, 1]))] * 10)
        assert search.certificate().label is Label.REFUSED
        assert search.certificate().log_e_value < 1
        assert search.one_sided() is None


class TestCheck:
    def test_a_violation_needs_no_b(self, tmp_path):
        result = check(tmp_path, 0.05)
        assert (result.verdict, result.certificate.label) == (Verdict.VIOLATED, Label.ONE_SIDED)
        assert -0.8 < result.upper < 0
        assert result.certificate.rollouts < 30
        assert not any("B =" in text for text in result.assumptions)
        again = recompute(tmp_path / "run").result
        assert (again.verdict, again.upper, again.assumptions) == (
            result.verdict,
            result.upper,
            result.assumptions,
        )

    def test_the_report_names_no_lower_end(self, tmp_path):
        result = check(tmp_path, 0.05)
        report = check_report.report([(result.spec, result)])
        (finding,) = report.findings
        assert report.exit_code == 1
        assert not finding.refused
        facts = dict(finding.facts)
        assert "[" not in finding.headline + facts["worst expected ρ"] + facts["label"]
        assert f"{1e-3:g}" in finding.headline
        assert str(result.certificate.label.value) in facts["label"]

    def test_a_certificate_with_a_fitting_b_is_the_one_of_the_search(self, tmp_path):
        result = check(tmp_path, 3, epsilon=0.4)  # the verdict comes first
        assert (result.verdict, result.certificate.label) == (Verdict.VIOLATED, Label.DECIDED)
        assert result.lower < -0.8 < result.upper
