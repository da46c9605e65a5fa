"""What the guard judges by: the table, each check, and the vendor's own code."""

from dataclasses import fields
from math import hypot

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from s2r_a1 import wire
from s2r_a1.guard import checks, leg, limits, moves
from s2r_a1.guard.checks import CheckedQuantities
from s2r_a1.guard.limits import LIMITS, Limits
from s2r_a1.remote import pack_buttons
from s2r_a1.wire import Orders
from s2r_sim.controller.gains import Gains
from s2r_sim.robot.constants import A1, LEGS
from s2r_sim.robot.leg_kinematics import foot_motion
from s2r_sim.robot.rotation import quaternion
from tests.a1.guarding import ZERO, at, leaning, reading, walking
from tests.examples import examples
from tests.sim.rotations import matrix

STANDING = moves.STANDING
NONE = np.zeros(12, dtype=int)


def pitched(by):
    """Return the quaternion (w, x, y, z) of a base that is turned about its y axis by so many radians."""
    return np.array([np.cos(by / 2), 0.0, np.sin(by / 2), 0.0])


def seen(**changes):
    good = CheckedQuantities(
        reading(STANDING), STANDING, link=0, bad=0, client=0, late=0, power=0, strong=NONE, strained=NONE
    )
    own = {name: changes.pop(name) for name in list(changes) if name in CheckedQuantities._fields}
    return good._replace(**{"reading": reading(STANDING)._replace(**changes), **own})


CHECKS = [check for check in vars(checks).values() if isinstance(check, checks.LimitCheck)]


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
def test_a_robot_that_stands_is_within_every_limit(check):
    assert check.find(LIMITS, seen()) is None


def test_every_word_is_either_the_robots_or_makes_a_rollout_void():
    assert {check.word for check in CHECKS} == limits.ROBOT_WORDS | {"link", "client", "operator"}
    assert not limits.ROBOT_WORDS & limits.VOID_WORDS


def test_every_figure_has_a_unit_a_source_and_a_word_on_its_double():
    for one in fields(Limits):
        assert all(one.metadata["figure"]), one.name


BROKEN = {
    "tilt": (checks.TILT, {"quaternion": leaning(0.51)}, {"quaternion": leaning(-0.49)}),
    "pitch": (checks.TILT, {"quaternion": pitched(0.51)}, {"quaternion": pitched(-0.49)}),
    "upside down": (checks.TILT, {"quaternion": leaning(3.1)}, {}),
    "height": (checks.HEIGHT, {"q": np.tile([0.0, 1.17, -2.34], 4)}, {"q": np.tile([0.0, 1.15, -2.3], 4)}),
    "hip": (checks.JOINT, {"q": at(STANDING, 0, -0.72)}, {"q": at(STANDING, 0, -0.71)}),
    "thigh": (checks.JOINT, {"q": at(STANDING, 4, 4.11)}, {"q": at(STANDING, 4, 4.1)}),
    "calf": (checks.JOINT, {"q": at(STANDING, 11, -2.62)}, {"q": at(STANDING, 11, -2.61)}),
    "deviation": (checks.DEVIATION, {"desired": at(STANDING, 7, 1.4)}, {"desired": at(STANDING, 7, 1.3)}),
    "no desired pose": (checks.DEVIATION, {"desired": at(STANDING, 7, 1.4)}, {"desired": None}),
    "torque": (checks.TORQUE, {"strong": at(NONE, 3, 3)}, {"strong": at(NONE, 3, 2)}),
    "strain": (checks.STRAIN, {"strained": at(NONE, 3, 500)}, {"strained": at(NONE, 3, 499)}),
    "power": (checks.POWER, {"power": 6}, {"power": 5}),
    "heat": (checks.HEAT, {"temperature": at(ZERO, 2, 60)}, {"temperature": at(ZERO, 2, 59)}),
    "warmth": (checks.WARMTH, {"temperature": at(ZERO, 2, 50)}, {"temperature": at(ZERO, 2, 49)}),
    "mode": (checks.MOTOR, {"mode": at(np.full(12, 10), 5, 8).astype(int)}, {}),
    "error": (checks.MOTOR, {"error": at(NONE, 5, 4).astype(int)}, {}),
    "R2": (checks.BUTTON, {"remote": pack_buttons(["R2"])}, {"remote": pack_buttons(["L2"])}),
    "L2 + B": (checks.BUTTON, {"remote": pack_buttons(["L2", "B"])}, {"remote": pack_buttons(["B"])}),
    "link": (checks.LINK, {"link": 20_000_000}, {"link": 19_999_999}),
    "absence": (checks.ABSENT, {"link": 1_000_000_000}, {"link": 999_999_999}),
    "numbers": (checks.NUMBERS, {"bad": 2}, {"bad": 1}),
    "client": (checks.CLIENT, {"client": 20_000_000}, {"client": 19_999_999}),
    "guard": (checks.HELD_UP, {"late": 20_000_000}, {"late": 19_999_999}),
}  # fmt: skip


