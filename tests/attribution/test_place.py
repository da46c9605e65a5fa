"""Places in words: rounded as people read them, time first, and the cause's place before the reaction to it."""

import math

import numpy as np
import pytest

from s2r_spec.attribution.place import Place, ValueRange, cause_first, find_visit, instant
from s2r_spec.trace import Trace


@pytest.mark.parametrize(
    ("begin", "end", "words"),
    [
        (0.5, 0.6, "from 0.5 to 0.6 s"),
        (0.375, 0.4375, "from 0.38 to 0.44 s"),  # two of 32 windows of a second
        (4 / 3, 8 / 3, "from 1.3 to 2.7 s"),
        (0.25, 0.75, "from 0.25 to 0.75 s"),
        (120.5, 240.0, "from 120 to 240 s"),
        (0.0004, 0.002, "from 0.4 to 2 ms"),
    ],
)
def test_a_window_of_time_is_rounded_to_its_width(begin, end, words):
    assert str(Place(ValueRange(begin, end))) == words


def test_an_instant_has_three_digits_and_is_never_off_by_more_than_a_hundredth_of_a_second():
    assert [instant(t) for t in (0.7982, 1.8612, 123.456, 0.0)] == [
        "at 0.798 s",
        "at 1.86 s",
        "at 123.46 s",
        "at 0 s",
    ]


def test_a_whole_rollout_is_no_window():
    assert str(Place(ValueRange(0.0, 10.0, lowest=0.0, highest=10.0))) == "throughout"
    mostly = ValueRange(0.03, 9.98, lowest=0.0, highest=10.0)
    push = ValueRange(10.0, math.inf, "N*m", "tau")
    assert str(Place(mostly, values=(push,))) == "where tau is above 10 N·m"
    assert str(Place(mostly, "FR calf")) == "throughout at FR calf"


def test_time_comes_first_then_the_joint_then_values():
    at_rest = ValueRange(1.3e-5, 0.000106, "m/s", "v", lowest=-0.1, highest=0.5)
    late = ValueRange(2.1, 2.5, lowest=0.0, highest=3.0)
    assert (
        str(Place(late, "FR calf", values=(at_rest,)))
        == "from 2.1 to 2.5 s at FR calf, where v is about 0 m/s"
    )


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (0.1, 0.12, "q is between 0.1 and 0.12 m"),
        (-math.inf, -0.2, "q is below −0.2 m"),
        (-0.5, -0.2, "q is below −0.2 m"),  # nothing lies below
        (0.3, 1.0, "q is above 0.3 m"),
        (0.112, 0.114, "q is about 0.11 m"),
        (-math.inf, -0.4999, "q is about −0.5 m"),
        (0.3, 0.3, "q is 0.3 m"),
        (-1.0, 1.0, ""),
    ],
)
def test_values_of_a_channel_are_rounded_to_their_width_and_to_its_extent(low, high, words):
    assert ValueRange(low, high, "m", "q", lowest=-0.5, highest=0.5).in_values() == words


def test_without_an_extent_small_values_have_a_prefix():
    assert ValueRange(1.3e-5, 0.000106, "m/s", "v").in_values() == "v is between 10 and 110 µm/s"
    assert ValueRange(-math.inf, 1234.5, "N", "f").in_values() == "f is below 1230 N"


def test_a_window_of_the_test_space():
    box = (ValueRange(0.2, 0.4, "m/s", "vd", 0.0, 1.0), ValueRange(3.0, 5.0, "deg", "slope", -5.0, 5.0))
    assert str(Place(values=box)) == "where vd is between 0.2 and 0.4 m/s and slope is above 3 deg"
    assert str(Place(values=(box[0], ValueRange(0.0, 5.0, "kg", "load", 0.0, 5.0)))).endswith("0.4 m/s")


def ordered(*found):
    """Return the names of (name, begin, end, strength) in order."""
    places = [Place(ValueRange(begin, end)) if end else Place() for _, begin, end, _ in found]
    order = cause_first(range(len(found)), lambda n: places[n], lambda n: found[n][-1])
    return [found[n][0] for n in order]


def test_the_cause_comes_before_a_larger_reaction_to_it():
    found = ordered(("voltage", 0.8, 0.9, 9.0), ("force", 0.7, 0.8, 6.0), ("speed", 1.0, 1.1, 7.0))
    assert found == ["force", "voltage", "speed"]


def test_a_long_window_that_begins_a_little_earlier_is_not_surely_the_cause():
    assert ordered(("push", 0.797, 0.844, 9.0), ("hip", 0.75, 1.5, 6.0)) == ["push", "hip"]
    assert ordered(("push", 0.797, 0.844, 9.0), ("friction", 0.0, 1.5, 6.0)) == ["friction", "push"]


def test_what_is_small_explains_nothing_that_comes_later():
    found = ordered(("noise", 0.1, 0.2, 1.1), ("force", 0.7, 0.8, 6.0), ("voltage", 0.8, 0.9, 9.0))
    assert found == ["force", "voltage", "noise"]


def test_a_place_without_a_time_goes_by_strength_and_so_do_equal_times():
    found = ordered(("late", 0.9, 1.0, 7.0), ("always", 0, None, 6.0), ("early", 0.7, 0.8, 5.0))
    assert found == ["always", "early", "late"]
    assert ordered(("weak", 0.7, 0.7, 5.0), ("strong", 0.7, 0.7, 6.0)) == ["strong", "weak"]
    assert ordered(("a", 0.3, 0.4, 0.0), ("b", 0.1, 0.2, 0.0)) == ["a", "b"]


def test_when_a_channel_has_these_values():
    times = np.arange(11) / 10
    pushed = Trace(times + 5.0, {"q": np.column_stack([np.zeros(11), times])}, {"q": "m"})
    slower = Trace(times, {"q": np.column_stack([np.zeros(11), times / 2])}, {"q": "m"})
    unrecorded = Trace(times, {"u": times}, {})
    time, values = find_visit([pushed, slower, unrecorded], "q", 1, 0.12, 0.42)
    assert (time.low, time.high, time.highest) == pytest.approx((0.2, 0.8, 1.0))
    assert (
        find_visit([pushed, slower], "q", 1, 0.32, 0.48)[0] is None
    )  # the first is past when the second comes
    assert (values.unit, values.lowest, values.highest) == ("m", 0.0, 1.0)
    assert find_visit([pushed], "q", 1, 3.0, 4.0)[0] is None
    gone, unknown = find_visit([pushed], "force", 0, 3.0, 4.0)
    assert gone is None
    assert not math.isfinite(unknown.extent)
