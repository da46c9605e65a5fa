"""The same axis, idealised otherwise: nobody's cause of a gap."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.emps import axis
from benchmarks.blind.emps.machine import Machine
from benchmarks.blind.emps_compare import SIDE, without_noise
from s2r_emps import EmpsBackend
from s2r_emps.noise import Noise
from s2r_emps.physics import Physics
from s2r_spec.backend import HasVariants

TICKS = 2501


def smooth(u):
    return np.convolve(u, np.ones(10) / 10, "valid")


@pytest.mark.slow
def test_a_screw_that_yields_does_what_two_bodies_on_a_spring_do(monkeypatch):
    """Against another code path, which has the spring itself: Runge-Kutta, a mass on either side."""
    soft, hard = 2e7, 4e8  # N/m
    monkeypatch.setattr(axis, "_DAMPING", 5e3)  # N*s/m: ours has none
    theirs = []
    for stiffness in (soft, hard):
        monkeypatch.setattr(axis, "_STIFFNESS", stiffness)
        theirs.append(without_noise([Machine()], SIDE, TICKS)["u"][0])
    ours = [
        EmpsBackend(noise=Noise.off(), physics=Physics(compliance=1.0 / stiffness)).rollout(SIDE, 0)["u"]
        for stiffness in (soft, hard)
    ]
    them, us = (smooth(u[0] - u[1]) for u in (theirs, ours))
    assert np.corrcoef(them, us)[0, 1] > 0.95
    assert them @ us / (us @ us) == pytest.approx(1.0, abs=0.15)


def test_the_variants_differ_from_nominal_by_little_and_by_no_effect():
    backend = EmpsBackend()
    assert isinstance(backend, HasVariants)
    nominal = backend.rollout(SIDE, 0)
    for name, variant in backend.variants().items():
        trace = variant.rollout(SIDE, 0)
        assert not np.array_equal(trace["q"], nominal["q"]), name
        assert np.abs(trace["q"] - nominal["q"]).max() < 2e-5, name  # m, of 2 mm that the spec allows
        assert variant.chosen() == {}
        assert variant.model_hash != backend.model_hash


def test_a_delay_differs_from_a_lag_by_what_a_screw_does_that_yields():
    nominal = EmpsBackend(noise=Noise.off())
    screw = replace(nominal.variants()["a screw that yields"], noise=Noise.off())
    rigid, yielding, delay, lag = (
        machine.rollout(SIDE, 0)["u"]
        for machine in (
            nominal,
            screw,
            nominal.with_effects({"delay": {"time": 0.0015}}),
            nominal.with_effects({"current_lag": {"time": 0.0015}}),
        )
    )
    apart, bent = lag - delay, yielding - rigid
    millivolts = [1000 * np.sqrt(np.mean(x**2)) for x in (apart, bent)]
    page = (Path(__file__).parents[2] / "benchmarks" / "blind" / "README.md").read_text()
    for value in millivolts:
        assert f" {value:.1f} mV" in page
    assert np.corrcoef(apart, bent)[0, 1] > 0.9