@pytest.mark.parametrize(("check", "beyond", "within"), BROKEN.values(), ids=BROKEN)
def test_a_check_finds_what_is_beyond_its_limit_and_nothing_else(check, beyond, within):
    assert check.find(LIMITS, seen(**within)) is None
    assert check.find(LIMITS, seen(**beyond))


def test_every_check_has_a_case():
    assert {check.name for check, _, _ in BROKEN.values()} == {check.name for check in CHECKS}


@pytest.mark.parametrize(
    ("check", "changes", "names"),
    [
        (checks.HEAT, {"temperature": at(ZERO, 11, 70)}, "RL calf"),
        (checks.JOINT, {"q": at(STANDING, 3, 0.8)}, "FL hip"),
        (checks.MOTOR, {"mode": at(np.full(12, 10), 5, 8).astype(int)}, "FL calf"),
        (checks.MOTOR, {"error": at(NONE, 1, 4).astype(int)}, "FR thigh"),
        (checks.TORQUE, {"strong": at(NONE, 6, 3)}, "RR hip"),
    ],
)
def test_a_sentence_names_the_joint(check, changes, names):
    assert names in check.find(LIMITS, seen(**changes))


def few_others(within, others):
    """Return a strategy for twelve values of which at most three differ from ``within``."""

    def row(changes):
        values = np.full(12, within)
        for place, value in changes.items():
            values[place] = value
        return values

    return st.dictionaries(st.integers(0, 11), others, max_size=3).map(row)


@pytest.mark.parametrize(
    ("joint", "angle", "limit"),
    [(3, 0.8, 0.802), (4, -1.0, -1.05), (4, 4.15, 4.19), (5, -2.65, -2.7), (5, -0.92, -0.916)],
)
def test_an_angle_beyond_its_margin_is_reported_with_its_own_limit(joint, angle, limit):
    assert f"{limit:.2f} rad" in checks.JOINT.find(LIMITS, seen(q=at(STANDING, joint, angle)))


def test_a_low_base_is_reported_with_its_height_over_the_lowest_foot():
    q = np.concatenate([[0.0, thigh, -2.0 * thigh] for thigh in (1.26, 1.22, 1.27, 1.26)])
    heights = leg.heights(leg.A1, q.tolist(), [1.0, 0.0, 0.0, 0.0])
    assert f"{max(heights):.2f} m" in checks.HEIGHT.find(LIMITS, seen(q=q))


READINGS = st.fixed_dictionaries(
    {},
    optional={
        "quaternion": st.tuples(*[st.floats(-0.6, 0.6)] * 3).map(lambda v: np.array([1.0, *v]) / hypot(1.0, *v)),
        "gyro": arrays(float, 3, elements=st.floats(-50.0, 50.0)),
        "q": arrays(float, 12, elements=st.floats(-0.6, 0.6)).map(lambda off: STANDING + off),
        "dq": few_others(0.0, st.floats(-50.0, 50.0)),
        "tau": few_others(0.0, st.floats(-50.0, 50.0)),
        "temperature": few_others(30.0, st.sampled_from([20.0, 49.0, 50.0, 59.0, 60.0])),
    },
)  # fmt: skip


@settings(max_examples=examples(2000), deadline=None)
@given(READINGS)
def test_no_check_that_a_calm_reading_is_spared_would_find_anything_in_it(changes):
    looked = seen(**changes)
    if not checks.is_calm(LIMITS, looked.reading):
        return
    assert checks.impossibility(LIMITS, looked.reading) is None
    tau = np.abs(looked.reading.tau)
    assert max(tau) <= min(LIMITS.torque, LIMITS.strain)
    assert [check.find(LIMITS, looked) for check in CHECKS if check.covered] == [None] * 6


COMMANDS = st.tuples(
    *(
        few_others(within, st.floats(-most, most))
        for most, within in [(5.0, 0.0), (30.0, 0.0), (120.0, 20.0), (12.0, 1.0), (40.0, 0.0)]
    )
).map(lambda rows: Orders(STANDING + rows[0], *rows[1:]))


