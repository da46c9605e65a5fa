"""What is said of a set of probabilities: what is named, what cannot be told from it, what may not be there."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from s2r_spec.diagnose.catalogue import Catalogue
from s2r_spec.diagnose.diagnosis import Verdict, Which
from s2r_spec.diagnose.estimate import Estimate
from s2r_spec.diagnose.how_far import gap, how_far
from s2r_spec.diagnose.judge import Sets
from s2r_spec.diagnose.remainder import Remainder
from s2r_spec.diagnose.verdict import (
    CLEAR,
    IMITATED,
    RIVAL,
    SURE,
    certain,
    clear,
    confounded,
    decided,
    large,
    likeliest,
    reason,
    spare,
)

A, B, C = ("a",), ("b",), ("c",)


@dataclass(frozen=True)
class Alike:
    """An isolability matrix in which these two cannot be told apart."""

    names: frozenset = field(default_factory=frozenset)

    def confounded(self, name):
        return tuple(self.names) if name in self.names else (name,)


def by_size(**sets):
    """``ab=0.4``: the probability of a and b."""
    found = {0: {(): 0.0}, 1: dict.fromkeys([A, B, C], 0.0), 2: {}, 3: {}}
    for names, probability in sets.items():
        members = () if names == "none" else tuple(names)
        found[len(members)][members] = probability
    return found


def test_of_two_effects_of_a_kind_the_likelier_is_named_if_it_is_likelier_than_both():
    """A robot's own twin was said to have both of two that look alike, each alone being the likelier answer."""
    seen = [((0, 1), 0.75), ((0,), 0.15), ((2,), 0.1)]
    assert likeliest(seen, [((0,), 0.36), ((1,), 0.3), ((0, 1), 0.26), ((2,), 0.08)]) == (0,)
    assert likeliest(seen, [((0, 1), 0.7), ((0,), 0.2), ((2,), 0.1)]) == (0, 1)
    # what the evidence does not see is not named for its kin's sake, and the empty set is no cause
    assert likeliest(seen, [((), 0.4), ((2,), 0.3), ((0, 1), 0.2), ((0,), 0.1)]) == (0, 1)


def test_a_set_nearly_as_likely_is_answered_with_the_first():
    assert confounded(Alike(), A, by_size(a=0.5, b=0.5 * RIVAL)) == ("a", "b")
    assert confounded(Alike(), A, by_size(a=0.5, b=0.4 * RIVAL)) == ("a",)
    assert confounded(Alike(), A, by_size(a=0.5, ab=0.5 * RIVAL)) == ("a", "b")  # beside it
    assert confounded(Alike(), ("a", "b"), by_size(ab=0.5, ac=0.2)) == ("a", "b", "c")


def test_what_no_test_tells_apart_is_answered_with_it_unless_the_data_rule_it_out():
    alike = Alike(frozenset("ab"))
    assert confounded(alike, A, by_size(a=0.9, b=0.05)) == ("a", "b")
    assert confounded(alike, A, by_size(a=0.9, b=0.01)) == ("a",)


WHICH = Which(0.1, 0.7, {"a": 0.2}, {}, (), (), (), "friction", None, None)


def test_what_is_left_of_the_motion_says_why_none_of_these():
    left = Remainder("force", 0, "", "q", 0.1, 0.12, 25.0, "N", "m", 1.4)
    words = reason(Verdict.UNKNOWN, WHICH, None, A, (left,))
    assert "+25 N of force where q is between 0.1 and 0.12 m" in words
    assert "a (friction)" in words
    assert "force" not in reason(Verdict.UNKNOWN, WHICH, None, A, (replace(left, surplus=0.9),))


def test_what_is_not_ruled_out_is_beside_what_is_named_or_in_its_place_as_the_sets_say():
    both = replace(
        WHICH,
        singles={"a": 0.6, "b": 0.0, "c": 0.1},
        several={("a", "b"): 0.2},
        answer=A,
        confounded=("a", "b", "c"),
    )
    assert both.instead == C
    assert "c instead of it or beside it, nor b beside it" in reason(Verdict.CONFOUNDED, both, None, A)
    beside = replace(both, confounded=("a", "b"))
    assert "instead" not in reason(Verdict.CONFOUNDED, beside, None, A)
    assert "b beside it" in reason(Verdict.CONFOUNDED, beside, None, A)
    two = replace(
        both, several={("a", "b"): 0.5, ("b", "c"): 0.2}, answer=("a", "b"), confounded=("a", "b", "c")
    )
    assert "c instead of one of them or beside them" in reason(Verdict.CONFOUNDED, two, None, ("a", "b"))


