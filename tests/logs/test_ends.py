"""What a log does not show: the end of a topic, a late component, values between samples, the end of an episode."""

import warnings

import numpy as np
import pytest
import scipy.io

import s2r_spec as s2r
from s2r_spec import logs
from s2r_spec.errors import TraceError, TraceNote, UndecidedError
from s2r_spec.logs.interpret import at_clock
from s2r_spec.logs.table import Column
from s2r_spec.logs.topics.join import Joining
from s2r_spec.logs.topics.order import sort_messages
from s2r_spec.logs.topics.topic import Topic
from s2r_spec.recordings.episodes import find_episodes
from s2r_spec.recordings.log_folder import digest
from s2r_spec.recordings.recorded import LogBackend
from s2r_spec.spec.monitored import Conventions, monitor_requirement
from s2r_spec.trace import Trace
from s2r_spec.trace.messages import Messages, join

FAR = s2r.parse_spec("signal d {m}\nrequire far: always (d > 0.3 {m})")
BOTH = s2r.parse_spec("signal d[2] {m}\nrequire far: always (d[0] > 0.3 {m} and d[1] > 0.3 {m})")


def verdict(spec: s2r.Spec, trace: Trace) -> bool | None:
    (requirement,) = spec.requirements
    return monitor_requirement(spec, trace, requirement, {}, Conventions()).satisfied


def every(period: float, start: float, stop: float, value: float = 1.2, **more: float) -> Messages:
    times = np.arange(round(start / period), round(stop / period)) * period
    return Messages.of(times, np.full(times.size, value), **more)


def test_one_topic_that_ends_before_its_log_is_silent():
    alive = Trace.of_messages({"d": every(0.1, 0, 20, log_end=20.2)}, {"d": "m"})
    dead = Trace.of_messages({"d": every(0.1, 0, 5, log_end=20.0)}, {"d": "m"})
    assert verdict(FAR, alive) is True
    assert verdict(FAR, dead) is None
    with pytest.raises(UndecidedError):
        FAR.satisfied(dead, {})


@pytest.mark.parametrize("silent", [[(0.0, 5.0)], [(0.0, 5.0), (15.0, 20.0)]], ids=["dead", "gap"])
def test_a_vector_is_silent_where_a_component_of_it_is(silent):
    parts = [every(0.1, start, stop) for start, stop in silent]
    right = Messages.of(
        np.concatenate([one.times for one in parts]), np.concatenate([one.values for one in parts])
    )
    vector = join([every(0.1, 0, 20), right])
    assert verdict(BOTH, Trace.of_messages({"d": vector}, {"d": "m"})) is None
    whole = join([every(0.1, 0, 20), every(0.1, 0.0, 20)])
    assert verdict(BOTH, Trace.of_messages({"d": whole}, {"d": "m"})) is True


def test_each_value_with_one_stamp_counts_in_a_vector():
    right = every(0.1, 0, 20)
    times = np.insert(right.times, 50, right.times[50])
    values = np.insert(right.values, 51, 0.1)
    values[50], values[51] = 0.1, 1.2
    vector = join([every(0.1, 0, 20), Messages.of(times, values)])
    assert verdict(BOTH, Trace.of_messages({"d": vector}, {"d": "m"})) is False


def test_a_row_with_one_empty_cell_of_a_vector_keeps_the_other(tmp_path):
    rows = [f"{k / 10},{0.1 if k == 100 else 1.2},{'' if k == 100 else 1.2}" for k in range(200)]
    path = tmp_path / "v.csv"
    path.write_text("\n".join(["t,d[0] [m],d[1] [m]", *rows]) + "\n")
    loaded = logs.load(path, {}, {"d": 2}, joining=Joining(None, "hold"))
    assert verdict(BOTH, loaded.trace) is False
    assert loaded.accounts["d"].samples == 200


def test_functions_of_a_value_sent_on_change_are_those_of_a_held_value():
    times = np.array([0.0, 1.2, 1.5, 3.0, 6.0, 7.7, 7.9, 10.0, 10.3, 14.0])
    stop = np.array([0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0])
    spec = s2r.parse_spec("signal stop bool\nrequire r: always (duration(stop) <= 1 {s})")
    assert verdict(spec, Trace(times, {"stop": stop})) is None