@settings(max_examples=examples(2000), deadline=None)
@given(COMMANDS, st.sampled_from([wire.A1, wire.GO1]), st.integers(0, 3))
def test_a_command_passes_as_it_came_only_where_it_is_what_the_guard_would_send(orders, layout, spoilt):
    data = wire.pack(orders, layout)
    if spoilt == 1:  # a motor that is off, or anything else that orders do not say
        data = data[:100] + b"\x01" + data[101:]
        data = data[:-4] + wire.checksum(data).to_bytes(4, "little")
    try:
        command = wire.read_command(data, layout)
    except wire.WireError:
        return
    if checks.is_allowed(LIMITS, command):
        within, beyond = checks.clip(LIMITS, command.orders())
        assert beyond == 0
        assert np.array_equal(within, command.orders())
        assert wire.pack(command.orders(), layout) == data


def test_orders_of_a_walk_pass_as_they_came():
    command = wire.read_command(wire.pack(walking(5.0), wire.A1), wire.A1)
    assert checks.is_allowed(LIMITS, command)
    assert wire.pack(command, wire.A1) == command.data


@pytest.mark.parametrize(
    ("name", "most"), [("dq", LIMITS.speed), ("tau", LIMITS.torque), ("kp", LIMITS.kp), ("kd", LIMITS.kd)]
)
def test_a_command_with_one_value_beyond_its_limit_does_not_pass_as_it_came(name, most):
    def passes(joint, value):
        orders = walking()
        orders = orders._replace(**{name: at(getattr(orders, name), joint, value)})
        return checks.is_allowed(LIMITS, wire.read_command(wire.pack(orders, wire.A1), wire.A1))

    for joint in range(12):
        assert passes(joint, 0.99 * most)
        assert not passes(joint, 1.01 * most)
        if name in ("dq", "tau"):
            assert passes(joint, -0.99 * most)
            assert not passes(joint, -1.01 * most)


@pytest.mark.parametrize("name", ["hip", "thigh", "calf", "warmth"])
def test_a_reading_within_a_limit_by_little_is_calm(name):
    assert checks.is_calm(LIMITS, seen(**BROKEN[name][2]).reading)


POSSIBLE = [{}, {"q": np.tile([0.0, 1.3, -2.8], 4)}, {"dq": np.full(12, -40.0)}, {"gyro": np.full(3, 30.0)}]
IMPOSSIBLE = [
    {"quaternion": np.zeros(4)},
    {"quaternion": np.array([0.9, 0.0, 0.0, 0.0])},
    {"quaternion": np.full(4, np.nan)},
    {"gyro": np.array([0.0, 36.0, 0.0])},
    {"gyro": np.array([0.0, np.nan, 0.0])},
    {"accelerometer": np.array([0.0, np.inf, 0.0])},
    {"q": at(STANDING, 2, -3.3)},
    {"q": at(STANDING, 2, np.nan)},
    {"q": at(STANDING, 0, 1e30)},
    {"dq": at(ZERO, 9, -43.0)},
    {"dq": at(ZERO, 9, np.nan)},
]


@pytest.mark.parametrize("one", IMPOSSIBLE)
def test_a_reading_that_cannot_be_is_not_calm(one):
    assert not checks.is_calm(LIMITS, reading(STANDING)._replace(**one))


def test_readings_that_can_be_are_distinguished_from_those_that_cannot():
    assert [checks.impossibility(LIMITS, reading(STANDING)._replace(**one)) for one in POSSIBLE] == [None] * 4
    assert all(checks.impossibility(LIMITS, reading(STANDING)._replace(**one)) for one in IMPOSSIBLE)


AT_A_LIMIT = [{"gyro": np.array([35.0, -35.0, 35.0])}, {"dq": np.full(12, -42.0)}]
BEYOND_IT = [{"gyro": np.array([0.0, 0.0, -35.1])}, {"dq": at(ZERO, 3, 42.1)}, {"q": at(STANDING, 3, -1.31)}]


def test_a_reading_at_a_limit_of_what_is_possible_is_possible():
    for one in AT_A_LIMIT:
        at_the_limit = reading(STANDING)._replace(**one)
        assert checks.impossibility(LIMITS, at_the_limit) is None
        assert checks.is_calm(LIMITS, at_the_limit)
    for one in BEYOND_IT:
        assert checks.impossibility(LIMITS, reading(STANDING)._replace(**one))
    assert checks.impossibility(LIMITS, reading(at(STANDING, 3, -1.29))) is None


