"""Requirements on signals with messages of their own: every instant, silences, several values, begin and end."""

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec import Trace, parse_spec
from s2r_spec.errors import SamplingError, TraceError, UndecidedError, UsageError
from s2r_spec.logs.interpret import at_clock
from s2r_spec.spec.monitored import Conventions, monitor_requirement
from s2r_spec.trace.messages import Messages


def sent(*pairs, **options):
    times, values = np.array(pairs, dtype=float).T
    return Messages.of(times.copy(), values.copy(), **options)


def every(period, until, value=0.0, start=0.0, **options):
    times = np.arange(start, until, period)
    values = value(times) if callable(value) else np.full(times.size, float(value))
    return Messages.of(times, values, **options)


FAST = every(0.02, 10.0, 0.5)
PRESS = sent((0.0, 0), (4.003, 1), (4.012, 0))


def judged(text, signals="signal v {m/s}\nsignal hit bool", **channels):
    spec = parse_spec(f"{signals}\nrequire r: {text}")
    return spec.judge(Trace.of_messages(channels), "r")


@pytest.mark.parametrize(
    ("text", "rho"),
    [
        ("always (not hit or v < 0.1)", -0.4),
        ("eventually (hit and v > 0.3)", 0.2),
        ("always (rise(hit) -> eventually[0, 1 s] v < 0.3)", -0.2),
        ("always (hit -> eventually[0, 0.02 s] (v > 0.6))", -0.1),
        ("always (if(hit, 2, 1) * v <= 1.2)", 0.2),
        ("always (duration(hit) <= 0.02 {s} or v < 0)", 0.011),
        ("always (duration(hit) <= 0.005 {s} or v < 0)", -0.004),
        ("integral(if(hit, v, 0 {m/s}), 5 {s}) <= 1 {m} and always v < 1", 0.5),
        ("always[4.5 s, 5 s] (integral(if(hit, v, 0 {m/s})) <= 0.0045 {m})", 0.0),
        ("always ((count(hit, 1 {s}) <= 0.5) or v < 0.1)", -0.4),
        ("always (hit or once[0, 5 s] (not hit and v > 0.2))", 0.3),
    ],
)
def test_a_press_between_two_messages_decides(text, rho):
    found, reason = judged(text, v=FAST, hit=PRESS)
    assert found.lower == pytest.approx(rho, abs=1e-9)
    assert found.satisfied is (rho >= 0)
    assert reason is not None


def test_the_answer_names_the_message_that_decides():
    found, reason = judged("always (not hit or v < 0.1)", v=FAST, hit=PRESS)
    assert reason.instant == pytest.approx(4.003)
    assert reason.predicate == "v < 0.1"
    assert reason.rho == found.lower
    assert reason.responsible[0] == pytest.approx((4.003, 4.012))


def test_instants_are_accounted_for():
    found, _ = judged("always (not hit or v < 1)", v=FAST, hit=PRESS)
    for name, own in (("v", 500), ("hit", 3)):
        one = found.instants[name]
        assert one.own == own
        assert one.own + one.held + one.interpolated + one.missing == 502


@pytest.mark.parametrize(
    ("text", "satisfied"),
    [
        ("always (v < 1 and w < 1)", None),
        ("always (v < 0.4 and w < 1)", False),
        ("eventually[0, 2 s] (v > 0.4 and w < 1)", True),
        ("always[0, 2 s] (v < 1 and w < 1)", True),
        ("always[0, 4 s] (v < 1 and w < 1)", None),
    ],
)
def test_a_silence_decides_nothing(text, satisfied):
    times = np.arange(0, 10, 0.1)
    times = times[(times < 3.05) | (times > 5)]
    silent = Messages.of(times, np.zeros(times.size))
    signals = "signal v {m/s}\nsignal w {m/s}"
    found, _ = judged(text, signals, v=FAST, w=silent)
    assert found.satisfied is satisfied
    assert any("w" in note and "3.1 s" in note for note in found.notes)
    spec = parse_spec(f"{signals}\nrequire r: {text}")
    trace = Trace.of_messages({"v": FAST, "w": silent})
    if satisfied:
        assert spec.robustness(trace)["r"] > 0
    elif satisfied is None:
        with pytest.raises(UndecidedError):
            spec.robustness(trace)


def test_a_signal_that_ends_early_is_silent_and_one_sent_on_change_is_not():
    signals = "signal v {m/s}\nsignal w {m/s}"
    ends = every(0.1, 6.0)
    assert judged("always (v < 1 and w < 1)", signals, v=FAST, w=ends)[0].satisfied is None
    changes = sent((0.0, 0), (0.3, 0.5), (6.0, 0))
    assert judged("always (v < 1 and w < 1)", signals, v=FAST, w=changes)[0].satisfied is True


