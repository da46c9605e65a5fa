"""A refused certificate names the B or R that would have passed, with the interval and its verdict."""

import re

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.base.verdict import Verdict
from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.bound.rounding import interval_text
from s2r_spec.certify.result.refusals import with_remedy
from s2r_spec.certify.search.search import Search
from s2r_spec.errors import UsageError
from s2r_spec.space import Space
from s2r_spec.workers.pools import in_this_process
from tests.errors import states

LINE = Space.of({"vd": (0.0, 1.0)})
USUAL = {"kernel": Kernel("matern52", 0.3), "B": 1.5, "R": 0.05, "delta": 0.01, "epsilon": 0.15}
SPEC = """\
signal vx {m/s}
param  vd {m/s} in [-0.2, 0.3]
require walking: always[0.5 s, 1.5 s] (abs(vx - vd) <= LIMIT {m/s})
certify walking: delta = 1e-3, epsilon = 0.05, SETTINGS, kernel = rbf(0.2 {m/s}), fall = -0.5
"""


def refused(level, noise, **changes):
    """Return a refused search and its outcomes, for J near ``level`` everywhere."""
    search, tests, rng = Search(LINE, **(USUAL | changes)), [], np.random.default_rng(0)
    while not search.done:
        for query in search.ask():
            outcomes = level + noise * rng.normal(size=query.replicates)
            tests.append((query.point, outcomes))
            search.tell(query, outcomes)
    assert search.certificate().label is Label.REFUSED
    return search, tests


@pytest.mark.parametrize(("level", "verdict"), [(0.9, "violated"), (-0.9, "holds")])
def test_the_first_norm_that_passes_is_named_with_its_interval(level, verdict):
    search, tests = refused(level, 0.05, B=1.6, epsilon=0.3)
    certificate = search.certificate()
    found = with_remedy(certificate, search, tests)
    rung = next(one for one in certificate.ladder if 2 * certificate.B_low <= one.B)
    assert rung.B > search.B
    assert states(found.reason, f"B = {rung.B:g}", interval_text(-rung.upper, -rung.lower), verdict)
    assert found.label is Label.REFUSED
    assert (found.lower, found.upper) == (certificate.lower, certificate.upper)


def test_a_norm_beyond_the_ladder_is_named_without_an_interval():
    search, tests = refused(0.9, 0.01, B=0.16, R=0.01, epsilon=0.1)
    found = with_remedy(search.certificate(), search, tests)
    least = float(re.search(r"B must be at least (\S+)", found.reason)[1])
    assert least == pytest.approx(2 * search.certificate().B_low, rel=0.02)


@pytest.mark.parametrize("seed", range(3))
def test_the_smallest_r_that_is_not_refuted_passes_and_a_smaller_one_does_not(seed):
    search, tests = refused(0.9, 0.25, B=4.0, seed=seed)
    R = search.least_proxy
    assert 0.05 < R < 0.25

    def again(value):
        other = Search(LINE, **(USUAL | {"B": 4.0, "R": value}))
        other.observe(tests, final=True)
        return other.certificate()

    assert again(1.01 * R).label is not Label.REFUSED
    assert states(again(0.97 * R).reason, "R")
    assert again(0.97 * R).label is Label.REFUSED
    reason = with_remedy(search.certificate(), search, tests).reason
    assert float(re.search(r"R = (\S+) is the smallest", reason)[1]) == pytest.approx(R, rel=0.01)


def test_a_declaration_that_rests_on_the_kernel_alone_names_the_lengthscale_that_would_do():
    settings = USUAL | {"B": 0.5, "epsilon": 0.4}
    with pytest.raises(UsageError) as refusal:
        Search(LINE, **settings | {"kernel": Kernel("rbf", 2.0)}).refuse_hopeless()
    below = float(re.search(r"lengthscale below (\S+)", str(refusal.value))[1])
    Search(LINE, **settings | {"kernel": Kernel("rbf", 0.99 * below)}).refuse_hopeless()
    Search(LINE, **settings | {"kernel": Kernel("rbf", 2.0), "epsilon": 0.2}).refuse_hopeless()


@pytest.mark.usefixtures("toy")
class TestCheck:
    def check(self, tmp_path, limit, settings, **keywords):
        text = SPEC.replace("LIMIT", str(limit)).replace("SETTINGS", settings)
        spec = s2r.parse_spec(text, "spec.stl")
        return s2r.check(spec, "toy", tmp_path / "run", executor=in_this_process, **keywords)

    def test_a_refused_check_stays_unknown_and_says_what_would_have_passed(self, tmp_path):
        result = self.check(tmp_path, 0.3, "B = 0.6, R = 0.02")
        assert result.certificate.label is Label.REFUSED
        assert result.verdict is Verdict.UNKNOWN
        assert states(result.reason, "B = 1.2", "holds")

    def test_a_refuted_r_is_named_with_the_interval_that_it_would_have_given(self, tmp_path):
        result = self.check(tmp_path, 0.3, "B = 2, R = 0.003", stop="budget", budget=200)
        assert result.certificate.label is Label.REFUSED
        (R,) = re.findall(r"R = (\S+) is the smallest", result.reason)
        assert 0.003 < float(R) < 0.012
        assert "holds" in result.reason

    def test_a_certificate_that_is_not_refused_says_nothing_of_it(self, tmp_path):
        result = self.check(tmp_path, 0.1, "B = 1, R = 0.02")
        assert result.certificate.label.bounds
        assert not result.certificate.reason
