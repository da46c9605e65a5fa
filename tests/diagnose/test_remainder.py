"""What the equations of motion leave of a machine, and where."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_emps import EmpsBackend
from s2r_spec.diagnose.equations import Probe
from s2r_spec.diagnose.features import Features
from s2r_spec.diagnose.prepare import bench_of
from s2r_spec.diagnose.remainder import FEWEST_ROLLOUTS, Cells, Remainder, _part, remainders
from s2r_spec.trace import Trace

PROBES = (
    Probe("mass", "extra", 12.0, 1.0),
    Probe("motor_gain", "factor", 1.1, 1.0),
    Probe("coulomb", "force", 20.0, 1.0),
)
TESTS = [
    {"speed": v, "accel": a, "payload": m}
    for v, a, m in zip(
        np.linspace(0.06, 0.15, 8), np.linspace(3.0, 1.0, 8), np.linspace(0.0, 30.0, 8), strict=True
    )
]


@pytest.fixture(scope="module")
def bench():
    spec = s2r.load_spec("specs/emps_tracking.stl")
    found = bench_of(spec, spec.requirements[0], EmpsBackend())
    traces = [found.seen(found.run({}, test, seed), test) for seed, test in enumerate(TESTS[:3])]
    features = Features.of_nominal(traces, found.backend.duration)
    return replace(found, features=replace(features, probes=PROBES, instrumented=True))


def with_push(trace, when, force=30.0):
    """The same motion with so much less force of the motor where ``when`` says: something else pushed."""
    u = trace["u"] - np.where(when(trace), force / 35.15, 0.0)
    return Trace(trace.times, dict(trace.channels) | {"u": u}, trace.units, trace.meta)


def rollouts(bench, values, when=None):
    runs = [(test, bench.run(values, test, 50 + n)) for n, test in enumerate(TESTS)]
    return [(test, trace if when is None else with_push(trace, when)) for test, trace in runs]


def test_of_a_machine_that_is_the_improved_simulator_nothing_is_left(bench):
    values = {"coulomb": {"force": 20.0}}
    left = remainders(bench, rollouts(bench, values), values)
    assert left
    assert not any(each.material for each in left)
    # Nor if it is not improved: what an effect does is explained, whether or not it was named.
    assert not any(each.material for each in remainders(bench, rollouts(bench, values), {}))


def test_a_push_at_one_place_is_left_there(bench):
    left = remainders(bench, rollouts(bench, {}, lambda t: (t["q"] > 0.10) & (t["q"] < 0.125)), {})
    first = left[0]
    assert (first.residual, first.unit, first.along_unit) == ("force", "N", "m")
    assert first.along in (
        "q",
        "q_ref",
    )  # the carriage is where it should be to within a tenth of a millimetre
    assert first.material
    assert 0.09 < first.low < first.high < 0.135
    assert first.size == pytest.approx(30.0, rel=0.35)
    assert str(first).startswith(f"{first.size:+.3g} N of force where {first.along} is between 0.1")


def test_a_push_for_some_time_is_left_then(bench):
    left = remainders(bench, rollouts(bench, {}, lambda t: (t.times > 0.7) & (t.times < 0.9)), {})
    first = left[0]
    assert (first.residual, first.along, first.along_unit) == ("force", "", "s")
    assert first.material
    assert 0.65 < first.low < first.high < 0.95
    assert "between 0." in str(first)


def test_of_two_rollouts_and_of_a_simulator_that_explains_nothing_nothing_is_told(bench):
    push = rollouts(bench, {}, lambda t: t["q"] > 0.1)
    assert remainders(bench, push[: FEWEST_ROLLOUTS - 1], {}) == ()
    bare = replace(bench, features=replace(bench.features, probes=()))
    assert remainders(bare, push, {}) == ()


def test_recordings_without_what_a_residual_needs_have_no_part_in_it(bench):
    push = rollouts(bench, {}, lambda t: (t["q"] > 0.10) & (t["q"] < 0.125))
    mute = [(test, trace.only(["q"])) for test, trace in rollouts(bench, {})]
    assert remainders(bench, mute, {}) == ()
    both = remainders(bench, mute + push, {})
    assert both[0].material
    assert both[0].along in ("q", "q_ref")


def test_a_fall_has_no_part_in_it(bench):
    push = rollouts(bench, {}, lambda t: t["q"] > 0.1)
    fell = [(test, Trace(t.times, t.channels, t.units, {"failure": "fall"})) for test, t in push]
    assert remainders(bench, fell, {}) == ()
    quiet = rollouts(bench, {})
    assert not any(each.material for each in remainders(bench, quiet + fell, {}))


def test_cells_are_as_many_as_their_means_and_lie_side_by_side(bench):
    machine = rollouts(bench, {})
    cells = Cells.of(bench, [trace for _, trace in machine])
    places = cells.places()
    motion = bench.features.asked(bench.backend).motion(machine[0][1], machine[0][0])
    rest, taken = cells.means(motion, machine[0][1])
    assert rest.shape == (len(places),)
    assert taken.shape == (len(PROBES), len(places))
    of_force = [place for place in places if place[:3] == ("force", 0, "q")]
    assert of_force[0][3] == -np.inf
    assert of_force[-1][4] == np.inf
    assert all(one[4] == other[3] for one, other in pairwise(of_force))
    # All samples of a motion are in one cell along each channel: their mean is that of the cells.
    counted = np.nanmean(rest[[n for n, place in enumerate(places) if place[:3] == ("force", 0, "")]])
    assert counted == pytest.approx(motion.rest[0].mean(), abs=0.3)


def test_a_column_of_many_is_told_by_the_part_it_is_of_or_by_its_number():
    two = Trace(
        np.arange(3.0),
        {"torque": np.zeros((3, 2)), "force": np.zeros(3)},
        {},
        {"parts": {"torque": ["hip", "knee"]}},
    )
    assert [_part(two, "torque", k, 2) for k in (0, 1)] == ["hip", "knee"]
    assert _part(two, "force", 0, 1) == ""
    assert _part(two.only(["torque"]), "torque", 1, 2) == "knee"
    bare = Trace(two.times, {"torque": two["torque"]}, {})
    assert _part(bare, "torque", 1, 2) == "column 1"


def test_an_end_that_is_nowhere_is_said_so_and_is_no_number_in_json():
    beyond = Remainder("motor", 2, "", "tau", 10.0, np.inf, -3.2, "N*m", "N*m", 2.0)
    assert str(beyond) == "-3.2 N*m of motor where tau is above 10 N*m"
    assert str(replace(beyond, low=-np.inf, high=-4.0)) == "-3.2 N*m of motor where tau is below -4 N*m"
    assert beyond.to_json()["high"] is None
    assert beyond.to_json()["low"] == 10.0
