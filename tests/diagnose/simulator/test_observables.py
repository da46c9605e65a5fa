"""Observables of traces that are written down here."""

import numpy as np
import pytest

from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.observables import Observables
from s2r_spec.errors import UsageError
from s2r_spec.trace import Trace

TIMES = np.linspace(0.0, 4.0, 801)


def trace(late=0.0, end=TIMES.size, **more):
    """Return a command, a stance flag, and the force residual of a machine that is late by this [s]."""
    command = np.sin(2.0 * TIMES) + 0.3 * np.sin(9.0 * TIMES)
    lacking = np.sin(2.0 * (TIMES - late)) + 0.3 * np.sin(9.0 * (TIMES - late)) - command
    channels = {
        "u": command,
        "residual.force": lacking + 1e-3 * np.cos(40.0 * TIMES),
        "stance": (np.sin(5.0 * TIMES) > 0).astype(float),
        **more,
    }
    units = {"u": "N", "residual.force": "N"}
    return Trace(TIMES[:end], {name: x[:end] for name, x in channels.items()}, units)


@pytest.fixture(scope="module")
def observables():
    return Observables.of_nominal([trace(), trace()])


def of(observables, made, quantity, statistic):
    group = next(g for g in observables.groups if (g.quantity, g.statistic) == (quantity, statistic))
    return observables.vector(made)[group.start : group.stop]


def test_a_delay_shows_in_the_product_with_the_rate_of_the_command(observables):
    times, sign, rate = of(observables, trace(0.01), "residual.force", "product") - of(
        observables, trace(), "residual.force", "product"
    )
    assert rate < 0
    assert abs(rate) > 5 * max(abs(times), abs(sign))
    twice = of(observables, trace(0.02), "residual.force", "product")[2]
    assert twice == pytest.approx(2 * rate, rel=0.1)


def test_bins_follow_a_motion_in_time(observables):
    bins = of(observables, trace(), "u", "bin")
    middles = (np.arange(50) + 0.5) * 4.0 / 50
    expected = np.sin(2.0 * middles) + 0.3 * np.sin(9.0 * middles)
    assert bins == pytest.approx(expected / np.sqrt((trace()["u"] ** 2).mean()), abs=0.05)


def test_a_vector_has_a_number_for_every_group_of_any_trace(observables):
    size = observables.groups[-1].stop
    for made in (trace(), trace(end=300), trace(end=1)):
        assert observables.vector(made).shape == (size,)
    bare = Trace(TIMES, {"u": trace()["u"]}, {"u": "N"})
    vector = observables.vector(bare)
    for group in observables.groups:
        missing = group.quantity == "residual.force" or group.statistic == "flag"
        assert np.isnan(vector[group.start : group.stop]).all() == missing, group


def test_a_trace_that_ends_early_has_no_value_for_the_rest(observables):
    bins = of(observables, trace(end=400), "u", "bin")
    assert np.isfinite(bins[:24]).all()
    assert np.isnan(bins[26:]).all()
    assert bins[:24] == pytest.approx(of(observables, trace(), "u", "bin")[:24])


def test_the_order_of_channels_changes_no_observable(observables):
    made = trace(0.01)
    turned = Trace(TIMES, dict(reversed(made.channels.items())), made.units)
    other = Observables.of_nominal([Trace(TIMES, dict(reversed(trace().channels.items())), made.units)] * 2)
    for group in observables.groups:
        again = of(other, turned, group.quantity, group.statistic)
        assert again == pytest.approx(of(observables, made, group.quantity, group.statistic), nan_ok=True)


def test_two_channels_of_one_quantity_have_a_difference():
    measured = trace()["u"] + 0.01 * np.cos(3.0 * TIMES)
    units = {"u": "N", "u_meas": "N"}
    nominal = Trace(TIMES, {"u": trace()["u"], "u_meas": measured}, units)
    assert "u - u_meas" in {q.name for q in Observables.of_nominal([nominal]).quantities}


def test_a_residual_that_is_nothing_at_nominal_is_kept():
    """A grip residual is 0 until a foot slips: it is the best sign of a slippery floor."""
    nominal = trace(**{"residual.grip": np.zeros(TIMES.size)})
    found = Observables.of_nominal([nominal])
    slipping = trace(**{"residual.grip": np.where(TIMES > 2.0, 1.0, 0.0)})
    assert of(found, slipping, "residual.grip", "bin")[-1] > 0.5


def test_an_experiment_without_protocols_is_refused():
    from s2r_cart import Cart

    with pytest.raises(UsageError, match="has no protocols"):
        Experiment("chirp").run(Cart(), 0)
    assert str(Experiment.test({"vd": 0.5, "acc": 2.0})) == "acc = 2, vd = 0.5"
