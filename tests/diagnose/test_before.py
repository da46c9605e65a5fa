"""Before the data: what a plan of runs identifies, by the simulator alone."""

import pytest

from s2r_spec.diagnose import diagnose
from s2r_spec.diagnose.before import Identified, before_data
from s2r_spec.errors import UsageError
from s2r_spec.spec import parse_spec
from tests.diagnose.toy import Toy

SPEC = parse_spec("""
param  v in [0, 1]
signal x {N}
require small: always[0, 0.9 s] (abs(x) <= 2 {N})
certify small: delta = 0.1, epsilon = 0.05, B = 1, R = 0.05, kernel = rbf(0.5), fall = -1
""")


@pytest.fixture(autouse=True)
def library(monkeypatch, cache):
    monkeypatch.setenv("S2R_CACHE", str(cache))


def statuses(**how):
    return {one.axis.effect: one for one in before_data(SPEC, Toy(), **how).effects}


def test_tests_that_show_a_sum_identify_its_parts_only_together_and_one_protocol_would_tell_them_apart():
    found = statuses(protocols=())
    assert [found[name].status for name in "abcd"] == 2 * [Identified.TOGETHER] + 2 * [Identified.UNSEEN]
    assert (found["a"].rivals, found["b"].rivals) == (("b.size",), ("a.size",))
    assert [found[name].run for name in "abcd"] == ["split", "split", "show", "show"]


def test_a_plan_with_the_protocols_identifies_every_effect():
    found = statuses()
    assert {one.status for one in found.values()} == {Identified.ALONE}
    assert [found[name].run for name in "abcd"] == ["split", "split", "show", "show"]
    assert {one.status for one in statuses(open_loop=True).values()} == {Identified.ALONE}


def test_the_expected_interval_is_about_that_of_a_diagnosis():
    found, answer = statuses(), diagnose(SPEC, Toy(), Toy((("c", 2.0),)), budget=20, where=False)
    (own,) = (one for one in answer.which.effects if one.effect == "c")
    width = (own.largest.size_high - own.largest.size_low) / 2.0
    assert 0.6 < width / found["c"].half_width < 1.6
    assert found["c"].interval[0] < 2.0 < found["c"].interval[1]


def test_an_empty_plan_is_refused():
    with pytest.raises(UsageError, match="no protocol of toy"):
        before_data(SPEC, Toy(), protocols=(), open_loop=True)
