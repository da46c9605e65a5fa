"""A trace of any machine as poses of a robot file: what it logs is shown, and what it lacks is said."""

import numpy as np
import pytest

from s2r_mujoco.pictures import positions_of
from s2r_spec.backend import HasTracePictures
from s2r_spec.errors import UsageError
from s2r_spec.trace import Trace
from tests.mujoco.robots import SPIN, robot

TIMES = [0.0, 0.1, 0.2]
FILE = 'root = "trunk"\nobservation = ["joint_pos_rel"]\nduration = 0.3\ndecimation = 4\n' + SPIN


@pytest.fixture
def box(tmp_path):
    return robot(tmp_path, FILE, width=4)


@pytest.fixture
def trace(box):
    return box.rollout({}, 3)


def only(trace, *names):
    return Trace(
        trace.times,
        {name: trace[name] for name in names},
        {n: trace.units[n] for n in names if n in trace.units},
    )


def posed(box, trace, beside):
    return positions_of(box._robot, trace, TIMES, beside)


def test_a_simulated_trace_has_the_poses_of_its_rollout(box, trace):
    positions, missing = posed(box, trace, trace)
    rows = [int(np.argmin(np.abs(trace.times - at))) for at in TIMES]
    assert missing == ()
    assert positions[:, 7:] == pytest.approx(trace["q"][rows])
    assert positions[:, 3:7] == pytest.approx(trace["quaternion"][rows])
    assert positions[:, :3] == pytest.approx(np.column_stack([trace[name][rows] for name in "xyz"]))


@pytest.mark.parametrize("names", [("roll", "pitch", "yaw"), ("roll", "pitch"), ("gravity",)])
def test_an_attitude_is_read_from_whatever_says_it(box, trace, names):
    log = only(trace, "q", "height", "x", "y", *names)
    positions, missing = posed(box, log, trace)
    whole, _ = posed(box, trace, trace)
    # Both agree in the direction of gravity; a heading that is not logged is straight ahead.
    assert down(positions) == pytest.approx(down(whole), abs=1e-6)
    assert any("heading" in one for one in missing) == ("yaw" not in names)


def down(positions):
    w, x, y, z = positions[:, 3:7].T
    return np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])


def test_what_is_not_logged_is_drawn_as_in_the_simulation_and_said(box, trace):
    other = box.rollout({}, 4)
    positions, missing = posed(box, only(trace, "q"), other)
    beside, _ = posed(box, other, other)
    assert positions[:, :7] == pytest.approx(beside[:, :7])
    assert positions[:, 7:] != pytest.approx(beside[:, 7:])
    assert [word in " ".join(missing) for word in ("attitude", "height", "place", "joint")] == [True] * 3 + [
        False
    ]


def test_images_have_one_of_each_time(box, trace):
    assert isinstance(box, HasTracePictures)
    try:
        drawn = box.draw_trace(trace, {}, TIMES, trace)
    except UsageError as error:
        pytest.skip(str(error))
    assert drawn.images.shape[0] == len(TIMES)
    assert drawn.images.dtype == np.uint8
    assert (drawn.images[0] != drawn.images[2]).any()
