"""What a rollout counts as, by what ended its walk and by what of it was recorded."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from s2r_a1.backend import A1Backend
from s2r_a1.client import StateChange
from s2r_a1.rollout import ended_trace, lost_trace
from s2r_a1.schedule import Schedule
from s2r_a1.walk import Walked
from s2r_sim.controller.gains import RATE
from s2r_sim.robot.signals import VelocityCommand
from s2r_spec.trace import Trace

SCHEDULE = Schedule(VelocityCommand(0.2, 0.0, 0.0), 600, 100)
FALL = StateChange("DAMPING", "fall", "the base is tilted")
LINK = StateChange("DAMPING", "link", "no new state")


class Note(NamedTuple):
    tick: int


def counts(last, recorded=None, ending=None, **meta):
    """Return the meta of a test whose walk had this last tick, of which the recording has so many."""
    times = np.arange((last if recorded is None else recorded) + 1) / RATE
    trace = Trace(times, {"vx": np.zeros(len(times))}, {"vx": "m/s"}, meta)
    notes = tuple(Note(tick) for tick in range(-10, last + 1))
    return ended_trace(trace, Walked(notes, ending), SCHEDULE.hold, Path("0000-seed0.a1log")).meta  # type: ignore[arg-type]


def test_a_test_that_was_walked_and_recorded_to_its_end_is_an_outcome():
    assert not {"failure", "void"} & counts(100).keys()
    after = counts(100, ending=FALL)
    assert after["after"] == "fall"
    assert not {"failure", "void"} & after.keys()


def test_what_ended_a_test_early_says_what_it_counts_as():
    assert counts(40, ending=FALL)["failure"] == "fall"
    assert counts(40, ending=LINK)["void"] == "link"
    assert counts(40, ending=FALL, void="mocap", reason="no poses").keys() & {"failure", "void"} == {
        "failure"
    }


@pytest.mark.parametrize("ending", [None, FALL])
def test_a_test_of_which_the_controller_missed_too_much_is_void(ending):
    """5 of 105 ticks are allowed; a fall of a robot whose computer was late is none of the robot."""
    assert "void" not in counts(100, late=5)
    missed = counts(40 if ending else 100, ending=ending, late=6)
    assert missed["void"] == "client"
    assert "failure" not in missed
    assert "missed 6 of" in missed["reason"]


@pytest.mark.parametrize("ending", [None, FALL])
def test_a_test_that_was_walked_to_its_end_and_not_recorded_so_far_is_void(ending):
    """Else the rest of its trace would be judged as if the specification had looked at all of it."""
    assert counts(100, recorded=40, ending=ending)["void"] == "disk"


def test_why_motion_capture_made_a_test_void_is_kept_whatever_came_after_it():
    meta = counts(100, ending=LINK, void="mocap", reason="no poses")
    assert (meta["void"], meta["reason"], meta["after"]) == ("mocap", "no poses", "link")


def test_a_fall_counts_without_its_recording_and_another_walk_is_void():
    backend = A1Backend("host=127.0.0.1,velocity=onboard")
    nothing = lost_trace(backend.channels, {"params": {"vd": 0.2}}, "the disk was full")
    assert set(nothing.channels) == {channel.name for channel in backend.channels}
    for last, ending, counted in ((40, FALL, ("failure", "fall")), (100, None, ("void", "disk"))):
        walked = Walked(tuple(Note(tick) for tick in range(last + 1)), ending)  # type: ignore[arg-type]
        meta = ended_trace(nothing, walked, SCHEDULE.hold, Path("0000-seed0.a1log")).meta
        assert meta.get(counted[0]) == counted[1]
        assert len({"failure", "void"} & meta.keys()) == 1
