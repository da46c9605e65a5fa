"""Which effects the equations of motion speak for, by the Gaussian model that the module states."""

from itertools import chain, combinations, product

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from s2r_spec.diagnose.asked import Asked, Curve
from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.evidence import ALLOWED, FORM, LARGE, Evidence
from s2r_spec.diagnose.judge import WEIGHTS, Judge
from s2r_spec.diagnose.told import ACROSS, ANYWHERE, ASTRAY, ERRORS, log_evidence

NAMES = ("a.size", "b.size", "c.x", "c.y", "push.size")
ONE = np.eye(len(NAMES))


def curve(effect, parameter, ends, change, base=None):
    """A straight line that changes the coordinates by ``change`` per unit."""
    line = Line(effect, parameter, "", 0.0, tuple(ends), 1.0, *ends, False, base or {})
    at = np.array(sorted({*ends, 0.0}))
    return Curve(line, at, at[:, None] * np.asarray(change, dtype=float))


ASKED = Asked(
    NAMES,
    np.zeros(len(NAMES)),
    (
        curve("a", "size", (-2.0, 2.0), 0.9 * ONE[0] + 0.3 * ONE[1]),
        curve("b", "size", (-2.0, 2.0), ONE[1]),
        curve("c", "x", (-2.0, 2.0), ONE[2]),
        curve("c", "y", (-2.0, 2.0), ONE[3]),
        curve("push", "size", (0.0, 2.0), ONE[4]),  # only forwards
        curve("hidden", "size", (-2.0, 2.0), -0.5 * ONE[1] + 0.4 * ONE[4]),  # no coordinate is its own
    ),
    0.02 * ONE[:1],
    (curve("push", "place", (-1.0, 1.0), 0.5 * ONE[0], base={"size": 1.0}),),
)
EFFECTS = ("a", "b", "c", "push", "hidden")
SETS = [(), *((name,) for name in EFFECTS), *combinations(EFFECTS, 2)]
TWO_SIDED = [s for s in SETS if "push" not in s]


def first(seen):
    logs = log_evidence(ASKED, np.asarray(seen, dtype=float), SETS)
    return SETS[int(np.argmax(logs))], logs


def test_it_is_the_evidence_of_the_stated_model():
    seen = np.array([0.5, 0.2, -0.1, 0.4, 0.05])
    rows = np.array([c(1.0) for c in (*ASKED.curves, *ASKED.turns)])
    owner = np.array(["a", "b", "c", "c", "push", "hidden", "push"])
    ways = {"a": [[0]], "b": [[1]], "c": [[2, 3], [2], [3]], "hidden": [[5]]}
    across = (ACROSS * rows[0] * seen[0]) ** 2 * (1 - ONE[0])

    def density(large, error, stray):
        little = np.where(np.arange(len(owner)) == 6, ALLOWED**2, ALLOWED)  # where a little of a push acts
        prior = np.where(np.isin(np.arange(len(owner)), large), LARGE, little)
        rest = np.diag(error**2 + (FORM * seen) ** 2 + across) + ASKED.numerics.T @ ASKED.numerics
        rest += ANYWHERE**2 * np.diag(np.arange(len(NAMES)) == stray)
        part = 1.0 - ASTRAY if stray is None else ASTRAY / len(NAMES)
        return np.log(part) + multivariate_normal(cov=rest + (rows.T * prior**2) @ rows).logpdf(seen)

    exact = []
    for members in TWO_SIDED:
        of = [[*chain(*each)] for each in product(*(ways[name] for name in members))]
        each = [density(large, e, k) for large in of for e in ERRORS for k in (None, *range(len(NAMES)))]
        exact.append(logsumexp(each) - np.log(len(of)))
    found = log_evidence(ASKED, seen, TWO_SIDED)
    np.testing.assert_allclose(found - found[0], np.array(exact) - exact[0], atol=1e-8)


def test_one_coordinate_that_is_astray_does_not_silence_all_others():
    alone, both = (
        [0.6, 0.2, 0.0, 0.0, 0.0],
        [0.6, 0.2, 4.0, 0.0, 0.0],
    )  # only an unknown cause makes so much of c
    a, none = SETS.index(("a",)), SETS.index(())
    (_, logs), (_, astray) = first(alone), first(both)
    assert astray[a] - astray[none] > 0.7 * (logs[a] - logs[none])


def test_a_machine_whose_every_coordinate_is_off_speaks_for_no_set():
    within, beyond = ([0.5, -0.5, 0.6, 0.4, -0.7], [2.0, -2.0, 2.5, -1.5, -2.0])
    spreads = [
        np.ptp([logs[SETS.index((name,))] for name in EFFECTS]) for _, logs in map(first, (within, beyond))
    ]
    assert max(spreads) < 3.0


@pytest.mark.parametrize(
    ("seen", "members"),
    [
        ([0.02, -0.03, 0.04, 0.0, 0.01], ()),
        ([0.54, 0.18, 0.0, 0.02, 0.0], ("a",)),
        ([0.54, -0.42, 0.02, 0.0, 0.0], ("a", "b")),
        ([0.0, 0.0, 0.0, 0.6, 0.0], ("c",)),  # one of its parameters, the other is not off
        ([0.0, -0.6, 0.0, 0.02, 0.48], ("hidden",)),
        ([0.5, 0.0, 0.0, 0.0, 1.0], ("push",)),  # at another place
    ],
)
def test_what_makes_the_coordinates_is_the_likeliest(seen, members):
    assert first(seen)[0] == members


def test_what_cannot_be_is_not_spoken_for():
    """A push backwards is not in the catalogue."""
    back = first([0.0, 0.0, 0.0, 0.0, -0.5])[1]
    ahead = first([0.0, 0.0, 0.0, 0.0, 0.5])[1]
    none, push = SETS.index(()), SETS.index(("push",))
    assert ahead[push] - ahead[none] > 5.0
    assert back[push] < back[none]
    logs = log_evidence(ASKED, np.zeros(len(NAMES)), [(), ("stranger",), ("a", "stranger")])
    assert logs[1:].tolist() == [-np.inf, -np.inf]


@pytest.mark.parametrize("unknown", [0.0, 0.6])
def test_where_the_equations_speak_or_the_traces_are_strange_the_networks_are_trusted_less(unknown):
    members = ((), (0,), (1,), (0, 1))
    logs, p, told = np.array([-9.0, -3.0, 0.0, -1.0]), np.array([0.9, 0.2]), np.array([-5.0, 0.0, -4.0, -1.0])
    evidence = Evidence(members, logs, np.zeros(4), np.zeros(4), 1.0)
    judge = Judge(("a", "b"), (), WEIGHTS, None, 0.5, {})
    odds = np.log(p / (1.0 - p))
    vote = np.array([0.0, odds[0], odds[1], odds.sum()])
    size = np.array([0, 1, 1, 2])
    for heard, said, trust in (
        (None, p, WEIGHTS.trust * (1.0 - unknown)),
        (told, p, WEIGHTS.beside * (1.0 - unknown)),
        (None, None, None),
        (told, None, None),
    ):
        score = WEIGHTS.evidence * logs / 2.0 - WEIGHTS.penalties(size, 2, trust) + (trust or 0.0) * vote
        score = score + (WEIGHTS.told * told if heard is not None else 0.0)
        found = judge.sets(evidence, said, 2.0, unknown, heard)
        np.testing.assert_allclose(found.probability, np.exp(score - logsumexp(score)))
    assert WEIGHTS.beside < WEIGHTS.trust
