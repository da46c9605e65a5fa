"""A mistake of a recording is told from physics: what it is, and where; no machine is taken for it."""

import re
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.diagnose.quality.channels import hold
from s2r_spec.diagnose.quality.comparison import compare
from s2r_spec.diagnose.quality.decide import find_suspects
from s2r_spec.diagnose.quality.recordings import Recordings
from s2r_spec.diagnose.simulator.axes import effect_axes
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.effects import catalogue_of
from s2r_turtlebot.effects import TurtlebotWithEffects

ROOT = Path(__file__).parents[2]


class Remembering(TurtlebotWithEffects):
    """A robot that without effects runs no rollout twice: all tests ask for mostly the same ones of it."""

    kept: ClassVar = {}

    def rollout(self, params, seed):
        if self.added:
            return super().rollout(params, seed)
        key = (*sorted(params.items()), seed)
        if key not in self.kept:
            self.kept[key] = super().rollout(params, seed)
        return self.kept[key]


BENCH = Bench.of(s2r.load_spec(ROOT / "specs" / "turtlebot.stl"), "delivers", Remembering())
LINES = effect_axes(catalogue_of(BENCH.backend))
TESTS = [{"ox": ox, "oy": oy} for ox in (-0.25, -0.05, 0.2) for oy in (0.03, 0.15, 0.27)]
POSES = ("x", "y", "heading", "d_goal", "d_obs")


def recorded(effects=None, spoil=lambda trace: trace):
    """Return rollouts of a machine with these effects, and a mistake in each recording."""
    machine = BENCH.backend.with_effects(effects) if effects else BENCH.backend
    return [(test, spoil(machine.rollout(test, 300 + n))) for n, test in enumerate(TESTS)]


@pytest.fixture(scope="module")
def nominal():
    """The simulator beside recordings of these tests, which are replaced."""
    return compare(BENCH, recorded(), LINES)


def found(nominal, runs):
    """Return what is said of recordings at the same tests as those of ``nominal``."""
    held, straight = hold(Recordings(BENCH, runs))
    of_test = {tuple(test.values()): trace for test, trace in straight.rollouts}
    traces = tuple(of_test[tuple(test.values())] for test in nominal.tests)
    return [*held, *find_suspects(BENCH, replace(nominal, traces=traces), straight.rollouts)]


def changed(trace, **channels):
    return s2r.Trace(trace.times, dict(trace.channels) | channels, trace.units, trace.meta)


def late(samples, names=POSES):
    def spoil(trace):
        at = np.maximum(np.arange(len(trace)) - samples, 0)
        return changed(trace, **{name: trace[name][at] for name in names})

    return spoil


def turned(angle):
    def spoil(trace):
        x, y = trace["x"] - trace["x"][0], trace["y"] - trace["y"][0]
        c, s = np.cos(angle), np.sin(angle)
        return changed(
            trace,
            x=trace["x"][0] + c * x - s * y,
            y=trace["y"][0] + s * x + c * y,
            heading=trace["heading"] + angle,
        )

    return spoil


def exchanged(a, b):
    return lambda trace: changed(trace, **{a: trace[b], b: trace[a]})


def mirrored(*names):
    return lambda trace: changed(trace, **{name: -trace[name] for name in names})


def scaled(factor, *names):
    return lambda trace: changed(trace, **{n: trace[n][0] + factor * (trace[n] - trace[n][0]) for n in names})


def held(samples, names=POSES):
    def spoil(trace):
        at = np.arange(len(trace)) // samples * samples
        return changed(trace, **{name: trace[name][at] for name in names})

    return spoil


def fast(factor):
    """A clock by which everything happens so many times as fast."""

    def spoil(trace):
        at = np.minimum(factor * trace.times, trace.times[-1])
        return changed(trace, **{n: np.interp(at, trace.times, x) for n, x in trace.channels.items()})

    return spoil


def shifted(by, name):
    return lambda trace: changed(trace, **{name: trace[name] + by})


