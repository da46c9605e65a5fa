"""The axis's protocols: what they ask for, that both codes ask for the same, and that each shows what it is for."""

import numpy as np
import pytest

from benchmarks.blind.emps import protocols
from benchmarks.blind.emps.machine import Machine
from benchmarks.blind.emps.protocols import LENGTHS, RUNS, Lab
from s2r_emps import EmpsBackend
from s2r_emps.noise import Noise
from s2r_emps.protocols import reference
from s2r_spec.errors import TraceError, UsageError
from s2r_spec.protocols import PLAYED, PROTOCOL, HasInputs, HasProtocols
from tests.errors import naming

AXIS = EmpsBackend()
QUIET = EmpsBackend(noise=Noise.off())
each = pytest.mark.parametrize("name", LENGTHS)


def test_the_axis_and_its_independent_machine_have_the_same_protocols():
    for backend in (AXIS, Lab()):
        assert isinstance(backend, HasProtocols)
    ours, theirs = (
        [(p.name, p.place, p.duration, [(q.name, q.unit, q.low, q.high, q.default) for q in p.parameters])
         for p in backend.protocols()]
        for backend in (AXIS, Lab())
    )  # fmt: skip
    assert ours == theirs
    assert Lab().protocols() == RUNS


@each
@pytest.mark.parametrize("amplitude", [1.0, 0.3])
def test_both_codes_ask_for_the_same(name, amplitude):
    ours, theirs = reference(name, amplitude), protocols.reference(name, amplitude)
    np.testing.assert_allclose(ours[0], theirs[0], rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(ours[1], theirs[1])
    assert 0.0 < ours[0].min() < ours[0].max() < 0.25


@each
def test_a_protocol_is_a_function_of_its_parameters_and_its_seed(name):
    (protocol,) = (p for p in AXIS.protocols() if p.name == name)
    trace, again, other = (AXIS.run(name, {"amplitude": 0.5}, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(trace["q"], again["q"])
    assert not np.array_equal(trace["q"], other["q"])
    assert trace.meta[PROTOCOL] == name
    assert trace.meta["params"] == {p.name: p.default for p in protocol.parameters} | {"amplitude": 0.5}
    assert trace.duration == pytest.approx(protocol.duration)
    assert dict(trace.units) == {channel.name: channel.unit for channel in AXIS.channels}
    softer = AXIS.run(name, {"amplitude": 0.5, "gain": 0.5}, 3)
    assert not np.array_equal(trace["u"], softer["u"])


def test_an_unknown_protocol_and_a_value_out_of_range_get_a_sentence():
    with pytest.raises(UsageError, match=naming("'emps'", "'chrip'", "did you mean 'chirp'")):
        AXIS.run("chrip", {}, 0)
    with pytest.raises(UsageError, match=naming("payload = 80 kg", "[5, 60] kg")):
        AXIS.run("loaded", {"payload": 80.0}, 0)


def test_a_coasting_carriage_slows_down_by_its_friction_alone():
    slowed = QUIET.with_effects({"coulomb": {"force": 19.0}}).run("coast_down", {}, 0)
    coasting = slowed.times > 0.32
    assert np.all(slowed["u"][coasting] == 0.0)
    assert np.ptp(QUIET.run("coast_down", {}, 0)["v"][coasting]) < 1e-9
    slope = np.polyfit(slowed.times[coasting], slowed["v"][coasting], 1)[0]
    assert slope == pytest.approx(-19.0 / 95.0, rel=1e-6)


def test_the_residual_of_a_protocol_knows_its_payload_and_its_gain():
    for params in ({}, {"payload": 55.0, "gain": 0.7}):
        trace = QUIET.run("loaded", params, 0)
        left = QUIET.residuals(trace, params)
        inertia = (95.0 + params.get("payload", 30.0)) * 1.3  # N at the chirp's largest acceleration
        assert np.sqrt(np.mean(left["force"] ** 2)) < 0.05 * inertia
        assert np.abs(left["controller"]).max() < 1e-6


def test_a_played_voltage_moves_the_axis_as_its_own_controller_did():
    assert isinstance(AXIS, HasInputs)
    recorded = QUIET.rollout({"payload": 10.0}, 0)
    played = QUIET.play(recorded, {"payload": 10.0}, 1)
    np.testing.assert_allclose(played["q"], recorded["q"], rtol=0.0, atol=1e-9)
    assert played.meta[PROTOCOL] == PLAYED
    # Without feedback a loss of force is not made up for.
    weak = QUIET.with_effects({"motor_gain": {"factor": 0.9}}).play(recorded, {"payload": 10.0}, 1)
    assert np.ptp(weak["q"]) == pytest.approx(0.9 * np.ptp(recorded["q"]), rel=1e-3)
    assert set(QUIET.residuals(weak, {"payload": 10.0}).channels) == {"force"}
    with pytest.raises(TraceError, match=naming("0.001 s")):
        QUIET.play(recorded.resample(0.002), {}, 0)


def test_the_independent_machine_runs_protocols_and_coasts_with_its_friction(monkeypatch):
    # It integrates 24,000 substeps of a chirp one by one. So only the begin of a run is tested.
    monkeypatch.setitem(LENGTHS, "steps", 0.11)
    monkeypatch.setitem(LENGTHS, "coast_down", 0.36)
    lab = Lab()
    trace, again = (lab.run("steps", {"gain": 0.7}, 1) for _ in range(2))
    np.testing.assert_array_equal(trace["q"], again["q"])
    assert trace.meta[PROTOCOL] == "steps"
    assert dict(trace.units) == {channel.name: channel.unit for channel in AXIS.channels}
    ends = [each.run("coast_down", {}, 1)["q"][-1] for each in (lab, Lab(Machine(coulomb=60.0)))]
    assert ends[0] - ends[1] > 0.5 * (60.0 / 95.0) * 0.06**2 / 2