@pytest.mark.parametrize(("norm", "possible"), [(0.94, False), (0.96, True), (1.04, True), (1.06, False)])
def test_the_norm_of_an_attitude_is_1_by_a_twentieth(norm, possible):
    one = reading(STANDING)._replace(quaternion=norm * leaning(0.1))
    assert (checks.impossibility(LIMITS, one) is None) == possible
    assert checks.is_calm(LIMITS, one) == possible


@pytest.mark.parametrize("field", ["gyro", "dq", "tau", "temperature"])
def test_a_reading_is_calm_up_to_its_limit_on_either_side(field):
    most = {"gyro": 35.0, "dq": 42.0, "tau": 20.0, "temperature": 49.9}[field]
    least = -40.0 if field == "temperature" else -most
    size = getattr(reading(STANDING), field).size
    for place in range(size):
        for value in (most, least):
            one = np.zeros(size)
            one[place] = value
            assert checks.is_calm(LIMITS, reading(STANDING)._replace(**{field: one}))
            one[place] *= 1.01
            assert not checks.is_calm(LIMITS, reading(STANDING)._replace(**{field: one}))


def test_a_base_that_tilts_about_one_axis_is_calm_up_to_a_part_of_the_limit():
    assert checks.is_calm(LIMITS, reading(STANDING)._replace(quaternion=leaning(0.35)))
    assert not checks.is_calm(LIMITS, reading(STANDING)._replace(quaternion=leaning(0.36)))


def test_the_level_of_power_is_hundreds_of_watts_from_one_to_ten():
    levels = [-1, 0, 1, 2, 5, 10, 12]
    assert [Limits(power_level=level).watts for level in levels] == [100, 100, 100, 200, 500, 1000, 1000]


def test_power_is_the_sum_of_what_every_motor_takes_or_gives():
    dq, tau = np.arange(12.0) - 6.0, np.full(12, -2.0)
    assert checks.power(reading(dq=dq, tau=tau)) == 2.0 * np.abs(dq).sum()


def test_the_count_of_power_rises_beyond_the_level_and_falls_to_zero():
    assert checks.power_count(LIMITS, 3, 500.1) == 4
    assert [checks.power_count(LIMITS, count, 500.0) for count in (3, 1, 0)] == [2, 0, 0]


def test_orders_within_the_limits_are_not_touched():
    orders = walking(tau=33.5)
    assert checks.clip(LIMITS, orders) == (orders, 0)


@pytest.mark.parametrize(
    ("name", "value", "becomes"),
    [("tau", 100.0, 33.5), ("tau", -100.0, -33.5), ("q", 0.5, -0.916), ("q", -3.0, -2.7), ("kp", 900.0, 100.0),
     ("kd", 900.0, 10.0)],
)  # fmt: skip
def test_orders_beyond_a_limit_are_clipped_and_counted(name, value, becomes):
    orders = walking()
    changed, count = checks.clip(LIMITS, orders._replace(**{name: at(getattr(orders, name), 2, value)}))
    assert getattr(changed, name)[2] == becomes
    assert count == 1
    for other in Orders._fields:
        np.testing.assert_array_equal(
            np.delete(getattr(changed, other), 2), np.delete(getattr(orders, other), 2)
        )


@pytest.mark.parametrize(("gain", "counted"), [(0.0, 0), (0.5, 1), (20.0, 1)])
def test_an_angle_beyond_its_limit_counts_where_its_gain_acts(gain, counted):
    orders = walking()
    orders = orders._replace(q=at(orders.q, 2, 0.5), kp=at(orders.kp, 2, gain))
    changed, count = checks.clip(LIMITS, orders)
    assert (changed.q[2], count) == (-0.916, counted)


def test_the_vendors_stop_values_switch_their_loops_off():
    orders = walking()._replace(q=np.full(12, 2.146e9), dq=np.full(12, 16000.0), kp=ZERO)
    changed, count = checks.clip(LIMITS, orders)
    assert not changed.kp.any()
    assert not changed.kd.any()
    assert not changed.dq.any()
    assert count == 12  # the kd that did not act


@pytest.mark.parametrize(
    ("name", "value"), [("q", np.nan), ("dq", np.inf), ("tau", np.nan), ("kp", -1.0), ("kd", -0.1)]
)
def test_orders_that_are_no_numbers_or_push_the_wrong_way_are_not_used(name, value):
    orders = walking()
    assert checks.clip(LIMITS, orders._replace(**{name: at(getattr(orders, name), 2, value)})) is None


