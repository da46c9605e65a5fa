"""How large the effects of a set are, with a little of everything else beside them."""

from types import SimpleNamespace

import numpy as np
import pytest

from s2r_spec.diagnose import size
from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.catalogue import Catalogue
from s2r_spec.diagnose.estimate import COVER, Sized, fit
from s2r_spec.diagnose.evidence import FORM
from s2r_spec.diagnose.signatures import Curve

AT = np.array([0.8, 0.02, -0.05])
DEVIATION = np.array([0.03, 0.01, 0.04])
TEMPERATURE = 9.0
CATALOGUE = SimpleNamespace(effects=("a", "b", "c"), owner=np.arange(3), based=np.zeros(3, dtype=np.bool_))


def state(rest, usual):
    """Return a dear simulator's, of three effects with a line each, of which the equations say nothing."""
    variance = np.full(rest.shape, 0.01)
    view = SimpleNamespace(
        variance=variance,
        nuisances=np.zeros((0, *rest.shape)),
        surrogate=SimpleNamespace(catalogue=CATALOGUE),
    )
    fit = SimpleNamespace(at=AT, rest=rest)
    return SimpleNamespace(
        wide=None,
        beside=lambda members, near=None: fit,
        data=None,
        temperature=TEMPERATURE,
        simulator=SimpleNamespace(dear=True),
        heard=None,
        view=view,
        usual=usual,
    )


@pytest.fixture
def asked(monkeypatch):
    """Let looks and linear data say what is known here."""
    monkeypatch.setattr(size, "by_linear", lambda *_: Sized(AT, DEVIATION))
    monkeypatch.setattr(size, "_looked", lambda state, effects, best: best)
    return lambda rest, usual: size.sized(state(rest, usual), SimpleNamespace(fits={}), (0,))


@pytest.mark.parametrize("left", [0.0, 0.25, 1.0, 4.0])
def test_a_closed_loop_is_believed_to_a_part_of_itself_by_what_it_leaves(asked, left):
    rest = np.full((2, 5), np.sqrt(left))
    found = asked(rest, np.ones_like(rest))
    doubt = size.FORM * np.sqrt(TEMPERATURE * left) * np.abs(AT)
    np.testing.assert_allclose(found.deviation, np.hypot(DEVIATION, doubt))
    np.testing.assert_array_equal(found.at, AT)


def test_what_it_leaves_is_counted_in_units_of_what_is_usually_believed(asked):
    rest = np.ones((2, 5))
    nearer = asked(rest, np.full_like(rest, 4.0))
    as_fitted = asked(rest, None)  # no other was kept: the variance of the fit itself
    np.testing.assert_allclose(nearer.deviation, np.hypot(DEVIATION, size.FORM * 3.0 * 0.5 * np.abs(AT)))
    np.testing.assert_allclose(as_fitted.deviation, np.hypot(DEVIATION, size.FORM * 3.0 * 10.0 * np.abs(AT)))


def test_a_value_that_fits_exactly_is_still_one_of_our_law():
    line = Line("friction", "force", "N", 0.0, (5.0, 10.0), 10.0, 0.0, 20.0)
    curve = Curve(line, np.array([0.5, 1.0]), np.zeros((2, 1, 3)), np.zeros((2, 1)))
    catalogue = Catalogue.of([curve])
    [exact] = fit(catalogue, (0,), Sized(np.array([0.6]), np.zeros(1))).estimates
    assert exact.value == pytest.approx(6.0)
    assert (exact.low, exact.high) == pytest.approx((6.0 * (1 - COVER * FORM), 6.0 * (1 + COVER * FORM)))
    [known] = fit(catalogue, (0,), Sized(np.array([0.6]), np.array([0.2]))).estimates
    assert known.low < 6.0 - COVER * 2.0 < exact.low
    [past] = fit(catalogue, (0,), Sized(np.array([1.3]), np.zeros(1))).estimates
    [nominal] = fit(catalogue, (0,), Sized(np.array([-0.2]), np.zeros(1))).estimates  # of one side only
    assert (past.value, nominal.value) == (10.0, 0.0)
    assert [e.at_end for e in (exact, past, nominal)] == [False, True, False]


class Ridge:
    """A state of linear data whose fit is in closed form: three effects, and a direction that none of them has."""

    jacobian = np.array([[3.0, 0.0, 0.0, 0.5], [2.0, 2.0, 0.0, 0.0], [2.0, 0.0, 2.0, 0.0]])

    def __init__(self, data, times=1.0):
        self.data, self.times, self.temperature = data, times, TEMPERATURE
        self.wide = self.usual = self.heard = None
        self.simulator = SimpleNamespace(dear=False)
        self.view = SimpleNamespace(variance=times, surrogate=SimpleNamespace(catalogue=CATALOGUE))

    def believed_less(self, times):
        return Ridge(self.data, self.times * times)

    def beside(self, members, near=None):
        spread = np.where(np.isin(CATALOGUE.owner, members), 0.7, size.ALLOWED)
        weight = 400.0 / self.times
        inner = weight * self.jacobian @ self.jacobian.T + np.diag(spread**-2.0)
        return SimpleNamespace(at=np.linalg.solve(inner, weight * self.jacobian @ self.data))


def test_what_no_effect_explains_takes_nothing_from_the_named_one():
    # A law that is not ours: by the others its largest part is imitated.
    machine = Ridge(np.array([1.8, 0.6, 0.6, -0.2]))
    alone = machine.jacobian[0] @ machine.data / (machine.jacobian[0] @ machine.jacobian[0])
    before = machine.beside((0,))
    assert before.at[0] < 0.5 * alone
    believed, found = size._with_a_little(machine, (0,), before)
    assert size.pulled(CATALOGUE, (0,), found.at) <= size.PULLED
    assert abs(found.at[0] - alone) < 0.25 * alone
    assert believed.times > 1.0


def test_a_machine_with_a_little_of_everything_is_believed_as_before():
    truth = np.array([0.8, 0.06, -0.1])
    machine = Ridge(truth @ Ridge.jacobian)
    before = machine.beside((0,))
    believed, found = size._with_a_little(machine, (0,), before)
    assert believed is machine
    assert found is before


def test_data_of_which_nothing_is_believed_are_not_believed_less_for_ever():
    machine = Ridge(np.array([1e6, -1e6, 1e6, 1e6]))
    believed, _ = size._with_a_little(machine, (0,), machine.beside((0,)))
    assert believed.times == size.AT_MOST


def test_what_takes_the_part_of_what_is_lacking_stays_in_the_tuned_simulator(monkeypatch):
    monkeypatch.setattr(size, "by_linear", lambda *_: Sized(AT, DEVIATION))
    monkeypatch.setattr(size, "_looked", lambda state, effects, best: best)
    for data, lacking in ((np.array([1.8, 0.6, 0.6, -0.2]), True), (np.array([2.4, 0.1, 0.1, 0.4]), False)):
        machine = Ridge(data)
        first = machine.beside((0,))
        found = size.sized(machine, SimpleNamespace(fits={(0,): first}), (0,))
        assert bool(found.at[0] > first.at[0]) is lacking
        np.testing.assert_array_equal(found.tuned, first.at)