@pytest.mark.parametrize(
    ("stamp", "value", "satisfied"), [(0.05, 5.0, None), (9.99, 5.0, False), (5.0, 0.5, True)]
)
def test_messages_before_the_begin_and_after_the_end_are_not_ignored(stamp, value, satisfied):
    times, values = FAST.times, FAST.values.copy()
    values[np.argmin(np.abs(times - stamp))] = value
    late = every(0.1, 9.85, start=0.5)
    signals = "signal v {m/s}\nsignal w {m/s}"
    found, _ = judged("always (v < 1 and w < 1)", signals, v=Messages.of(times, values), w=late)
    assert found.satisfied is satisfied or (stamp > 9 and found.satisfied is None)
    assert found.unevaluated["v"][0] == 25


def test_of_two_values_with_one_stamp_the_worse_decides():
    twice = Messages.of(np.array([0.0, 1.0, 1.0, 2.0]), np.array([0.0, 3.0, 0.0, 0.0]))
    for text, satisfied in (("always v < 1", False), ("eventually v > 2", False), ("always v < 4", True)):
        assert judged(text, "signal v {m/s}", v=twice)[0].satisfied is satisfied


def test_a_requirement_sees_its_own_signals_only():
    spec = parse_spec(
        "signal v {m/s}\nsignal w {m/s}\nrequire fast: always v < 1\nrequire slow: always w < 1"
    )
    late = every(0.1, 10.0, start=5.0)
    spiky = FAST.values.copy()
    spiky[100] = 2.0
    found = spec.robustness(Trace.of_messages({"v": Messages.of(FAST.times, spiky), "w": late}))
    assert found == {"fast": -1.0, "slow": 1.0}


def test_functions_of_the_past_need_the_messages_of_one_topic():
    signals = "signal v {m/s}\nsignal w {m/s}"
    ramp = every(0.1, 10.0, lambda t: 0.5 * t)
    found, _ = judged("always (abs(deriv(w)) <= 1 {m/s^2} or v < 0)", signals, v=FAST, w=ramp)
    assert found.lower == pytest.approx(0.5, abs=1e-9)
    with pytest.raises(TraceError, match="v"):
        judged("always (abs(deriv(v * w)) <= 1)", signals.replace(" {m/s}", ""), v=FAST, w=ramp)


def test_next_asks_for_samples():
    trace = Trace.of_messages({"v": FAST, "hit": PRESS})
    spec = parse_spec("signal v {m/s}\nsignal hit bool\nrequire r: always (hit -> next v < 1)")
    with pytest.raises(UsageError, match="next"):
        spec.judge(trace, "r")
    with pytest.raises(UsageError, match="clock"):
        spec.evaluate(trace, "r", **s2r.profile("rtamt"))
    assert spec.evaluate(trace.resample(0.02), "r").satisfied


def test_samples_of_a_clock_that_miss_a_message_leave_the_verdict_open():
    trace = at_clock(Trace.of_messages({"v": FAST, "hit": PRESS}), FAST.times)
    spec = parse_spec("signal v {m/s}\nsignal hit bool\nrequire r: always (not hit or v < 0.1)")
    assert monitor_requirement(spec, trace, "r", {}, Conventions()).satisfied is None
    with pytest.raises(UndecidedError):
        spec.robustness(trace)
    same = parse_spec("signal v {m/s}\nsignal hit bool\nrequire r: always (not hit or v < 1)")
    assert monitor_requirement(same, trace, "r", {}, Conventions()).satisfied is True


def test_an_angle_is_interpolated_on_the_circle():
    yaw = sent((0, 3.0), (1, -3.0), (2, -2.9), linear=True)
    signals = "signal v {m/s}\nsignal yaw {rad}"
    assert judged("always (abs(yaw) >= 2.5 or v < 0)", signals, v=FAST, yaw=yaw)[0].lower == pytest.approx(
        0.4
    )
    reached, _ = judged("eventually (yaw >= 3.14 and v > 0)", signals, v=FAST, yaw=yaw)
    assert reached.lower == pytest.approx(np.pi - 3.14, abs=1e-9)


def test_a_window_below_every_period_is_refused_as_times_in_a_wrong_unit():
    signals = "signal v {m/s}\nsignal w {m/s}"
    slow = {"v": every(20.0, 10000.0, 0.5), "w": every(40.0, 10000.0, 0.5)}
    with pytest.raises(SamplingError, match="ms"):
        judged("always (v > 1 -> eventually[0, 0.5 s] w < 1)", signals, **slow)


def test_a_gap_in_a_table_leaves_the_verdict_open():
    times = np.concatenate((np.arange(0, 4, 0.02), np.arange(9, 12, 0.02)))
    trace = Trace(times, {"v": np.full(times.size, 0.4)})
    spec = parse_spec(
        "signal v {m/s}\nrequire slow: always v < 1\nrequire soon: eventually v < 1\n"
        "require early: always[0, 3 s] v < 1"
    )
    found = {
        name: monitor_requirement(spec, trace, name, {}, Conventions()).satisfied
        for name in spec.requirements
    }
    assert found == {"slow": None, "soon": True, "early": True}
    assert monitor_requirement(spec, trace, "slow", {}, Conventions(partial=True)).satisfied
    with pytest.raises(UndecidedError):
        spec.robustness(trace, only="slow")