def test_recordings_of_values_sent_on_change_are_no_certificate_where_every_instant_decides_otherwise(
    tmp_path,
):
    spec = s2r.parse_spec(
        "param vd {m/s} in [0.2, 0.8]\nsignal stop bool\nrequire r: always (duration(stop) <= 1 {s})"
    )
    (tmp_path / "rollouts.csv").write_text("id,vd\na,0.5\n")
    rows = ["0,0", "1.2,1", "1.5,0", "3,1", "6,0", "7.7,1", "7.9,0", "10,1", "10.3,0", "14,0"]
    (tmp_path / "a.csv").write_text("\n".join(["t,stop", *rows]) + "\n")
    ((_, trace),) = LogBackend(str(tmp_path)).recorded()
    with pytest.raises(UndecidedError):
        spec.robustness(trace, {"vd": 0.5})


def test_no_sample_after_the_end_of_an_episode_is_in_it():
    times = np.array([0.0, 3.7, 6.0, 7.0])
    assert find_episodes(times, np.array([False, True, True, True]), 3.0).ranges == ((1, 3),)
    grid = np.arange(20) * 0.3
    ((first, stop),) = find_episodes(grid, grid >= 0.29, 1.1).ranges
    assert grid[stop - 1] - grid[first] <= 1.1


def test_an_episode_at_the_end_of_a_log_with_dates_is_complete_or_left_out():
    times = 1718000000.0 + np.arange(500) * 0.02
    assert not find_episodes(times, times >= times[0] + 8.5, 3.0, until=float(times[-1])).ranges
    assert len(find_episodes(times, times >= times[0] + 6.5, 3.0, until=float(times[-1])).ranges) == 1


def test_a_signal_at_the_begin_within_a_silence_is_not_known():
    spec = s2r.parse_spec(
        "signal x {m}\nsignal y {m}\nrequire r: always[4 s, 5 s] (abs(x - init(x)) <= 0.5 {m} and y < 9 {m})"
    )
    x = [every(0.1, 0, 5), every(0.1, 10, 20)]
    gap = Messages.of(np.concatenate([one.times for one in x]), np.concatenate([one.values for one in x]))
    trace = Trace.of_messages({"x": gap, "y": every(0.02, 0, 20)}, {"x": "m", "y": "m"})
    assert verdict(spec, trace.between(7.0, 19.0)) is None
    assert verdict(spec, trace.between(11.0, 19.0)) is True


def test_states_that_are_stored_as_floats_are_held_when_topics_are_interpolated(tmp_path):
    times = np.arange(100) * 0.1
    path = tmp_path / "states.mat"
    scipy.io.savemat(
        path,
        {
            "mode": {"t": times, "x": np.where(times < 5.0, 2.0, 4.0)},
            "odom": {"t": times + 0.03, "x": np.sin(times)},
        },
    )
    columns = {"mode": "mode.x", "v": "odom.x"}
    wanted = {"mode": None, "v": None}
    loaded = logs.load(path, columns, wanted, joining=Joining(None, "linear"))
    spec = s2r.parse_spec("signal mode\nsignal v\nrequire r: eventually (v > -2 and mode == 3)")
    assert verdict(spec, loaded.trace) is False


def test_a_trace_that_is_resampled_says_where_it_was_silent():
    dead = Trace.of_messages({"d": every(0.1, 0, 5, log_end=20.0)}, {"d": "m"})
    with pytest.warns(TraceNote, match="no message"):
        dead.resample(0.05)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Trace(np.arange(100) * 0.1, {"d": np.ones(100)}).resample(0.05)


def test_a_component_that_begins_much_later_is_refused(tmp_path):
    path = tmp_path / "two.mat"
    times = np.arange(200) * 0.1
    left, right = {"t": times, "x": np.ones(200)}, {"t": times[50:], "x": np.ones(150)}
    scipy.io.savemat(path, {"left": left, "right": right})
    with pytest.raises(TraceError, match="50 messages"):
        logs.load(path, {"d[0]": "left.x", "d[1]": "right.x"}, {"d": 2})


@pytest.mark.parametrize("like", ["s2r", "rtamt", "breach"])
def test_samples_of_a_sensor_that_died_decide_nothing(like):
    spec = s2r.parse_spec("signal d {m}\nsignal v {m/s}\nrequire r: always (d > 0.3 {m} or v > 2 {m/s})")
    channels = {"d": every(0.1, 0, 5), "v": every(0.02, 0, 20)}
    messages = Trace.of_messages(channels, {"d": "m", "v": "m/s"})
    clocked = at_clock(messages, channels["v"].times)
    for trace in (clocked, messages) if like != "rtamt" else (clocked,):
        assert monitor_requirement(spec, trace, "r", {}, Conventions(like=like)).satisfied is None


