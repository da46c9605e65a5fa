"""A recording that breaks the controller's own law has a mistake, whatever the physics of the machine is."""

import re
from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.backend import HasControlLaw
from s2r_spec.diagnose.quality import certain_findings
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.effects import catalogue_of

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
EFFECTS = {
    "emps": {"coulomb": {"force": 20.0}, "delay": {"time": 0.002}},
    "turtlebot": {"latency": {"delay": 0.1}, "heading_bias": {"angle": 0.04}},
}


def recorded(name, effects=None, spoil=lambda trace: trace):
    machine = BENCHES[name].backend.with_effects(effects or {})
    return [(test, spoil(machine.rollout(test, seed))) for seed, test in enumerate(TESTS[name])]


def changed(names, change):
    return lambda trace: trace.with_channels(lambda n, x: change(trace.times, x) if n in names else x)


def exchanged(one, other):
    names = {one: other, other: one}
    return lambda trace: trace.with_channels(lambda n, _: trace[names.get(n, n)])


def late(by, *names):
    return changed(names, lambda t, x: np.interp(t - by, t, x))


def scaled(by, *names):
    return changed(names, lambda _, x: by * x)


def turned(angle):
    def spoil(trace):
        x, y = (trace[n] - trace[n][0] for n in "xy")
        c, s = np.cos(angle), np.sin(angle)
        new = {
            "x": trace["x"][0] + c * x - s * y,
            "y": trace["y"][0] + s * x + c * y,
            "heading": trace["heading"] + angle,
        }
        return trace.with_channels(lambda n, values: new.get(n, values))

    return spoil


def said(name, runs):
    return [
        (one.code, {*one.channel.replace(" and ", ", ").split(", ")})
        for one in certain_findings(BENCHES[name], runs)
    ]


@pytest.mark.parametrize("name", BENCHES)
def test_a_machine_with_any_effect_obeys_its_controllers_law(name):
    backend = BENCHES[name].backend
    assert isinstance(backend, HasControlLaw)
    for effect in catalogue_of(backend):
        typical = {
            p.name: 0.5 * (p.nominal + (p.high if p.high > p.nominal else p.low)) for p in effect.parameters
        }
        assert said(name, recorded(name, {effect.name: typical})) == []


@pytest.mark.parametrize(
    ("name", "spoil", "code", "channels", "size"),
    [
        ("emps", exchanged("q", "q_ref"), "exchanged", {"q", "q_ref"}, None),
        ("emps", late(0.0034, "q"), "late", {"q"}, 0.0034),
        ("emps", late(0.05, "q", "v", "u", "force", "q_ref"), "begin", {"the clock"}, 0.05),
        ("emps", scaled(1.04, "q"), "scale", {"q"}, 1.04),
        ("turtlebot", exchanged("x", "y"), "exchanged", {"x", "y"}, None),
        ("turtlebot", scaled(-1.0, "heading"), "sign", {"heading"}, None),
        ("turtlebot", late(0.07, "v", "w"), "late", {"v", "w"}, 0.07),
        ("turtlebot", scaled(180.0 / np.pi, "heading"), "unit", {"heading"}, 57.3),
        ("turtlebot", changed(["x"], lambda t, x: x + 0.1), "offset", {"x"}, 0.1),
        ("turtlebot", scaled(1.04, "d_goal"), "scale", {"d_goal"}, 1.04),
        ("turtlebot", turned(0.3), "frame", {"x", "y", "heading"}, 0.3),
    ],
)
def test_a_mistake_is_found_exactly_beside_effects(name, spoil, code, channels, size):
    (only,) = certain_findings(BENCHES[name], recorded(name, EFFECTS[name], spoil))
    assert (only.code, {*only.channel.replace(" and ", ", ").split(", ")}) == (code, channels)
    if size is not None:
        numbers = [float(number) for number in re.findall(r"\d+\.?\d*", only.text)]
        assert min(abs(number / size - 1.0) for number in numbers) < 0.02


def test_recordings_under_the_tests_of_others_are_found():
    tests, traces = zip(*recorded("turtlebot", EFFECTS["turtlebot"]), strict=True)
    ((code, _),) = said("turtlebot", [*zip((*tests[1:], tests[0]), traces, strict=True)])
    assert code == "labels"


def test_a_unit_of_one_recording_is_found():
    first, *others = recorded("emps")
    ((code, channels),) = said("emps", [(first[0], scaled(1000.0, "u")(first[1])), *others])
    assert (code, channels) == ("unit of one", {"u"})


def test_nothing_is_estimated_from_recordings_that_break_the_law(tmp_path):
    runs = 2 * recorded("emps", {"viscous": {"coefficient": 300.0}}, late(0.01, "q"))
    answer = s2r.diagnose(ROOT / "specs" / "emps_tracking.stl", "emps", runs, cache=tmp_path)
    assert answer.exit_code == 3
    assert (answer.which.answer, answer.which.effects, answer.patch) == ((), (), {})
    assert [one.code for one in answer.evidence.findings] == ["late"]
    assert answer.rule.word == "broken"
    assert not [*tmp_path.iterdir()]  # no library was simulated


@pytest.mark.skipif(not MACHINES.is_dir(), reason="the machines of other authors are not beside the checkout")
@pytest.mark.parametrize(
    ("name", "found"), [("n10", [("exchanged", {"q_ref", "q"})]), ("n09", []), ("e03", [])]
)
def test_an_axis_of_another_author(name, found):
    assert said("emps", s2r.load_backend(f"log:{MACHINES / name}/").recorded()) == found


@pytest.mark.skipif(not MACHINES.is_dir(), reason="the machines of other authors are not beside the checkout")
@pytest.mark.parametrize("name", ["t04", "t05", "t09", "t12", "t14", "n02", "n03"])
def test_a_turtlebot_of_another_author(name):
    assert said("turtlebot", s2r.load_backend(f"log:{MACHINES / name}/").recorded()) == []
