"""What could be told apart, and from which size on, before any real test."""

import numpy as np
import pytest

from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.catalogue import Catalogue
from s2r_spec.diagnose.evidence import ALLOWED, FORM, GROUND
from s2r_spec.diagnose.isolability import APART, isolability
from s2r_spec.diagnose.models import Surrogate
from s2r_spec.diagnose.signatures import Curve

PLAIN, ALONG = np.zeros(20), np.eye(20)


def curve(effect, at, change, low=-2.0, parameter="size", nominal=0.0, typical=1.0):
    """Return a line that does ``change`` (20,) per unit of its coordinate, or (values, 20) at its values."""
    at, change = np.array(at), np.array(change, dtype=float)
    line = Line(
        effect,
        parameter,
        "N",
        nominal,
        tuple(nominal + typical * at),
        typical,
        nominal + typical * low,
        nominal + typical * 2,
    )
    seen = change if change.ndim == 2 else np.multiply.outer(at, change)
    return Curve(line, at, seen[:, None, :], np.zeros((len(at), 1)))


def found(*curves, temperature=1.0, noise=1.0):
    bank = Surrogate(Catalogue.of(curves), np.eye(1))
    return isolability(bank, np.eye(1), noise * np.eye(20), np.zeros((0, 1, 20)), temperature)


def strong(*parts):
    return sum(20.0 * part * ALONG[i] for i, part in enumerate(parts))


BOTH, UP, DOWN = [-1.0, -0.5, 0.5, 1.0], [0.5, 1.0], [-1.0, -0.5]


def test_an_effect_that_these_tests_do_not_show_is_confounded_and_not_infinitely_apart():
    none = found(curve("a", BOTH, strong(1.0)), curve("b", BOTH, PLAIN))
    assert np.isfinite(none.sigma).all()
    assert "a" in none.confounded("b")
    assert [(one.below, one.above) for one in none.least][1] == (None, None)


def test_the_distance_is_that_of_the_stated_model():
    a, b = np.random.default_rng(0).normal(size=(2, 20)) * 8
    told = found(curve("a", UP, a), curve("b", UP, b), temperature=4.0)
    v = np.diag(1.0 + GROUND**2 + FORM**2 * a**2) + ALLOWED**2 * np.outer(b, b)
    amounts = np.linspace(0.0, 5.0, 20001)
    left = a - amounts[:, None] * b
    least = np.einsum("ai,ij,aj->a", left, np.linalg.inv(v), left).min()
    assert told.sigma[0, 1] == pytest.approx(np.sqrt(least / 4.0), rel=1e-3)
    assert told.visible[0] == pytest.approx(np.sqrt(a @ np.linalg.inv(v) @ a / 4.0), rel=1e-6)


@pytest.mark.parametrize(
    ("way", "sides", "alike"),
    [(1.0, (UP, UP), True), (-1.0, (UP, UP), False), (-1.0, (UP, DOWN), True), (1.0, (DOWN, UP), False)],
)
def test_effects_of_one_sign_are_alike_only_if_they_push_the_same_way(way, sides, alike):
    push = strong(1.0, 0.5, 0.5)
    low = [0.0 if side is UP else -2.0 for side in sides]
    told = found(curve("a", sides[0], push, low[0]), curve("b", sides[1], way * push, low[1]))
    assert (told.sigma[0, 1] < APART) == alike


def test_an_effect_of_both_signs_is_as_hard_to_tell_as_its_harder_side():
    # Upwards it is itself; downwards it is what b does.
    a = np.array([-strong(0.0, 1.0), -strong(0.0, 0.5), strong(0.5), strong(1.0)])
    told = found(curve("a", BOTH, a), curve("b", UP, -strong(0.0, 1.0), 0.0))
    assert told.sigma[0, 1] < APART
    assert told.least[0].above is not None
    assert told.least[0].below is None


def test_the_least_size_is_where_the_distance_is_three_sigma():
    few = curve("a", BOTH, 4.0 * np.ones(20), nominal=5.0, typical=2.0)
    told = found(few, curve("b", BOTH, strong(1.0)))
    assert told.sigma[0, 1] > APART
    [least, _] = told.least
    assert (least.effect, least.parameter, least.unit, least.nominal) == ("a", "size", "N", 5.0)
    assert least.below == pytest.approx(5.0 - (least.above - 5.0))
    at = (least.above - 5.0) / 2.0
    # A little of it, as of everything, is there in any machine; b leaves 19 of its 20 columns alone.
    alone = APART * np.sqrt((1.0 + GROUND**2) / (16.0 * 19) + ALLOWED**2)
    assert alone < at < 2.0 * alone


def test_a_little_of_an_effect_is_in_any_machine_however_it_bends():
    # At a tenth it does another thing than at its typical size; either way no machine is without a little of it.
    bent = np.array([strong(0.0, 9.0), 2.0 * strong(0.0, 9.0), strong(50.0)])
    told = found(curve("a", [0.05, 0.1, 1.0], bent, 0.0), curve("b", BOTH, strong(0.0, 0.0, 1.0)))
    assert told.least[0].above > APART * ALLOWED


def test_a_limit_that_is_not_reached_before_half_its_range_is_told_from_there_on():
    limit = np.array([PLAIN, strong(1.0, 1.0)])
    told = found(curve("a", UP, limit, 0.0), curve("b", BOTH, strong(0.0, 0.0, 1.0)))
    assert 0.5 < told.least[0].above < 0.8
    assert told.least[0].below is None


def test_the_least_sizes_go_with_the_matrix_into_the_answer():
    told = found(curve("a", UP, strong(1.0), 0.0), curve("b", BOTH, strong(0.0, 1.0))).to_json()
    assert [one["effect"] for one in told["least"]] == ["a", "b"]
    assert set(told["least"][0]) == {"effect", "parameter", "unit", "nominal", "below", "above"}


def turned(by, noise=1.0):
    """Return two effects whose signatures are at this angle."""
    a, b = 300.0 * np.ones(20), 300.0 * np.tile([1.0, -1.0], 10)
    one, other = curve("a", UP, a, 0.0), curve("b", UP, np.cos(by) * a + np.sin(by) * b, 0.0)
    return found(one, other, noise=noise)


def test_effects_of_which_a_law_a_little_off_makes_the_other_are_confounded_however_clear_they_are():
    near, far = turned(0.2), turned(0.8)
    assert near.sigma[0, 1] > APART
    assert near.confounded("a") == ("a", "b")
    assert near.kin.tolist() == [[0.0, 1.0], [1.0, 0.0]]
    assert far.kin[0, 1] == 0.0
    assert far.confounded("a") == ("a",)
    between = [turned(by).kin[0, 1] for by in np.linspace(0.2, 0.8, 61)]
    assert any(0.0 < kin < 1.0 for kin in between)
    assert between == sorted(between, reverse=True)


@pytest.mark.parametrize("noise", [1e-4, 1.0, 100.0])
def test_how_far_effects_are_of_one_kind_does_not_hang_on_what_scatters(noise):
    assert turned(0.2, noise).differs[0, 1] == pytest.approx(turned(0.2).differs[0, 1], rel=0.1)
