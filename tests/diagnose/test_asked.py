"""How large effects are, by what the equations of motion ask for."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from s2r_cart import SPEC, real

import s2r_spec as s2r
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.asked import Asked, Curve, Heard, _straight, asked_columns, pooled
from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.axes import line as line_of
from s2r_spec.diagnose.cache import Cache
from s2r_spec.diagnose.evidence import FORM
from s2r_spec.diagnose.prepare import bench_of
from tests.diagnose.test_equations import Felt

ERROR = 0.03


def line(effect):
    return Line(effect, "size", "", 0.0, (-2.0, 2.0), 1.0, -2.0, 2.0, False, {})


def curve(effect, at, change):
    return Curve(line(effect), np.array(at), np.array(change, dtype=float))


BENT = Asked(
    ("a.size", "b.size"),
    np.zeros(2),
    (
        # What is asked for bends, and b reads some of a.
        curve("a", [-2.0, -1.0, 0.0, 1.0, 2.0], [[-0.8, 0.0], [-0.7, 0.0], [0, 0], [0.9, 0.2], [1.1, 0.4]]),
        curve("b", [-2.0, 0.0, 2.0], [[0.0, -2.0], [0, 0], [0.0, 2.0]]),
        curve("unheard", [-2.0, 0.0, 2.0], np.zeros((3, 2))),
    ),
    np.zeros((0, 2)),
)


def test_a_curve_is_followed_between_its_values_and_no_further():
    bent = BENT.curves[0]
    np.testing.assert_allclose(bent(0.5), [0.45, 0.1])
    np.testing.assert_array_equal(bent(7.0), bent(2.0))
    np.testing.assert_allclose(bent.slope(0.5), [0.9, 0.2])


def test_where_every_rollout_fell_a_curve_goes_on_by_proportion():
    at, change = _straight(
        np.array([-2.0, -1.0, 0.5, 1.0]), np.array([[np.nan], [-0.8], [0.4], [np.nan]], dtype=float)
    )
    np.testing.assert_array_equal(at, [-2.0, -1.0, 0.0, 0.5, 1.0])
    np.testing.assert_allclose(change[:, 0], [-1.6, -0.8, 0.0, 0.4, 0.8])
    # of a side on which nothing stayed up nothing is known
    _, change = _straight(np.array([-1.0, 1.0]), np.array([[np.nan], [0.9]]))
    np.testing.assert_array_equal(change[:, 0], [0.0, 0.0, 0.9])


@pytest.mark.parametrize("true", [(1.6, 0.5), (-1.3, 0.9), (0.3, -0.4)])
def test_sizes_follow_the_equations_through_a_bent_curve_where_nothing_else_is_known(true):
    seen = BENT.curves[0](true[0]) + BENT.curves[1](true[1])
    x, covariance = BENT.fitted(seen, ["a", "b"], 1e-3, np.zeros(2), np.full(2, 1e6))
    np.testing.assert_allclose(x, true, atol=0.02)
    assert (np.abs(x - true) < 2 * np.sqrt(np.diag(covariance))).all()


def test_what_is_known_otherwise_stays_where_the_equations_say_nothing_or_the_same():
    seen = BENT.curves[0](1.0)
    before, variance = np.array([0.95, 0.7]), np.array([1e-6, 0.04])
    x, covariance = BENT.fitted(seen, ["a", "unheard"], ERROR, before, variance)
    np.testing.assert_allclose(
        x, before, atol=1e-2
    )  # a by its own variance, the other for want of a coordinate
    np.testing.assert_allclose(np.diag(covariance), variance, rtol=0.01)


def test_where_a_closed_loop_and_the_equations_have_two_sizes_the_equations_are_believed():
    """A viscous friction of 1.4 of the typical one was 0.3 ± 0.1 of it, for its law was another."""
    seen = BENT.curves[0](1.0)
    x, covariance = BENT.fitted(seen, ["a", "unheard"], ERROR, np.array([0.4, 0.7]), np.array([1e-4, 0.04]))
    assert x[0] == pytest.approx(1.0, abs=0.1)
    assert abs(x[0] - 1.0) < 2.0 * np.sqrt(covariance[0, 0])
    assert x[1] == pytest.approx(0.7)


def test_what_an_effect_should_make_of_the_coordinates_of_others_does_not_size_it():
    curves = (
        Curve(line("a"), np.array([-2.0, 0.0, 2.0]), np.array([[-2.0, -4.0], [0.0, 0.0], [2.0, 4.0]])),
        Curve(line("b"), np.array([-2.0, 0.0, 2.0]), np.array([[0.0, -2.0], [0.0, 0.0], [0.0, 2.0]])),
    )
    both = Asked(("a.size", "b.size"), np.zeros(2), curves, np.zeros((0, 2)))
    x, covariance = both.fitted(np.array([1.0, -0.2]), ["a"], ERROR, np.zeros(1), np.full(1, 9.0))
    assert abs(x[0] - 1.0) < min(0.3, 2.0 * np.sqrt(covariance[0, 0]))


def test_effects_that_leave_more_than_they_should_are_sized_less_surely():
    seen = BENT.curves[0](1.0)
    odd = seen + np.array([0.0, 0.8])  # that no a explains
    known = np.zeros(1), np.full(1, 1.0)
    deviation = [np.sqrt(BENT.fitted(y, ["a"], ERROR, *known)[1][0, 0]) for y in (seen, odd)]
    assert deviation[1] > 1.5 * deviation[0]


def test_how_an_effect_acts_is_what_it_adds_to_the_effect_itself():
    """Of a load at a place, the place's own part: the bank has it with the load at its typical size."""
    size = line("load")
    place = replace(size, parameter="place", base={"size": 1.0})
    both = np.array([[[2.0, 1.0 + 0.5 * x]] for x in (-2.0, 2.0)])  # (values, tests, columns), ρ first
    bank = SimpleNamespace(
        features=SimpleNamespace(names=lambda: [SimpleNamespace(statistic="equation", block="load.size")]),
        nominal=np.zeros((1, 1, 2)),
        lines=(size, place),
        changes=(np.array([[[0.0, -2.0]], [[0.0, 2.0]]]), both),
        variants=np.zeros((0, 1, 2)),
        weights=np.ones((1, 1, 1)),
    )
    asked = Asked.of(bank)
    assert [c.line.name for c in asked.curves] == ["load.size"]
    (turn,) = asked.turns
    np.testing.assert_allclose([turn(x)[0] for x in (-2.0, 0.0, 2.0)], [-1.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def felt(cache):
    bench = bench_of(s2r.parse_spec(SPEC), "tracking", Felt())
    bank = banks.bank(bench, cache=Cache(cache.with_name("quick")))
    return replace(bench, features=bank.features), bank


@pytest.mark.parametrize("effects", [{"viscous": 1.5}, {"coulomb": 0.8, "tilt": -0.7}, {"payload": 0.5}])
def test_a_closed_loop_that_says_too_little_is_put_right_by_the_equations(felt, effects):
    bench, bank = felt
    parameter = {one.effect: one.parameter for one in bank.lines}
    machine = Felt().with_effects({name: {parameter[name]: x} for name, x in effects.items()})
    rollouts = [(bank.tests[k % len(bank.tests)], 100 + k) for k in range(12)]
    rows = np.array([bench.measure(machine.rollout(test, seed), test) for test, seed in rollouts])
    nominal = np.array([bench.measure(Felt().rollout(test, seed), test) for test, seed in rollouts])
    weights = bench.weights([test for test, _ in rollouts])
    heard = Heard.of(bank, rows, nominal, ERROR, weights)
    assert set(effects) <= heard.effects
    lines = heard.asked.lines(list(effects))
    true = np.array([curve.line.coordinate(effects[curve.line.effect]) for curve in lines])

    def simulated(x):
        values = {c.line.effect: {c.line.parameter: c.line.value(v)} for c, v in zip(lines, x, strict=True)}
        added = Felt().with_effects(values)
        return np.array([bench.measure(added.rollout(test, seed), test) for test, seed in rollouts]) - nominal

    x, covariance = heard.sized(list(effects), 0.6 * true, (0.5 * true) ** 2, simulated, weights)
    assert (np.abs(x - true) < 0.5 * np.abs(0.6 * true - true)).all(), (x, true)
    assert (np.abs(x - true) < 3.0 * np.sqrt(np.diag(covariance))).all(), (x, true)


def test_where_the_named_effects_make_every_rollout_fall_the_bank_is_believed():
    heard = Heard(BENT, np.array([1, 2]), BENT.curves[0](1.0), ERROR)
    known = np.full(1, 0.7), np.full(1, 0.5)
    fell, _ = heard.sized(["a"], *known, lambda x: np.full((3, 3), np.nan), np.stack([np.eye(2)] * 3))
    as_the_bank, _ = heard.sized(
        ["a"], *known, lambda x: np.array([[0.0, *BENT.curves[0](float(x[0]))]]), np.eye(2)[None]
    )
    assert fell[0] == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(fell, as_the_bank)


def test_an_effect_of_which_a_coordinate_hardly_moves_is_not_heard():
    heard = Heard(replace(BENT, names=("a.size", "unheard.size")), np.array([1, 2]), np.zeros(2), ERROR)
    assert heard.effects == {"a"}
    assert replace(heard, error=2.0).effects == frozenset()


def test_a_machine_whose_records_lack_what_a_residual_needs_is_not_heard(felt):
    bench, bank = felt
    row = bench.measure(Felt().rollout(bank.tests[0], 0), bank.tests[0])
    mute = row.copy()
    mute[asked_columns(bank)] = np.nan
    weights = bench.weights([bank.tests[0]] * 2)
    assert Heard.of(bank, mute[None], row[None], ERROR, weights[:1]) is None
    # one rollout of two is enough
    heard = Heard.of(bank, np.array([mute, row]), np.array([row, row]), ERROR, weights)
    np.testing.assert_array_equal(heard.seen, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("cost", "strong"), [(1e-3, False), (1e-3, True), (0.3, True)])
def test_whose_names_and_sizes_are_from_the_equations(quick, tmp_path, monkeypatch, cost, strong):
    """Names where instruments are strong or the simulator is dear, sizes where it is dear."""
    dear, told, cache = cost > 0.1, [], quick
    if not strong:
        monkeypatch.setattr(banks, "_instrumented", lambda *_: False)
        cache = tmp_path

    def sized(self, effects, before, variance, simulated, weights):
        told.append((effects, before))
        return np.full(len(before), 0.25), np.diag(np.full(len(before), 0.01**2))

    monkeypatch.setattr(Heard, "sized", sized)
    spoken = []

    def log_evidence(asked, seen, sets):
        # As if the equations all but ruled out what is there.
        spoken.append(len(sets))
        return np.array([-60.0 if "viscous" in members else 0.0 for members in sets])

    rng = np.random.default_rng(12)
    tests = [{"vd": rng.uniform(0.2, 1), "acc": rng.uniform(1, 4)} for _ in range(24)]
    seen = [(test, real(test, 12000 + i, {"viscous": 1.6})) for i, test in enumerate(tests)]
    found = s2r.diagnose(s2r.parse_spec(SPEC), Felt(cost=cost), seen, cache=cache, where=False)
    monkeypatch.setattr(sys.modules["s2r_spec.diagnose.prepare"], "log_evidence", log_evidence)
    without = s2r.diagnose(s2r.parse_spec(SPEC), Felt(cost=cost), seen, cache=cache, where=False)
    assert (without.which.membership["viscous"] < 0.01) is bool(spoken) is (strong or dear)
    assert found.which.answer == ("viscous",)
    (estimate,) = found.which.estimates
    if not dear:
        assert not told
        assert estimate.low < 1.6 < estimate.high
        return
    effects, before = told[0]
    assert effects == ["viscous"]
    viscous = next(e for e in Felt().effects() if e.name == "viscous")
    of = line_of(viscous, viscous.parameters[0])
    assert before[0] == pytest.approx(of.coordinate(1.6), rel=0.3)  # what the closed loop says goes in
    # and what the equations say comes out, with their interval, and that the law is not the machine's
    assert estimate.value == pytest.approx(of.value(0.25))
    assert estimate.high - estimate.low == pytest.approx(2 * 1.645 * np.hypot(0.01, FORM * 0.25) * of.typical)
    assert found.patch["viscous"]["coefficient"] == estimate.value
    # a little of all others is fitted beside what is too small now
    assert found.tuned["viscous"]["coefficient"] == estimate.value
    assert len(found.tuned) > 1


def test_ridge_regressions_of_one_test_each_are_pooled_to_one_of_all():
    """Where the regressors' products are as the weights have them, exactly."""
    rng = np.random.default_rng(3)
    x = rng.normal(size=(5, 3, 40)) * rng.uniform(0.1, 2.0, size=(5, 3, 1))
    true = np.array([1.0, -0.5, 0.2])
    y = np.einsum("p,mpn->mn", true, x) + 0.1 * rng.normal(size=(5, 40))
    weights = x @ x.swapaxes(1, 2) / 40 + 0.1 * np.eye(3)
    each = np.linalg.solve(weights, np.einsum("mpn,mn->mp", x, y)[..., None] / 40)[..., 0]
    together = np.concatenate(list(x), axis=1)
    whole = together @ together.T / 200 + 0.1 * np.eye(3)
    np.testing.assert_allclose(
        pooled(each, weights), np.linalg.solve(whole, together @ y.ravel() / 200), rtol=1e-9
    )
    # a rollout that could not be asked does not count, and of none there is nothing
    some = each.copy()
    some[[1, 3]] = np.nan
    np.testing.assert_allclose(pooled(some, weights), pooled(each[[0, 2, 4]], weights[[0, 2, 4]]))
    assert np.isnan(pooled(np.full((5, 3), np.nan), weights)).all()
    # where all count alike it is their mean
    np.testing.assert_allclose(pooled(each, np.stack([np.eye(3)] * 5)), each.mean(axis=0))
