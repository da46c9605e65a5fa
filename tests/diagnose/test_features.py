"""Feature vectors, of channels that are written down here."""

from __future__ import annotations

import importlib

import numpy as np
import pytest

from s2r_spec.trace import Trace

features = importlib.import_module("s2r_spec.diagnose.features")

TIMES = np.linspace(0.0, 4.0, 801)


def trace(late: float) -> Trace:
    """Return a command, and the force residual of a model without delay where the machine is late by this [s]."""
    command = np.sin(2.0 * TIMES) + 0.3 * np.sin(9.0 * TIMES)
    lacking = np.sin(2.0 * (TIMES - late)) + 0.3 * np.sin(9.0 * (TIMES - late)) - command
    lacking = lacking + 1e-3 * np.cos(40.0 * TIMES)
    return Trace(TIMES, {"u": command, "residual.force": lacking}, {"u": "N", "residual.force": "N"})


@pytest.fixture(scope="module")
def chosen():
    return features.Features.of_nominal([trace(0.0), trace(0.0)], 4.0)


def of(chosen, made, statistic):
    place = [f.block == "residual.force" and f.statistic == statistic for f in chosen.names()].index(True)
    return chosen.vector(made)[place] - chosen.vector(trace(0.0))[place]


def test_a_delay_shows_in_what_goes_with_the_rate_of_the_command_and_in_nothing_else(chosen):
    late = of(chosen, trace(0.01), "times rate u")
    assert late < 0
    assert abs(late) > 5 * abs(of(chosen, trace(0.01), "times u"))
    assert of(chosen, trace(0.02), "times rate u") == pytest.approx(2 * late, rel=0.1)


def test_a_vector_has_a_number_for_every_name_of_any_trace(chosen):
    whole = trace(0.01)
    fallen = Trace(TIMES[:300], {n: x[:300] for n, x in whole.channels.items()}, whole.units)
    for made in (whole, fallen, Trace(TIMES[:1], {n: x[:1] for n, x in whole.channels.items()}, whole.units)):
        assert chosen.vector(made).shape == (len(chosen.names()),)
    bare = Trace(TIMES, {"u": whole.channels["u"]}, {"u": "N"})
    found = dict(zip(chosen.names(), chosen.vector(bare), strict=True))
    assert all(np.isnan(v) == (f.block == "residual.force") for f, v in found.items())