PRESS = s2r.parse_spec(
    "signal v {m/s}\nsignal stop bool\nrequire r: always (rise(stop) -> eventually[0, 0.5 {s}] (v < 0.1 {m/s}))"
)


@pytest.mark.parametrize(
    ("first", "speed", "expected"), [(True, 0.3, None), (True, 0.05, True), (False, 0.3, True)]
)
def test_a_press_that_is_the_first_message_of_its_topic_may_be_one(first, speed, expected):
    """Nobody sent whether it was pressed before."""
    stop = Messages.of(np.array([5.0, 9.0]), np.array([float(first), 0.0]), log_end=10.0)
    trace = Trace.of_messages({"v": every(0.01, 0, 10, speed), "stop": stop}, {"v": "m/s"})
    assert verdict(PRESS, trace) is expected


@pytest.mark.parametrize("like", ["s2r", "rtamt-dense", "moonlight", "breach", "stlrom"])
def test_a_gap_of_a_table_decides_nothing_by_the_conventions_of_any_tool(like):
    times = np.concatenate((np.arange(400), np.arange(600, 1000))) / 100
    trace = Trace(times, {"d": np.full(times.size, 0.4)}, {"d": "m"})
    spec = s2r.parse_spec("signal d {m}\nrequire far: always[0, 9 {s}] (d > 0.3 {m})")
    assert monitor_requirement(spec, trace, "far", {}, Conventions(like=like)).satisfied is None


@pytest.mark.parametrize("seen", [False, True], ids=["values stand, too", "values change"])
def test_a_header_that_stands_still_is_refused_with_its_time(seen):
    stamps = np.arange(500) / 50
    stamps[200:230] = stamps[200]
    values = np.zeros(500)
    values[205:225] = 0.9 * seen
    topic = Topic("/odom", (stamps * 1e9).astype("m8[ns]"), {"x": Column(values)}, age=0.0)
    with pytest.raises(TraceError, match=r"201.*4 s.*received"):
        sort_messages(topic, sortable=True)


def test_a_header_that_a_sender_repeats_is_no_clock_that_stands_still():
    stamps = np.repeat(np.arange(50) / 10, 10)
    topic = Topic("/odom", (stamps * 1e9).astype("m8[ns]"), {"x": Column(stamps)}, age=0.0)
    assert (sort_messages(topic, sortable=True).merged, len(sort_messages(topic, sortable=True).topic)) == (
        450,
        50,
    )


def test_an_angle_at_the_stamps_of_a_clock_lies_on_the_circle():
    times = np.arange(200) / 10
    yaw = np.mod(times, 2 * np.pi)
    messages = {"yaw": Messages.of(times, yaw, linear=True), "v": Messages.of(times + 0.05, times)}
    trace = at_clock(Trace.of_messages(messages, {"yaw": "rad", "v": "m/s"}), messages["v"].times[:-1])
    spec = s2r.parse_spec(
        "signal yaw {rad}\nsignal v {m/s}\nrequire r: always (yaw < 1 or yaw > 6 or v > 6 {m/s})"
    )
    found = spec.robustness_signal(trace, "r")
    assert found.size == 199
    low = s2r.parse_spec("signal yaw {rad}\nrequire r: yaw < 3").robustness_signal(trace, "r")
    np.testing.assert_allclose(3 - low, np.mod(trace.times, 2 * np.pi), atol=1e-9)


def test_two_episodes_with_the_same_values_at_a_clock_are_no_copies():
    clock = np.arange(20) / 10
    traces = []
    for press in (0.42, 0.47):
        stop = Messages.of(np.array([0.0, press, press + 0.01]), np.array([0.0, 1.0, 0.0]))
        messages = {"d": Messages.of(clock, np.ones(20)), "stop": stop}
        traces.append(at_clock(Trace.of_messages(messages, {"d": "m"}), clock))
    assert digest(traces[0]) != digest(traces[1])


@pytest.mark.parametrize("kind", ["npz", "csv", "parquet", "pandas"])
def test_a_trace_at_the_stamps_of_a_clock_keeps_its_messages_in_files(kind, tmp_path):
    clock = np.arange(60) / 10
    hit = Messages.of(np.array([0.0, 2.43, 2.47, 5.9]), np.array([0.0, 1.0, 0.0, 0.0]))
    trace = at_clock(Trace.of_messages({"x": Messages.of(clock, np.full(60, 0.5)), "hit": hit}), clock)
    if kind == "pandas":
        again = Trace.from_dataframe(trace.to_dataframe())
    else:
        s2r.write_trace(trace, tmp_path / f"k.{kind}")
        again = s2r.read_trace(tmp_path / f"k.{kind}")
    spec = s2r.parse_spec("signal x\nsignal hit bool\nrequire r: always not hit and always x <= 1")
    assert again.times.tolist() == trace.times.tolist()
    assert (verdict(spec, trace), verdict(spec, again)) == (None, None)