def test_where_no_cause_is_named_those_nearly_as_likely_and_what_is_left_are_told():
    which = replace(WHICH, none=0.1, unknown=0.0, singles={"a": 0.46, "b": 0.42, "c": 0.02})
    left = Remainder("x", 0, "", "", 0.5, 0.6, 0.1, "m", "s", 1.4, recorded=True)
    words = reason(Verdict.NONE, which, None, A, (left,))
    assert "a or b" in words
    assert "a difference of +0.1 m in x from 0.5 to 0.6 s" in words
    assert "0.1 m" not in reason(Verdict.NONE, which, None, A, (replace(left, surplus=0.9),))


def test_a_value_at_the_end_of_its_range_and_what_a_little_of_everything_would_not_leave_are_said():
    tests = [{"v": k / 9} for k in range(9)]
    far = how_far(np.ones(9), np.zeros(9), np.full(9, 0.5), np.ones(9), tests, 0.01, 0.1, 3, "m")
    at_end = replace(WHICH, estimates=(Estimate("a", "mass", 500.0, 300.0, 500.0, "kg", at_end=True),))
    words = reason(Verdict.NAMED, at_end, far, A)
    assert words.startswith("The gap is material. a explains")
    assert "closes 50 % of the held-out gap" in words
    assert "more than a few percent of every effect" in words
    for verdict in (Verdict.NAMED, Verdict.UNKNOWN):
        assert "a.mass is at the end of its range" in reason(verdict, at_end, far, A)
    assert "more than" not in reason(Verdict.NAMED, WHICH, replace(far, after=far.tuned), A)


def test_a_gap_that_the_held_out_tests_do_not_show_is_not_said_to_be_none():
    tests, quiet = [{"v": k / 9} for k in range(9)], np.full(9, 1e-4)
    seen = gap(np.array([1e-4] * 20 + [0.5]), np.arange(21))
    far = how_far(quiet, np.zeros(9), None, quiet, tests, 1e-3, 0.0, 3, "m", seen=seen)
    words = reason(Verdict.SPREAD, WHICH, far, A)
    assert words.startswith("The gap is material, but at no held-out test.")
    assert "not measured" in reason(Verdict.NAMED, WHICH, far, A)
    small = how_far(50 * quiet, np.zeros(9), 25 * quiet, quiet, tests, 1e-3, 0.01, 3, "m", seen=seen)
    words = reason(Verdict.NAMED, WHICH, small, A)
    assert f"closes {100 * small.share[0]:.0f} %" in words
    assert "not measured" not in words


def test_no_material_gap_is_not_answered_where_the_gap_matters_at_a_test():
    none = np.full(9, 1e-4)
    far = how_far(none, np.zeros(9), None, none, [{"v": k / 9} for k in range(9)], 1e-3, 0.0, 3, "m")
    rest = {"nothing": True, "plain": False, "at_end": False, "strange": False}
    for own in (None, far):
        assert decided(own, 0.1, 0.9, 0.8, **rest)[0] is Verdict.NONE
        there = own and replace(own, matters=True)
        assert decided(there, 0.1, 0.9, 0.8, **rest, matters=True)[0] is Verdict.SPREAD
        assert decided(there, 0.1, 0.9, 0.8, **(rest | {"nothing": False}), matters=True)[0] is Verdict.NAMED
        assert reason(Verdict.SPREAD, WHICH, there, A).startswith("The gap is material")


def test_an_effect_without_which_the_others_are_nearly_as_likely_may_not_be_there():
    assert spare(("a", "b"), by_size(ab=0.5, a=0.3)) == ("b",)
    assert spare(("a", "b"), by_size(ab=0.5, a=0.3, b=0.2)) == ("a", "b")
    assert spare(("a", "b"), by_size(ab=0.5, a=0.05)) == ()
    assert spare(("a", "b", "c"), by_size(abc=0.4, ab=0.3)) == ("c",)
    # of what is left of a set, as likely as that
    assert spare(("a", "b"), by_size(abc=0.6, ab=0.05, a=0.05)) == ()
    assert spare(A, by_size(a=0.5, none=0.4)) == ()  # whether there is a gap at all is asked elsewhere


@pytest.mark.parametrize(
    ("sets", "yes"),
    [
        ({(0,): CLEAR, (): 1 - CLEAR}, True),
        ({(0,): 0.5, (0, 1): 0.25, (0, 2): SURE - 0.75, (): 1 - SURE}, True),  # whatever is beside it
        ({(0,): 0.5, (1,): 0.5}, False),
    ],
)
def test_traces_are_clear_where_a_set_is_likely_or_each_of_its_effects_all_but_sure(sets, yes):
    assert clear(Sets(tuple(sets), np.array([*sets.values()])), (0,), sets[(0,)]) is yes


