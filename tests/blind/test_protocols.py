"""Protocols of the quadrotor, the car, the arm and the balancing robot, each by the code of its two authors."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.outsiders.lab import Lab
from benchmarks.diagnose import protocol_signatures as signatures
from s2r_spec import load_backend
from s2r_spec.backend import registry
from s2r_spec.errors import UsageError
from s2r_spec.protocols import PROTOCOL, HasProtocols
from tests.errors import naming

BLIND = Path(__file__).parents[2] / "benchmarks" / "blind"
MACHINES = ("quad", "car", "segway", "arm")
each = pytest.mark.parametrize("name", MACHINES)
each_that_runs = pytest.mark.parametrize(
    "name", ["quad", "car", "segway", pytest.param("arm", marks=pytest.mark.slow)]
)
"""The arm takes as long to compile as the three others together, and is held to the same."""


@pytest.fixture(scope="module")
def pairs():
    """Return machine → its simulator, and the laboratory of its independent machine."""
    with pytest.MonkeyPatch.context() as patch:
        for name in MACHINES:
            patch.syspath_prepend(str(BLIND / name / "simulator"))
        registry._factory.cache_clear()
        yield {name: (load_backend(name), Lab(module(name))) for name in MACHINES}
    registry._factory.cache_clear()


def module(name):
    return importlib.import_module(f"benchmarks.blind.{name}.protocols")


@each
def test_both_offer_the_same_protocols_and_ask_for_the_same(name, pairs):
    ours, theirs = (
        [(p.name, p.place, p.duration, [(q.name, q.unit, q.low, q.high, q.default) for q in p.parameters])
         for p in one.protocols()]
        for one in pairs[name]
    )  # fmt: skip
    assert all(isinstance(one, HasProtocols) for one in pairs[name])
    assert ours == theirs
    plan = sys.modules[f"s2r_{name}_protocols"].plan
    for protocol in pairs[name][0].protocols():
        for amplitude in (1.0, 0.3):
            planned = plan(protocol.name, amplitude), module(name).reference(protocol.name, amplitude)
            for one, other in zip(*planned, strict=True) if isinstance(planned[0], tuple) else [planned]:
                np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-9)


@each_that_runs
def test_every_protocol_runs_on_both_and_follows_from_its_seed(name, pairs):
    simulator, lab = pairs[name]
    for machine in (simulator, lab):
        first = simulator.protocols()[0].name
        one, again, other = (machine.run(first, {}, seed) for seed in (1, 1, 2))
        for channel in one.channels:
            np.testing.assert_array_equal(one[channel], again[channel])
        assert any(not np.array_equal(one[channel], other[channel]) for channel in one.channels)
    for protocol in simulator.protocols():
        for machine in (simulator, lab):
            trace = machine.run(protocol.name, {}, 1)
            assert trace.failure is None
            assert trace.meta[PROTOCOL] == protocol.name
            assert trace.duration == pytest.approx(protocol.duration)
            assert dict(trace.units) == {channel.name: channel.unit for channel in simulator.channels}
            small = machine.run(protocol.name, {protocol.parameters[0].name: protocol.parameters[0].low}, 1)
            assert any(not np.array_equal(trace[channel], small[channel]) for channel in trace.channels)
        with pytest.raises(
            UsageError, match=naming(f"'{protocol.name}x'", f"did you mean '{protocol.name}'")
        ):
            simulator.run(f"{protocol.name}x", {}, 0)


@pytest.mark.parametrize(
    # benchmarks/diagnose/protocol_signatures.py prints 42 and 21 σ of one run in the chirp,
    # and at most 5 in six tests of the spec.
    # The independent machine's lag is of second order, and so nearer to a delay; it needs twice the time.
    ("which", "time"),
    [(signatures.simulator, 0.008), (signatures.independent, 0.016)],
)
def test_a_chirp_tells_a_rotor_lag_from_an_equal_delay_and_the_tests_of_the_spec_do_not(which, time, pairs):
    bench = which("quad")
    of = {"simulator": lambda name: {name: {"time": time}}, "independent": lambda name: {name: time}}[
        which.__name__
    ]
    found = {
        experiment: bench.apart(experiment, of("rotor_lag"), of("command_delay"))[0]
        for experiment in (*bench.experiments[: signatures.TESTS], "pitch_chirp")
    }
    assert found.pop("pitch_chirp") > 10.0
    assert max(found.values()) < 6.0


@pytest.mark.parametrize(
    # From the same command: the best of six tests, and the protocol.
    ("name", "effect", "protocol", "tests", "least"),
    [
        ("quad", "command_delay", "rotor_steps", 12.0, 30.0),
        ("car", "steer_delay", "steer_chirp", 30.0, 35.0),
        ("segway", "latency", "chirp", 4.0, 12.0),
    ],
)
def test_a_protocol_shows_a_quarter_of_a_typical_delay_better_than_the_spec(
    name, effect, protocol, tests, least, pairs
):
    bench = signatures.simulator(name)
    change = {each: bench.change(each, bench.effects[effect]) for each in ("0", "1", protocol)}
    assert max(bench.sigma(each, change[each]) for each in ("0", "1")) < tests
    assert bench.sigma(protocol, change[protocol]) > least