FORCE = "signal f {N}\nsignal v\n"


@pytest.mark.parametrize(
    ("requirement", "rho"),
    [
        ("if(f > 5 {N}, duration(f > 5 {N}), 0 {s}) <= 0.3 {s}", -0.5),
        ("f * duration(f > 5 {N}) <= 10 {N s}", -6.0),
        ("duration(f > 5 {N}) / (f + 1 {N}) <= 1 {s/N}", 1 - 0.8 / 21),
        ("integral(f) * 2 <= 30 {N s}", -2.0),
        ("mean(f, 10 {s}) <= 10 {N}", 10 - 16 / 1.3),
    ],
)
def test_functions_of_integrals_are_exact_between_messages(requirement, rho):
    times, force = np.array([0.0, 0.5, 1.3, 2.2]), np.array([0.0, 20.0, 0.0, 0.0])
    messages = {"f": Messages.of(times, force), "v": Messages.of(np.array([0.0, 2.2]), np.zeros(2))}
    trace = Trace.of_messages(messages, {"f": "N"})
    spec = s2r.parse_spec(f"{FORCE}require r: always ({requirement}) and always v <= 1")
    found = spec.judge(trace, "r")[0]
    assert found.lower == pytest.approx(min(rho, 1.0), abs=1e-5)
    assert found.satisfied is (rho > 0)


def test_a_mean_between_two_messages_lies_on_its_hyperbola():
    """At 2 s, half of the time since the begin had the value 10."""
    messages = {"f": Messages.of(np.array([0.0, 1.0, 3.0, 4.0]), np.array([0.0, 10.0, 10.0, 10.0]))}
    messages["v"] = Messages.of(np.array([0.0, 4.0]), np.zeros(2))
    spec = s2r.parse_spec(f"{FORCE}require r: always[2, 2] mean(f) <= 4 {{N}} and v <= 1")
    assert spec.judge(Trace.of_messages(messages, {"f": "N"}), "r")[0].lower == pytest.approx(-1.0, abs=1e-6)


@pytest.mark.parametrize("value", ["sqrt(integral(f))", "integral(f)^2", "1 / (1 {s} + duration(f > 5 {N}))"])
def test_a_value_that_is_no_straight_line_between_messages_is_refused(value):
    messages = {
        "f": Messages.of(np.arange(4.0), np.full(4, 9.0)),
        "v": Messages.of(np.array([0.0, 2.2]), np.zeros(2)),
    }
    spec = s2r.parse_spec(f"{FORCE}require r: always ({value} == {value}) and always v <= 1")
    with pytest.raises(TraceError, match="straight line"):
        spec.judge(Trace.of_messages(messages, {"f": "N"}), "r")


@pytest.mark.parametrize(
    "counted", ["count(x > 1) <= 3", "x > 1 -> next x < 3", "count(x > 1 and not hit) <= 3"]
)
def test_a_press_between_the_stamps_of_a_clock_is_no_holds_beside_counted_samples(counted):
    clock = np.arange(60) / 10
    for press, expected in ((2.43, None), (2.4, False)):
        hit = Messages.of(np.array([0.0, press, press + 0.04, 5.9]), np.array([0.0, 1.0, 0.0, 0.0]))
        trace = at_clock(Trace.of_messages({"x": Messages.of(clock, np.full(60, 0.5)), "hit": hit}), clock)
        spec = s2r.parse_spec(
            f"signal x\nsignal hit bool\nrequire r: always (not hit) and always ({counted})"
        )
        assert verdict(spec, trace) is expected
        if expected is None:
            with pytest.raises(UndecidedError):
                spec.robustness(trace)


def test_a_wheel_of_many_turns_is_linear_between_its_messages():
    times = np.arange(60) / 10
    messages = {
        "a": Messages.of(times, -(600.25 + 60 * times), linear=True),
        "y": Messages.of(times + 0.03, times),
    }
    spec = s2r.parse_spec("signal a {rad}\nsignal y\nrequire r: always (a <= -500 {rad} or y > 99)")
    assert verdict(spec, Trace.of_messages(messages, {"a": "rad"})) is True
