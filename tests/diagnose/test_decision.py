"""The rules of the verdict, on records that are made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_spec.diagnose.decision import Evidence, Rule, Verdict
from s2r_spec.diagnose.experiment_design.identifiability import Candidate, Power, Separation
from s2r_spec.diagnose.gap.held_out import compare
from s2r_spec.diagnose.gap.materiality import Failures, Materiality, RolloutsAtTest, materiality
from s2r_spec.diagnose.gap.shares import gap
from s2r_spec.diagnose.inference.estimates import EffectEstimate, ParameterEstimate
from s2r_spec.diagnose.inference.misfit import Misfit
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.residuals.left import Remainder
from s2r_spec.diagnose.simulator.experiments import Experiment

TESTS = [{"v": k / 9} for k in range(9)]


def effect(name, probability, at_end=False):
    size = ParameterEstimate("size", "N", 1.0, 0.8, 1.2, 0.5, 0.4, 0.6, 0.1, at_end)
    return EffectEstimate(name, "actuation", probability, probability, (size,))


def far(tuned, named=None, size=1.0, seen=None):
    """A gap that is the same at nine tests, and what two simulators leave of it."""
    left = [
        np.zeros(9),
        np.full(9, (1 - tuned) * size),
        *([np.full(9, (1 - named) * size)] if named is not None else []),
    ]
    real = np.full(9, size)
    return compare(real, [left[0], *(real - each for each in left[1:])], TESTS, 0.01, 0.1, "m", seen)


EXPLAINED, UNEXPLAINED, SMALL = (Misfit(10, *each) for each in ((0.5, 0.1), (0.5, 0.26), (0.05, 0.9)))
PUSH = Remainder("force", 0, "", "q", 0.1, 0.12, 25.0, "N", "m", 1.4)
CLOCK = Finding("late", "x", "x comes late", "a wrong clock")
SAME = replace(CLOCK, same=True)
SPIKE = Finding("spike", "u", "u is off for a sample")
MATTERS = materiality([RolloutsAtTest({"v": 0.1}, np.array([-1.0, -1.01]), np.linspace(0.99, 1.01, 6))])
NOWHERE = materiality([RolloutsAtTest({"v": 0.1}, np.array([1.0, 1.01]), np.linspace(0.99, 1.01, 6))])
FELL = replace(NOWHERE, failures=Failures(4, 10, 0, 60, 0.001))
ELSEWHERE = gap(np.ones(4), np.arange(4))

SETTLED = Separation("b", ("a", "b"), ("a",), (Power(Candidate(Experiment("chirp"), 1.0), 4.0, True),))
A, MAYBE, AT_END = effect("a", 0.99), effect("b", 0.4), effect("a", 0.99, at_end=True)


def evidence(effects=(A,), **more):
    return Evidence(tuple(effects), **more)


@pytest.mark.parametrize(
    ("found", "rule"),
    [
        (evidence(held_out=far(1.0, 0.95)), Rule.EFFECT),
        (evidence((A, MAYBE), held_out=far(1.0, 0.95)), Rule.EFFECT),
        (evidence((A, MAYBE), separations=(SETTLED,), held_out=far(1.0, 0.95)), Rule.OPEN),
        (evidence(), Rule.EFFECT),
        # A cause that surely leaves most of the gap is not named, nor one that has no more to give.
        (evidence(held_out=far(0.4, 0.3)), Rule.STAYS),
        (evidence(held_out=far(0.7, 0.6)), Rule.EFFECT),
        (evidence((AT_END,), held_out=far(0.7, 0.6)), Rule.END),
        (evidence((AT_END,), held_out=far(1.0, 0.95)), Rule.EFFECT),
        # Without a cause all effects together must close the gap.
        (evidence((MAYBE,), held_out=far(0.9)), Rule.SPREAD),
        (evidence((MAYBE,), held_out=far(0.7)), Rule.STAYS),
        (evidence((MAYBE,), further=("b",), held_out=far(0.9)), Rule.EITHER),
        # Motion that no effect explains counts until named effects close the gap.
        (evidence(held_out=far(1.0, 0.7), left=(PUSH,)), Rule.REMAINDER),
        (evidence((MAYBE,), held_out=far(1.0), left=(PUSH,)), Rule.REMAINDER),
        (evidence(held_out=far(1.0, 0.95), left=(PUSH,)), Rule.EFFECT),
        (evidence(held_out=far(1.0, 0.95, size=0.05), left=(PUSH,)), Rule.EFFECT),
        (evidence(held_out=far(1.0, 0.95), left=(replace(PUSH, surplus=0.9),)), Rule.EFFECT),
        # Mistakes of the recordings.
        (evidence(findings=(CLOCK,)), Rule.MISTAKE),
        (evidence(findings=(SAME,)), Rule.ALIKE),
        (evidence(findings=(SAME, CLOCK)), Rule.MISTAKE),
        (evidence(findings=(SPIKE,)), Rule.EFFECT),
        (evidence((), findings=(CLOCK,)), Rule.NONE),
        # A set that leaves more than a quarter of the misfit is rejected by size, where a misfit shows at all.
        (evidence(held_out=far(1.0, 0.95), misfit=EXPLAINED), Rule.EFFECT),
        (evidence(held_out=far(1.0, 0.95), misfit=UNEXPLAINED), Rule.LEFT),
        (evidence((), materiality=NOWHERE, misfit=UNEXPLAINED), Rule.LEFT),
        (evidence(held_out=far(1.0, 0.95), misfit=SMALL), Rule.EFFECT),
        # A further cause that is needed, and is one of several, is no small matter.
        (evidence(held_out=far(1.0, 0.95), further=("b", "c")), Rule.RIVALS),
        (evidence((), further=("b",)), Rule.EITHER),
        # A named effect that would make a gap where there is none is no name of the cause.
        (evidence((A,), held_out=far(1.0, -39.0, size=0.05)), Rule.EITHER),
        (evidence(()), Rule.NONE),
        # A large effect is there, whether or not this requirement sees it.
        (evidence((MAYBE,), further=("b",), held_out=far(0.9, size=0.05)), Rule.EITHER),
        (evidence((MAYBE,), held_out=far(0.9, size=0.05)), Rule.NONE),
    ],
)
def test_the_first_rule_that_holds_decides(found, rule):
    assert found.rule() is rule
    assert found.answer == (("a",) if rule in (Rule.EFFECT, Rule.OPEN, Rule.RIVALS, Rule.ALIKE) else ())


@pytest.mark.parametrize(
    "shown",
    [
        {"materiality": MATTERS},
        {"materiality": FELL},
        {"held_out": far(1.0)},
        {"held_out": far(0.9, size=0.05, seen=ELSEWHERE)},
        {"held_out": far(0.9, size=0.05), "materiality": MATTERS},
    ],
)
@pytest.mark.parametrize("further", [(), ("b",)])
@pytest.mark.parametrize("left", [None, EXPLAINED, UNEXPLAINED])
def test_no_material_gap_is_never_said_of_a_gap_that_shows(shown, further, left):
    found = evidence((), further=further, misfit=left, **shown)
    assert found.shows
    assert found.rule().verdict is not Verdict.NONE
    assert not evidence((), further=further, misfit=left, materiality=NOWHERE).shows


@pytest.mark.parametrize("share", [-1.0, 0.0, 0.2, 0.4, 0.45])
@pytest.mark.parametrize(
    "more",
    [{}, {"findings": (SAME,)}, {"separations": (SETTLED,)}, {"misfit": EXPLAINED}, {"materiality": NOWHERE}],
)
def test_no_cause_is_named_that_surely_leaves_the_gap(share, more):
    found = evidence((A, MAYBE), held_out=far(share, share), **more)
    assert found.rule().verdict is Verdict.UNKNOWN


def test_words_and_exit_codes():
    assert {each.value: each.exit_code for each in Verdict} == {
        "no material gap": 0,
        "no single cause": 3,
        "named": 0,
        "confounded": 3,
        "none of these": 3,
    }
    assert isinstance(MATTERS, Materiality)
