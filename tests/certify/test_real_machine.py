"""The verdict on the real machine from two searches that have ended."""

from types import SimpleNamespace

import numpy as np
import pytest

from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.real_machine import conclude_certify
from s2r_spec.certify.result.check_result import Verdict
from s2r_spec.certify.search.search import Search
from s2r_spec.space import Space
from tests.certify.rkhs import run

LINE = Space.of({"vd": (0.0, 0.3)}, {"vd": "m/s"})
KERNEL = Kernel("matern52", 0.3)


def searched(worst, budget=3000, B=1.5):
    """Return a search that has ended, of a function of norm |worst| that is largest in the middle of the box."""
    search = Search(LINE, kernel=KERNEL, B=B, R=0.02, delta=0.05, epsilon=0.08, budget=budget)
    run(
        search,
        lambda points: worst * KERNEL.gram(points[None], np.array([[0.15]]))[0],
        0.02,
        np.random.default_rng(0),
    )
    return search


def concluded(first, second):
    gap = SimpleNamespace(certificate=second.certificate(), provenance={"real": {"backend": "robot"}})
    return conclude_certify(first, second, SimpleNamespace(certificate=first.certificate()), gap)


@pytest.mark.parametrize(
    ("simulated", "gap", "verdict"),
    [
        (-0.6, -0.1, Verdict.HOLDS),
        (-0.6, 0.6, Verdict.UNKNOWN),
        (-0.3, 0.6, Verdict.VIOLATED),
        (0.6, 0.0, Verdict.VIOLATED),
    ],
)
def test_the_verdict_is_the_sign_of_the_interval_of_the_sum(simulated, gap, verdict):
    result = concluded(searched(simulated), searched(gap))
    assert (result.verdict, result.real) == (verdict, "robot")
    signs = {Verdict.HOLDS: (True, True), Verdict.UNKNOWN: (False, True), Verdict.VIOLATED: (False, False)}
    assert (result.composition.lower >= 0, result.composition.upper >= 0) == signs[verdict]


@pytest.mark.parametrize(
    ("budget", "label", "remedy"), [(3000, Label.CERTIFIED, "epsilon"), (8, Label.BUDGET, "rollouts")]
)
def test_an_interval_around_0_is_narrowed_by_what_ended_search_2(budget, label, remedy):
    result = concluded(searched(-0.6), searched(0.6, budget))
    assert (result.verdict, result.gap.certificate.label) == (Verdict.UNKNOWN, label)
    assert remedy in result.reason


def test_a_search_that_was_refused_leaves_no_bound_on_the_machine():
    ended, refused = searched(-0.6), searched(-0.6, B=0.3)
    assert refused.certificate().label is Label.REFUSED
    for first, second in ((refused, ended), (ended, refused)):
        result = concluded(first, second)
        assert (result.verdict, result.composition) == (Verdict.UNKNOWN, None)
