"""What the equations of motion leave of a machine, and where."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_emps import EmpsBackend
from s2r_spec.backend import Channel
from s2r_spec.base.json_values import to_json
from s2r_spec.diagnose.gap import FEWEST
from s2r_spec.diagnose.residuals.cells import CELLS, GRID, CellColumn, Cells, path
from s2r_spec.diagnose.residuals.left import Remainder, begin, label, remainders, sort_remainders
from s2r_spec.diagnose.simulator.axes import effect_axes
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.space import key_of
from s2r_spec.trace import Trace, thin
from tests.errors import states

LINES = [line for line in effect_axes(EmpsBackend().effects()) if line.effect in {"mass", "coulomb", "cable"}]
TESTS = [
    {"speed": v, "accel": a, "payload": m}
    for v, a, m in zip(
        np.linspace(0.06, 0.15, 8), np.linspace(3.0, 1.0, 8), np.linspace(0.0, 30.0, 8), strict=True
    )
]


class Bare(EmpsBackend):
    """The axis without equations of motion."""

    residuals = None


def bench_of(backend):
    spec = s2r.load_spec("specs/emps_tracking.stl")
    return Bench.of(spec, spec.requirements[0], backend)


@pytest.fixture(scope="module")
def bench():
    return bench_of(EmpsBackend())


@pytest.fixture(scope="module")
def bare():
    return bench_of(Bare())


def with_push(trace, when, force=30.0):
    """The same motion with so much less force of the motor where ``when`` says: something else pushed."""
    u = trace["u"] - np.where(when(trace), force / 35.15, 0.0)
    return Trace(trace.times, dict(trace.channels) | {"u": u}, trace.units, trace.meta)


def rollouts(bench, values, when=None):
    runs = [(test, bench.run(values, test, 50 + n)) for n, test in enumerate(TESTS)]
    return [(test, trace if when is None else with_push(trace, when)) for test, trace in runs]


def test_of_a_machine_that_is_the_improved_simulator_nothing_is_left(bench):
    values = {"coulomb": {"force": 20.0}}
    left = remainders(bench, LINES, rollouts(bench, values), values)
    assert left
    assert not any(each.material for each in left)
    # Of one that is not improved, the effect is left where it acts.
    first = remainders(bench, LINES, rollouts(bench, values), {})[0]
    assert first.material
    assert (first.quantity, first.recorded) == ("force", False)


@pytest.mark.parametrize("named", [None, {"coulomb": {"force": 10.0}}])
def test_how_far_it_is_is_told_of_all_stages_as_of_one(bench, named):
    counts = []
    values = {"coulomb": {"force": 20.0}}
    counted = replace(bench, progress=lambda *now: counts.append(now))
    remainders(counted, LINES, rollouts(bench, values), values, named=named)
    assert counts == [(n + 1, len(counts)) for n in range(len(counts))]


def test_a_push_at_one_place_is_left_there(bench):
    left = remainders(bench, LINES, rollouts(bench, {}, lambda t: (t["q"] > 0.10) & (t["q"] < 0.125)), {})
    first = left[0]
    assert (first.quantity, first.unit, first.along_unit) == ("force", "N", "m")
    assert first.along in (
        "q",
        "q_ref",
    )  # the carriage is where it should be to within a tenth of a millimetre
    assert first.material
    assert 0.09 < first.low < first.high < 0.135
    assert first.size == pytest.approx(30.0, rel=0.35)
    assert states(
        str(first), f"{first.size:+.3g} N", "force", first.along, f"{first.low:.3f}", f"{first.high:.3f} m"
    )
    assert first.times is None  # the carriage passes the place at another time in each test
    assert first.extent[0] < first.low < first.high < first.extent[1]


def test_a_push_for_some_time_is_left_then(bench):
    left = remainders(bench, LINES, rollouts(bench, {}, lambda t: (t.times > 0.7) & (t.times < 0.9)), {})
    first = left[0]
    assert (first.quantity, first.along, first.along_unit) == ("force", "", "s")
    assert first.material
    assert 0.65 < first.low < first.high < 0.95
    assert " from 0." in str(first)


def test_the_cause_is_told_before_the_reaction_to_it():
    voltage = Remainder("u", 0, "", "", 0.55, 0.62, 1.6, "V", "s", 2.1, recorded=True)
    speed = Remainder("v", 0, "", "", 0.62, 0.7, 0.1, "m/s", "s", 3.0, recorded=True)
    force = Remainder("force", 0, "", "", 0.62, 0.7, -36.6, "N", "s", 3.4)
    assert sort_remainders([speed, voltage]) == (voltage, speed)
    # The equations of motion say where it acts, whenever the controller answers.
    assert sort_remainders([force, speed, voltage]) == (force, speed, voltage)
    hidden = replace(force, surplus=0.9)
    assert sort_remainders([speed, voltage, hidden]) == (voltage, speed, hidden)


def test_of_too_few_rollouts_nothing_is_told(bench):
    push = rollouts(bench, {}, lambda t: t["q"] > 0.1)
    assert remainders(bench, LINES, push[: FEWEST - 1], {}) == ()


def test_without_equations_of_motion_a_push_shows_in_what_is_recorded(bare):
    left = remainders(bare, LINES, rollouts(bare, {}, lambda t: (t.times > 0.7) & (t.times < 0.9)), {})
    first = left[0]
    assert first.recorded
    assert first.material
    assert (first.quantity, first.along) == ("u", "")
    assert 0.65 < first.low < first.high < 0.95
    assert first.size == pytest.approx(-30.0 / 35.15, rel=0.1)
    size = f"{first.size:+.3g}".replace("-", "−")
    assert states(str(first), size, "V", "u", f"{first.low:.2g}", f"{first.high:.2g} s")


def test_of_a_machine_that_is_the_improved_simulator_nothing_recorded_is_different(bare):
    values = {"coulomb": {"force": 20.0}}
    machine = rollouts(bare, values)
    left = remainders(bare, LINES, machine, values)
    assert left
    assert not any(each.material for each in left)
    # But of one that is not improved, what an effect does is a difference: nobody asked the equations.
    assert remainders(bare, LINES, machine, {})[0].material


def test_what_no_effect_moves_is_no_part_of_the_machine(bare):
    machine = [
        (test, Trace(t.times, dict(t.channels) | {"q_ref": t["q_ref"] + 0.01}, t.units, t.meta))
        for test, t in rollouts(bare, {})
    ]
    assert not any(each.quantity == "q_ref" for each in remainders(bare, LINES, machine, {}))


def test_a_channel_that_is_not_recorded_or_recorded_more_seldom_hides_no_other(bare):
    push = rollouts(bare, {}, lambda t: (t.times > 0.7) & (t.times < 0.9))
    mute = [(test, trace.only(["u"])) for test, trace in push]
    assert remainders(bare, LINES, mute, {})[0].quantity == "u"
    seldom = [
        (test, Trace(t.times[::8], {n: x[::8] for n, x in t.channels.items()}, t.units, t.meta))
        for test, t in push
    ]
    first = remainders(bare, LINES, seldom, {})[0]
    assert first.material
    assert 0.65 < first.low < first.high < 0.95


def test_of_a_machine_that_is_recorded_seldom_as_little_is_read_of_the_simulator(bare):
    """A mean of the samples that are there is no mean of what was between them."""
    values = {"coulomb": {"force": 20.0}}
    seldom = [(test, thin(trace, 0.1)) for test, trace in rollouts(bare, values)]
    assert len(seldom[0][1]) == 26
    left = remainders(bare, LINES, seldom, values)
    assert left
    assert not any(each.material for each in left)


def test_recordings_without_what_a_residual_needs_have_no_part_in_it(bench):
    push = rollouts(bench, {}, lambda t: (t["q"] > 0.10) & (t["q"] < 0.125))
    mute = [(test, trace.only(["q"])) for test, trace in rollouts(bench, {})]
    assert all(each.recorded and each.quantity == "q" for each in remainders(bench, LINES, mute, {}))
    both = [each for each in remainders(bench, LINES, mute + push, {}) if not each.recorded]
    assert both[0].material
    assert both[0].along in ("q", "q_ref")


def test_a_fall_has_no_part_in_it(bench):
    push = rollouts(bench, {}, lambda t: t["q"] > 0.1)
    fell = [(test, Trace(t.times, t.channels, t.units, {"failure": "fall"})) for test, t in push]
    assert remainders(bench, LINES, fell, {}) == ()
    quiet = rollouts(bench, {})
    assert not any(each.material for each in remainders(bench, LINES, quiet + fell, {}))


def test_cells_are_as_many_as_their_means_and_lie_side_by_side(bench):
    runs = rollouts(bench, {})
    widths = {"q": 1, "v": 1, "u": 1, "residual.force": 1}
    paths = {key_of(test): path(widths, bench, trace, test) for test, trace in runs}
    assert all(rows.shape == (GRID, 4) for rows in paths.values())
    cells = Cells.of(bench.backend.duration, widths, paths)
    columns, trace = cells.columns(), bench.seen(runs[0][1], runs[0][0])
    means = cells.means(trace, runs[0][0])
    assert means.shape == (columns[-1].part.stop,) == (sum(len(column.cells) for column in columns),)
    [force] = [column for column in columns if column.residual]
    of_force = force.cells
    of_place = [cell for cell in of_force if cell.along == "q"]
    assert of_place[0].low == -np.inf
    assert of_place[-1].high == np.inf
    assert all(one.high == other.low for one, other in pairwise(of_place))
    # All samples of a rollout are in one cell along each channel: their mean is that of the cells.
    assert [cell.along for cell in of_force[:CELLS]] == [""] * CELLS
    of_time = means[force.part][:CELLS]
    assert np.nanmean(of_time) == pytest.approx(trace["residual.force"].mean(), abs=0.3)


class TwoMotors:
    """A backend of which one residual and one channel have named columns."""

    channels = (Channel("current", "A", "of the motors", 2, ("hip", "knee")), Channel("speed", "m/s", "", 2))

    def residuals(self, trace, params):
        parts = {"parts": {"torque": ["left", "right"]}}
        return replace(trace, channels={name: np.zeros((3, 2)) for name in ("torque", "force")}, meta=parts)


@pytest.mark.parametrize(
    ("quantity", "named"),
    [
        ("current", "knee"),
        ("speed", "column 1"),
        ("unknown", "column 1"),
        ("residual.torque", "right"),
        ("residual.force", "column 1"),
    ],
)
def test_a_column_of_many_is_told_by_the_part_it_is_of_or_by_its_number(bench, quantity, named):
    two = replace(bench, backend=TwoMotors())
    nominal = TESTS[0], Trace(np.arange(3.0), {}, {})
    column = CellColumn(quantity, 1, [], slice(0))
    assert label(two, nominal, column, 2) == named
    assert label(two, nominal, column, 1) == ""


def test_an_end_that_is_nowhere_is_said_so_and_is_no_number_in_json():
    beyond = Remainder("motor", 2, "", "tau", 10.0, np.inf, -3.2, "N*m", "N*m", 2.0)
    assert str(beyond) == "−3.2 N·m of motor where tau is above 10 N·m"
    narrow = Remainder("u", 0, "", "x", 1.9876, 1.9891, -3.2, "N", "m", 2.0)
    assert str(narrow) == "−3.2 N of u where x is between 1.9876 and 1.9891 m"
    rest = replace(narrow, low=1.3e-5, high=0.000106, times=(0.7, 0.9), extent=(0.0, 2.0))
    assert str(rest) == "−3.2 N of u from 0.7 to 0.9 s, where x is about 0 m"
    assert str(replace(beyond, low=-np.inf, high=-4.0)) == "−3.2 N·m of motor where tau is below −4 N·m"
    assert to_json(beyond)["high"] is None
    assert to_json(beyond)["low"] == 10.0


def test_of_a_channel_the_first_window_is_told_that_is_itself_more_than_what_is_allowed_for():
    assert begin(np.array([0.2, 1.6, 3.0, 2.0, 2.5]), 4).tolist() == [0.2, 1.6, 0.0, 0.0, 2.5]
    # One that is less hides no larger one, nor does one that is less than half as much.
    assert begin(np.array([0.2, 0.8, 1.5, 0.1])).tolist() == [0.2, 0.8, 1.5, 0.0]
    assert begin(np.array([0.2, 1.4, 3.0, 0.1])).tolist() == [0.2, 1.4, 3.0, 0.0]