def test_of_a_pair_the_traces_may_be_sure_of_one():
    """With another beside it a friction in every likely set was named no more than no friction at all."""
    sets = Sets(((0, 1), (0, 2), (0,), (2,)), np.array([0.45, 0.3, 0.19, 0.06]))
    assert certain(sets, (0, 1)) == (0,)
    assert not clear(sets, (0, 1), 0.45)
    assert certain(sets, (2,)) == ()


@pytest.mark.parametrize(
    ("at", "left"),
    [([0.8, 0.01, 0.3], (0, 1)), ([0.8, 0.3, 0.01], (0, 1)), ([0.8, 0.01, -0.02], (0,)), ([0.01, 0.0, 0.02], (0, 1))],
)  # fmt: skip
def test_what_turns_out_next_to_nothing_is_no_cause_beside_others(at, left):
    # The second effect has two parameters; of either one is enough. If none is there, none is taken out.
    none, owner = np.zeros(3), np.array([0, 1, 1])
    lines = Catalogue((), ("a", "b"), owner, owner, none.astype(bool), none - 1, none + 1, none)
    assert large(lines, (0, 1), np.array(at)) == left


def test_what_was_left_out_is_not_ruled_out_and_what_is_unlikely_is():
    apart = Alike()
    sets = {
        0: {(): 0.02},
        1: {("a",): 0.05},
        2: {("a", "b"): 0.01, ("a", "d"): 0.03, ("b", "d"): 0.005},
        3: {("a", "b", "c"): 0.8, ("a", "b", "d"): 0.02},
    }
    assert confounded(apart, ("a", "b"), sets) == ("a", "b", "c")
    sets[2]["a", "b"] = 0.6
    sets[2]["a", "d"] = 0.2
    sets[3]["a", "b", "c"] = 0.1
    assert confounded(apart, ("a", "b"), sets) == ("a", "b", "d")


def after(share, gap_size=1.0):
    """The held-out gap, evenly over nine tests, and a patch that closes this part of it."""
    tests = [{"v": k / 9} for k in range(9)]
    real, nominal, patched = np.full(9, gap_size), np.zeros(9), np.full(9, share * gap_size)
    return how_far(real, nominal, patched, None, tests, 0.01, 0.1, 3, "m")


def answered(far, unknown=0.3, **other):
    usual = {"nothing": False, "plain": False, "at_end": False, "strange": False}
    return decided(far, unknown, 0.5, 0.6, **(usual | other))


def test_what_closes_the_gap_is_named_however_odd_the_traces_are():
    assert answered(after(0.95), unknown=0.9) == (Verdict.NAMED, pytest.approx(0.9 * IMITATED))
    assert answered(after(0.95), at_end=True)[0] is Verdict.NAMED


def test_odd_traces_are_an_unknown_cause_where_the_gap_stays_open_or_was_not_measured():
    assert answered(None, unknown=0.9) == (Verdict.UNKNOWN, 0.9)
    assert answered(after(0.7), unknown=0.9) == (Verdict.UNKNOWN, 0.9)
    assert answered(after(0.7), unknown=0.3) == (Verdict.NAMED, 0.3)
    assert answered(None, unknown=0.9, nothing=True)[0] is Verdict.NONE


@pytest.mark.parametrize("why", [{"at_end": True}, {"strange": True}])
def test_as_much_as_there_is_of_a_cause_and_what_is_left_of_the_motion_speak_against_it(why):
    assert answered(after(0.7), **why) == (Verdict.UNKNOWN, pytest.approx(0.65))


def test_a_gap_that_a_little_of_everything_makes_has_no_cause_unless_the_traces_are_plain():
    small = after(0.95, gap_size=0.05)
    assert answered(small)[0] is Verdict.NONE
    assert answered(small, plain=True)[0] is Verdict.NAMED
    assert answered(small, unknown=0.9)[0] is Verdict.NONE
    assert answered(small, plain=True, strange=True)[0] is Verdict.NAMED


def test_a_gap_without_a_cause_is_no_single_one_and_a_patch_that_makes_a_gap_names_none():
    assert answered(after(0.7), nothing=True)[0] is Verdict.SPREAD
    assert answered(after(40.0, gap_size=0.05), plain=True)[0] is Verdict.NONE
