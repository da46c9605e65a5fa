"""A recording that breaks the controller's own law has a mistake, whatever the physics of the machine is."""

from pathlib import Path

import pytest

import s2r_spec as s2r
from s2r_spec.backend import HasControlLaw
from s2r_spec.diagnose.quality import findings
from s2r_spec.diagnose.quality.law import by_law
from s2r_spec.diagnose.quality.recordings import Recordings
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.effects import catalogue_of
from s2r_spec.trace import Trace

ROOT = Path(__file__).parents[2]
MACHINES = ROOT.parent / "shared" / "machines"
BENCHES = {
    "emps": Bench.of(s2r.load_spec(ROOT / "specs" / "emps_tracking.stl"), "tracks", s2r.load_backend("emps")),
    "turtlebot": Bench.of(
        s2r.load_spec(ROOT / "specs" / "turtlebot.stl"), "delivers", s2r.load_backend("turtlebot")
    ),
}
TESTS = {
    "emps": [{"speed": 0.1 + 0.03 * k, "accel": 1.0, "payload": 5.0 * k} for k in range(4)],
    "turtlebot": [{"ox": 0.1 * k - 0.15, "oy": 0.08 + 0.05 * k} for k in range(4)],
}


def recorded(name, effects=None, spoil=lambda trace: trace):
    machine = BENCHES[name].backend.with_effects(effects or {})
    return [(test, spoil(machine.rollout(test, seed))) for seed, test in enumerate(TESTS[name])]


def exchanged(one, other):
    def spoil(trace):
        channels = dict(trace.channels)
        channels[one], channels[other] = channels[other], channels[one]
        return Trace(trace.times, channels, trace.units, trace.meta)

    return spoil


def turned(name):
    return lambda trace: trace.with_channels(lambda one, values: -values if one == name else values)


def mistakes(name, runs):
    return [(each.code, each.channel) for each in by_law(Recordings(BENCHES[name], runs))]


@pytest.mark.parametrize("name", BENCHES)
def test_a_machine_with_any_effect_obeys_its_controllers_law(name):
    backend = BENCHES[name].backend
    assert isinstance(backend, HasControlLaw)
    for effect in catalogue_of(backend):
        typical = {
            p.name: 0.5 * (p.nominal + (p.high if p.high > p.nominal else p.low)) for p in effect.parameters
        }
        assert mistakes(name, recorded(name, {effect.name: typical})) == []


@pytest.mark.parametrize(
    ("name", "spoil", "code", "channels"),
    [
        ("emps", exchanged("q", "q_ref"), "exchanged", {"q", "q_ref"}),
        ("emps", turned("u"), "sign", {"u"}),
        ("turtlebot", exchanged("x", "y"), "exchanged", {"x", "y"}),
        ("turtlebot", turned("heading"), "sign", {"heading"}),
    ],
)
def test_names_and_signs_that_break_the_law_are_found_beside_an_effect(name, spoil, code, channels):
    effects = {"emps": {"coulomb": {"force": 20.0}}, "turtlebot": {"latency": {"delay": 0.1}}}[name]
    ((found, names),) = mistakes(name, recorded(name, effects, spoil))
    assert (found, {*names.split(" and ")}) == (code, channels)


def test_nothing_else_is_said_of_recordings_that_break_the_law():
    (only,) = findings(BENCHES["emps"], recorded("emps", spoil=exchanged("q", "q_ref")))
    assert only.code == "exchanged"


@pytest.mark.skipif(not MACHINES.is_dir(), reason="the machines of other authors are not beside the checkout")
@pytest.mark.parametrize(
    ("name", "found"), [("n10", [("exchanged", "q_ref and q")]), ("n09", []), ("e03", [])]
)
def test_an_axis_of_another_author(name, found):
    machine = s2r.load_backend(f"log:{MACHINES / name}/")
    assert mistakes("emps", machine.recorded()) == found


@pytest.mark.skipif(not MACHINES.is_dir(), reason="the machines of other authors are not beside the checkout")
@pytest.mark.parametrize("name", ["t04", "t05", "t09", "t12", "t14", "n02", "n03"])
def test_a_turtlebot_of_another_author(name):
    assert mistakes("turtlebot", s2r.load_backend(f"log:{MACHINES / name}/").recorded()) == []