@settings(max_examples=examples(100), deadline=None)
@given(st.lists(st.floats(-1e9, 1e9), min_size=60, max_size=60))
def test_clipped_orders_are_within_every_limit(numbers):
    orders = Orders(*np.array(numbers).reshape(5, 12))
    found = checks.clip(LIMITS, orders)
    if found is None:
        assert min(orders.kp.min(), orders.kd.min()) < 0.0
        return
    changed, count = found
    assert checks.clip(LIMITS, changed) == (changed, 0)
    assert (count == 0) <= (np.abs(orders.tau) <= 33.5).all()


def test_the_lengths_of_legs_are_those_of_the_simulator():
    own = leg.A1
    assert (own.hip_x, own.hip_y, own.thigh_y, own.thigh, own.calf, own.foot) == (
        A1.hip_x, A1.hip_y, A1.thigh_y, A1.thigh_length, A1.calf_length, A1.foot_radius
    )  # fmt: skip
    assert [(one.sx, one.sy) for one in LEGS] == list(leg.SIDES)
    assert Gains().base_height == moves.STAND_HEIGHT
    assert A1.torque_limit == LIMITS.torque
    assert A1.speed_limit == LIMITS.speed
    np.testing.assert_allclose([LIMITS.lowest, LIMITS.highest], np.array(A1.limits).T, atol=0.004)


def test_the_height_is_that_of_the_simulators_kinematics():
    random = np.random.default_rng(0)
    for _ in range(100):
        q, rpy = random.uniform(-1.0, 1.0, 12), random.uniform(-0.5, 0.5, 3)
        world = matrix(*rpy)
        own = list(leg.feet(leg.A1, q.tolist()))
        theirs = [
            foot_motion(A1, one, q[3 * i : 3 * i + 3], ZERO[:3], np.sin, np.cos).position
            for i, one in enumerate(LEGS)
        ]
        np.testing.assert_allclose(own, np.array(theirs, dtype=float), atol=1e-12)
        lowest = (world @ np.array(theirs, dtype=float).T)[2].min() - A1.foot_radius
        x, y, z, w = quaternion(*rpy)
        assert max(leg.heights(leg.A1, q.tolist(), (w, x, y, z))) == pytest.approx(-lowest, abs=1e-12)


def test_a_stand_is_as_high_as_it_says():
    assert max(leg.heights(leg.A1, STANDING.tolist(), [1.0, 0.0, 0.0, 0.0])) == pytest.approx(
        moves.STAND_HEIGHT
    )


@pytest.fixture(scope="module")
def vendor():
    module = pytest.importorskip(
        "unitree_legged_sdk.robot_interface", reason="the vendor's wheel is for Python 3.11 on x86-64"
    )
    return module


@pytest.mark.dev
def test_angles_are_clipped_as_the_vendor_clips_them(vendor):
    safety, command = vendor.Safety(vendor.LeggedType.A1), vendor.LowCmd()
    motors = [command.motorCmd[motor] for motor in range(12)]
    angles = np.random.default_rng(0).uniform(-6.0, 6.0, (10_000, 12))
    theirs, ours = np.empty_like(angles), np.empty_like(angles)
    for row, q in enumerate(angles):
        for motor, angle in zip(motors, q.tolist(), strict=True):
            motor.q = angle
        safety.PositionLimit(command)
        theirs[row] = [motor.q for motor in motors]
        ours[row] = checks.clip(LIMITS, walking()._replace(q=q))[0].q
    np.testing.assert_allclose(ours, theirs, atol=1e-6)


@pytest.mark.dev
@pytest.mark.parametrize("level", [-1, 0, 1, 3, 5, 8, 10, 12])
def test_power_is_counted_as_the_vendor_counts_it(vendor, level, capfd):
    own = Limits(power_level=level)
    state, command = vendor.LowState(), vendor.LowCmd()
    motors = [state.motorState[motor] for motor in range(12)]
    random = np.random.default_rng(level + 1)
    for _ in range(125):
        safety, count = vendor.Safety(vendor.LeggedType.A1), 0
        for _ in range(30):
            dq, tau = random.normal(0.0, 4.0, 12), random.normal(0.0, own.watts / 24.0, 12)
            for motor, speed, torque in zip(motors, dq.tolist(), tau.tolist(), strict=True):
                motor.dq, motor.tauEst = speed, torque
            theirs = safety.PowerProtect(command, state, level) < 0
            count = checks.power_count(own, count, checks.power(reading(dq=dq, tau=tau)))
            assert theirs == (count >= own.power_rounds)
            if theirs:
                break