MISTAKES = {
    "poses 0.1 s late": (late(5), "late", set(POSES), 0.1),
    "commands 0.12 s late": (late(6, ("v", "w")), "late", {"v", "w"}, 0.12),
    "a frame turned by -0.2 rad": (turned(-0.2), "frame", {"x", "y", "heading"}, -0.2),
    "distances exchanged": (exchanged("d_goal", "d_obs"), "exchanged", {"d_goal", "d_obs"}, None),
    "another convention": (mirrored("y", "heading", "w"), "sign", {"y", "heading", "w"}, None),
    "positions 5 % short": (scaled(0.95, "x", "y"), "scale", {"x", "y"}, 5.0),
    "poses held for 0.3 s": (held(15), "hold", set(POSES), 0.3),
    "heading off by 0.15 rad": (shifted(0.15, "heading"), "offset", {"heading"}, 0.15),
    "a clock 10 % slow": (fast(0.9), "clock", {"the clock"}, 0.9),
}


def channels(finding):
    return set(finding.channel.replace(" and ", ", ").split(", "))


LONG = {"commands 0.12 s late", "a frame turned by -0.2 rad", "another convention", "positions 5 % short"}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in LONG else []) for name in MISTAKES]
)
def test_a_mistake_is_named_with_its_channels_and_its_size(nominal, name):
    spoil, code, where, size = MISTAKES[name]
    finding, *others = found(nominal, recorded(spoil=spoil))
    assert (finding.code, channels(finding)) == (code, where)
    # Where the machine is its own mirror image, so are its tests.
    assert {other.code for other in others} <= {"labels"}
    if size is not None:
        said = [float(number) for number in re.findall(r"-?\d+\.?\d*", finding.text)]
        assert said[0] == pytest.approx(size, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "effects", "code"),
    [
        (late(8), {"position_bias": {"left": -0.06}}, "late"),
        (exchanged("x", "y"), {"heading_bias": {"angle": 0.15}}, "exchanged"),
        (turned(0.15), {"position_bias": {"left": 0.06}}, "frame"),
    ],
)
def test_beside_an_effect_it_is_named_too(nominal, spoil, effects, code):
    assert code in [finding.code for finding in found(nominal, recorded(effects, spoil))]


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"position_bias": {"left": 0.1}},
        {"latency": {"delay": 0.14}},
        {"motor_lag": {"time": 0.25}},
        {"turning_slip": {"coefficient": 2.0}},
        pytest.param({"speed_limit": {"speed": 0.25}}, marks=pytest.mark.slow),
        pytest.param({"heading_bias": {"angle": -0.3}}, marks=pytest.mark.slow),
        pytest.param({"axle_length": {"factor": 1.4}, "latency": {"delay": 0.08}}, marks=pytest.mark.slow),
    ],
)
def test_no_mistake_is_seen_in_what_a_machine_does(nominal, effects):
    assert found(nominal, recorded(effects)) == []


def test_an_effect_that_no_data_tell_from_a_mistake_is_said_to_be_one_of_two(nominal):
    [finding] = found(nominal, recorded({"wheel_radius": {"factor": 1.2}}))
    assert finding.code == "clock"
    assert finding.same


def moved(rows, first):
    """Return rows of a table in which one line was entered twice: all below stand one too late."""
    tests = [test for test, _ in rows]
    tests = [*tests[:first], tests[first], *tests[first:-1]]
    return [(test, trace) for test, (_, trace) in zip(tests, rows, strict=True)]


@pytest.mark.parametrize(
    ("mislabelled", "name"),
    [
        (lambda rows: moved(rows, 3), "test"),
        (lambda rows: [({**test, "ox": -test["ox"]}, trace) for test, trace in rows], "ox"),
        pytest.param(
            lambda rows: [({**test, "oy": -test["oy"]}, trace) for test, trace in rows],
            "oy",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_recordings_under_another_test_are_told(mislabelled, name):
    runs = mislabelled(recorded())
    [finding] = [
        each for each in find_suspects(BENCH, compare(BENCH, runs, LINES), runs) if each.code == "labels"
    ]
    assert finding.channel == "the tests"
    assert name in finding.text
