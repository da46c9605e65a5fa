"""What looks like one effect of a kind may be the other."""

import numpy as np
import pytest

from s2r_spec.diagnose.judge import Sets
from s2r_spec.diagnose.kin import OTHER, shared

SETS = ((), (0,), (1,), (2,), (0, 1), (0, 2), (1, 2))


def told(kin, **probability):
    matrix = np.zeros((3, 3))
    for a, b, alike in kin:
        matrix[a, b] = matrix[b, a] = alike
    seen = [probability.get("n" + "".join(map(str, s)), 0.0) for s in SETS]
    out = shared(Sets(SETS, np.array(seen)), matrix)
    assert out.members == SETS
    assert out.probability.sum() == pytest.approx(1.0)
    return {s: p for s, p in zip(out.members, out.probability.tolist(), strict=True) if p}


def test_where_no_two_effects_are_of_a_kind_nothing_changes():
    assert told([], n0=0.7, n12=0.2, n=0.1) == {(0,): 0.7, (1, 2): 0.2, (): 0.1}


def test_what_looks_like_one_of_a_kind_may_be_the_other_however_sure_the_evidence_is():
    out = told([(0, 1, 1.0)], n0=1.0)
    assert out == pytest.approx({(0,): 1.0 - OTHER, (1,): OTHER})
    assert out[(0,)] > out[(1,)]


def test_beside_another_effect_as_well():
    assert told([(0, 1, 1.0)], n02=1.0) == pytest.approx({(0, 2): 1.0 - OTHER, (1, 2): OTHER})


def test_two_of_a_kind_may_be_one_of_them_whose_law_lies_between():
    out = told([(0, 1, 1.0)], n01=1.0)
    assert set(out) == {(0, 1), (0,), (1,)}
    assert out[(0,)] == pytest.approx(out[(1,)])


def test_the_less_they_are_of_a_kind_the_less_is_shared():
    parts = [told([(0, 1, alike)], n0=1.0).get((1,), 0.0) for alike in (0.0, 0.3, 1.0)]
    assert parts[0] == 0.0 < parts[1] < parts[2]


def test_of_three_of_a_kind_the_one_that_is_seen_stays_the_likeliest():
    out = told([(0, 1, 1.0), (0, 2, 1.0), (1, 2, 1.0)], n0=1.0)
    assert out[(0,)] > out[(1,)] == pytest.approx(out[(2,)])


def test_a_set_that_was_not_weighed_gets_its_part_as_well():
    few = shared(Sets(((), (0,)), np.array([0.1, 0.9])), np.ones((2, 2)) - np.eye(2))
    assert few.members == ((), (0,), (1,))
    assert few.probability.tolist() == pytest.approx([0.1, 0.9 * (1.0 - OTHER), 0.9 * OTHER])
