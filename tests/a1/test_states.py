"""The guard's state machine: each transition, what is sent in each state, and what never happens."""

import subprocess
import sys
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from s2r_a1.guard import leg, moves, states, transitions
from s2r_a1.guard.control import ROLES
from s2r_a1.guard.limits import LIMITS, ROUND, SECOND
from s2r_a1.guard.states import RULES, Arrival, Inputs, Machine, State
from s2r_a1.guard.step import judge_arrival, step
from s2r_a1.guard.transitions import Conditions
from s2r_a1.remote import LOST, pack_buttons
from tests.a1.guarding import LYING, READY, ZERO, Rounds, at, leaning, reading, walking
from tests.examples import examples

WARM = np.full(12, 50.0)


def limp(orders):
    return orders is not None and not (orders.kp.any() or orders.kd.any() or orders.tau.any())


def damping(orders):
    return not (orders.kp.any() or orders.tau.any()) and (orders.kd == moves.DAMPING).all()


@pytest.fixture
def brought():
    """Return rounds in a state, which were taken there once."""
    return lambda state: Rounds(*_brought(state))


@cache
def _brought(state):
    rounds = Rounds().bring(state)
    return rounds.machine, rounds.orders, rounds.q


def test_nothing_leaves_before_the_first_consent_and_no_gain_before_the_second():
    rounds = Rounds()
    rounds.turn(10)
    assert rounds.state is State.OFF
    assert rounds.orders is None
    for state in (State.LINKED, State.ARMED):
        assert limp(Rounds().bring(state).orders)


@pytest.mark.parametrize(
    "trouble",
    [
        {"silent": True},
        {"bad": True},
        {"quaternion": leaning(2.0)},
        {"temperature": np.full(12, 90.0)},
        {"mode": np.zeros(12, dtype=int)},
        {"error": np.full(12, 4)},
        {"tau": np.full(12, 100.0), "dq": np.full(12, 20.0)},
        {"remote": pack_buttons(["R2"])},
    ],
    ids=str,
)
def test_no_trouble_found_while_connecting_ever_sends_a_gain(brought, trouble):
    rounds = brought(State.LINKED)
    for _ in range(3):
        rounds.turn(20, **trouble)
        assert rounds.ask("damp", "operator") is None
        assert rounds.ask("stand")
        rounds.machine = transitions.leave(rounds.machine, rounds.machine.memory.now)
        assert rounds.state is State.LINKED
        assert limp(rounds.orders)


UNREADY = {
    "silent": ({"silent": True}, READY),
    "numbers": ({"bad": True}, READY),
    "unit unknown": ({}, READY._replace(unit=False)),
    "no unit": ({}, READY._replace(unit=False, refusal="neither")),
    "mode": ({"mode": at(np.full(12, 10), 3, 0).astype(int)}, READY),
    "error": ({"error": at(ZERO, 3, 1).astype(int)}, READY),
    "warm": ({"temperature": WARM}, READY),
    "button": ({"remote": pack_buttons(["R2"])}, READY),
    "no remote": ({"remote": bytes(40)}, Conditions(True, None, loopback=False)),
}


@pytest.mark.parametrize(("trouble", "conditions"), UNREADY.values(), ids=UNREADY)
def test_a_robot_is_not_armed_unless_all_is_well(brought, trouble, conditions):
    rounds = brought(State.LINKED)
    assert transitions.unready(rounds.machine, READY, LIMITS) is None
    rounds.turn(10, **trouble)
    assert transitions.unready(rounds.machine, conditions, LIMITS)


def test_a_twin_needs_no_remote(brought):
    rounds = brought(State.LINKED)
    rounds.turn(10, remote=bytes(40))
    assert transitions.unready(rounds.machine, READY, LIMITS) is None


OFF = {"remote": bytes(40)}
SOON = LOST // ROUND - 1
"""Rounds after the last one with a remote, until it is lost."""


@pytest.mark.parametrize("state", [State.STANDING_UP, State.STAND, State.WALK])
def test_a_remote_that_is_lost_brings_the_robot_to_rest(brought, state):
    rounds = brought(state)
    rounds.turn(SOON, walking(), **OFF)
    assert rounds.machine.word is None
    assert rounds.machine.wanted is None
    passed = set()
    for _ in range(3000):
        rounds.turn(1, walking(), **OFF)
        passed.add(rounds.state)
        if rounds.state is State.RESTING:
            break
        assert rounds.orders.kp.all()  # held all the way down
    assert State.DAMPING not in passed
    assert State.LYING_DOWN in passed
    assert (rounds.state, rounds.machine.word) == (State.RESTING, "operator")
    refusal = rounds.ask("stand")
    assert "remote" in refusal
    rounds.turn()
    assert rounds.ask("stand") is None


def test_a_remote_that_comes_back_in_time_ends_no_walk(brought):
    rounds = brought(State.WALK)
    for _ in range(3):
        rounds.turn(SOON, walking(), **OFF)
        rounds.turn(1, walking())
    assert rounds.state is State.WALK
    assert rounds.machine.wanted is None


def test_a_twin_that_had_no_remote_misses_none(brought):
    rounds = brought(State.LINKED)
    rounds.turn(1, **OFF)
    rounds.machine = transitions.arm(rounds.machine, rounds.machine.memory.now)
    assert rounds.ask("stand") is None
    rounds.turn(3 * SOON, **OFF)
    assert (rounds.state, rounds.machine.wanted) == (State.STAND, None)
    assert rounds.ask("walk") is None
    rounds.turn(3 * SOON, walking(), **OFF)
    assert (rounds.state, rounds.machine.wanted) == (State.WALK, None)


@pytest.mark.parametrize(("speed", "still"), [(0.04, True), (0.06, False)])
def test_a_robot_that_moves_is_not_armed(speed, still):
    rounds = Rounds()
    rounds.machine = transitions.connect(rounds.machine, 0)
    sometimes = []
    for tick in range(1000):
        rounds.q = LYING + speed * 0.002 * tick
        rounds.turn()
        sometimes.append(transitions.unready(rounds.machine, READY, LIMITS) is None)
    assert any(sometimes) == still


def test_a_robot_is_armed_once_it_was_still_for_half_a_second():
    rounds = Rounds()
    rounds.machine = transitions.connect(rounds.machine, 0)
    rounds.turn()
    rounds.turn(249)
    assert transitions.unready(rounds.machine, READY, LIMITS)
    rounds.turn()
    assert transitions.unready(rounds.machine, READY, LIMITS) is None


def test_a_robot_that_rocks_is_not_armed():
    rounds = Rounds()
    rounds.machine = transitions.connect(rounds.machine, 0)
    for tick in range(1000):
        rounds.q = LYING + 0.05 * np.sin(2 * np.pi * 2.5 * 0.002 * tick)
        rounds.turn()
        assert transitions.unready(rounds.machine, READY, LIMITS)


def test_standing_up_leads_from_where_the_joints_are_to_the_stand():
    rounds = Rounds().bring(State.ARMED)
    rounds.q = start = at(LYING, 0, -0.5)
    rounds.turn()
    assert rounds.ask("stand") is None
    before = start
    for _ in range(1000):
        rounds.turn()
        assert np.abs(rounds.orders.q - before).max() < 0.01
        before = rounds.orders.q
        assert rounds.state is State.STANDING_UP or rounds.state is State.STAND
    assert rounds.state is State.STAND
    np.testing.assert_array_equal(rounds.orders.q, moves.STANDING)


def test_lying_down_begins_where_the_joints_are_held_and_ends_at_rest(brought):
    rounds = brought(State.STAND)
    held = rounds.orders.q
    assert rounds.ask("lie") is None
    rounds.turn(2)
    assert rounds.state is State.LYING_DOWN
    assert np.abs(rounds.orders.q - held).max() < 0.01
    assert rounds.turn(2000, until=State.RESTING) + 1 == moves.LIE_DOWN // ROUND
    assert damping(rounds.orders)
    assert rounds.machine.word is None
    assert rounds.ask("stand") is None
    assert rounds.state is State.STANDING_UP


def test_the_robot_can_lie_down_while_it_stands_up(brought):
    rounds = brought(State.STANDING_UP)
    rounds.turn(300)
    held = rounds.orders.q
    assert rounds.ask("lie", "operator") is None
    rounds.turn()
    assert rounds.state is State.LYING_DOWN
    assert np.abs(rounds.orders.q - held).max() < 0.01
    assert rounds.machine.word == "operator"


def test_a_walk_follows_its_clients_orders_and_nothing_else(brought):
    rounds = brought(State.STAND)
    for orders in (walking(5.0), None):
        rounds.turn(orders=orders)
        np.testing.assert_array_equal(rounds.orders.kp, moves.KP)
    assert rounds.ask("walk") is None
    rounds.turn()  # the stand goes on until the first orders
    np.testing.assert_array_equal(rounds.orders.kp, moves.KP)
    for orders in (walking(5.0), walking(-3.0)):
        rounds.turn(orders=orders)
        np.testing.assert_array_equal(rounds.orders, orders)


def test_orders_beyond_a_limit_are_clipped_and_counted(brought):
    rounds = brought(State.WALK)
    rounds.turn(orders=walking()._replace(tau=np.full(12, 100.0)))
    assert rounds.orders.tau.max() == 33.5
    assert rounds.machine.followed.clipped == 12


def test_a_halt_catches_the_load(brought):
    rounds = brought(State.WALK)
    rounds.turn(tau=np.full(12, 8.0), orders=walking(8.0))
    assert rounds.ask("halt") is None
    made = moves.KP * (rounds.machine.motion.start - rounds.q)
    np.testing.assert_allclose(made, 8.0)
    rounds.turn()
    assert rounds.state is State.STAND
    assert rounds.machine.word is None
    rounds.turn(200)
    np.testing.assert_array_equal(rounds.orders.q, moves.STANDING)


# Silence: rounds since the last orders, and what is sent.


def test_a_silent_client_is_bridged_without_torque_and_then_damped(brought):
    rounds = brought(State.WALK)
    rounds.turn(orders=walking(5.0))
    sent = []
    while rounds.state is State.WALK:
        rounds.turn()
        sent.append(rounds.orders)
    assert [orders.tau[0] for orders in sent] == [5.0] * 4 + [0.0] * 6
    assert [orders.kp[0] for orders in sent] == [20.0] * 9 + [0.0]
    assert rounds.state is State.DAMPING
    assert rounds.machine.word == "client"
    assert damping(sent[-1])


@pytest.mark.parametrize(("silence", "torque"), [(9_999_999, 5.0), (10_000_000, 0.0)])
def test_torques_of_orders_are_sent_for_less_than_10_ms(brought, silence, torque):
    rounds = brought(State.WALK)
    rounds.turn(orders=walking(5.0))
    last = rounds.machine.memory.now
    rounds.turn(4)
    orders = step(rounds.machine, Inputs(last + silence, Arrival(reading(rounds.q))), LIMITS).orders
    assert (orders.tau[0], orders.kp[0]) == (torque, 20.0)


def test_a_silent_robot_is_bridged_and_then_damped(brought):
    rounds = brought(State.WALK)
    rounds.turn(orders=walking(5.0))
    sent = []
    while rounds.state is State.WALK:
        rounds.turn(orders=walking(5.0), silent=True)
        sent.append(rounds.orders)
    assert [orders.tau[0] for orders in sent] == [5.0] * 4 + [0.0] * 6
    assert rounds.machine.word == "link"


@pytest.mark.parametrize("gap", [5, 6, 8, 9])
def test_a_client_that_is_stopped_for_good_is_damped_however_seldom_the_robot_s_states_come(brought, gap):
    """States 10 to 18 ms apart excuse a client once, and not again and again: its last orders would hold for ever."""
    rounds = brought(State.WALK)
    for turned in range(1, 60):
        rounds.turn(silent=turned % gap != 0)
        if rounds.state is not State.WALK:
            break
    assert rounds.state is State.DAMPING
    assert rounds.machine.word == "client"
    assert damping(rounds.orders)


def test_a_round_that_begins_a_little_early_ends_a_silence_as_any_other(brought):
    rounds = brought(State.WALK)
    rounds.turn(orders=walking(5.0))
    rounds.turn(9)
    early = rounds.machine.memory.now + ROUND - 50_000
    machine, orders = step(rounds.machine, Inputs(early), LIMITS)
    assert machine.word == "client"
    assert damping(orders)


def test_a_gap_of_the_robot_is_not_held_against_its_client(brought):
    rounds = brought(State.WALK)
    rounds.turn(orders=walking(5.0))
    rounds.turn(9, silent=True)
    rounds.turn(9)
    assert rounds.state is State.WALK
    rounds.turn(orders=walking(6.0))
    np.testing.assert_array_equal(rounds.orders, walking(6.0))


@pytest.mark.parametrize("spoilt", [{"orders": walking()._replace(kp=np.full(12, -1.0))}, {"dropped": 1}])
def test_orders_that_cannot_be_used_are_counted_and_five_in_a_row_are_silence(brought, spoilt):
    rounds = brought(State.WALK)
    rounds.turn(orders=walking(5.0))
    rounds.turn(4, **spoilt)
    assert rounds.orders.tau[0] == 5.0
    rounds.turn(1, **spoilt)
    assert rounds.orders.tau[0] == 0.0
    rounds.turn(orders=walking(5.0))
    assert rounds.orders.tau[0] == 5.0
    assert rounds.machine.followed.unusable == 5
    rounds.turn(10, **spoilt)
    assert rounds.state is State.DAMPING
    assert rounds.machine.word == "client"


def test_one_reading_that_cannot_be_is_bridged_and_two_in_a_row_damp(brought):
    rounds = brought(State.WALK)
    for _ in range(5):
        rounds.turn(orders=walking(5.0), bad=True)
        rounds.turn(orders=walking(5.0))
    assert rounds.state is State.WALK
    rounds.turn(2, orders=walking(5.0), bad=True)
    assert rounds.state is State.DAMPING
    assert rounds.machine.word == "link"


@pytest.mark.parametrize("field", ["q", "quaternion", "gyro", "accelerometer", "dq"])
def test_a_reading_that_cannot_be_never_arrives(field):
    good = reading()
    wrong = good._replace(**{field: np.full_like(getattr(good, field), np.nan)})
    found = judge_arrival(LIMITS, good, None)
    assert found.reading is good
    assert not found.bad
    assert judge_arrival(LIMITS, wrong, None) == (None, True, False)
    assert judge_arrival(LIMITS, None, "number") == (None, True, False)
    assert judge_arrival(LIMITS, None, "silence") == (None, False, False)


@pytest.mark.parametrize("state", [State.STANDING_UP, State.STAND, State.WALK, State.LYING_DOWN])
def test_a_guard_that_was_held_up_does_not_move_the_robot_on(brought, state):
    rounds = brought(state)
    now = rounds.machine.memory.now + 10 * ROUND
    late = step(rounds.machine, Inputs(now, Arrival(reading(rounds.q)), walking()), LIMITS).machine
    assert (late.state, late.word) == (State.DAMPING, "link")


# What ends a motion, by state.

MOVING = [state for state, row in RULES.items() if row.client or row.stands or row.moves]
FAULTS = {
    "fall": {"quaternion": leaning(0.6)},
    "torque": {"tau": at(ZERO, 3, 34.0)},
    "power": {"tau": np.full(12, 10.0), "dq": np.full(12, 5.0)},
    "heat": {"temperature": at(ZERO, 3, 60.0)},
    "motor": {"mode": at(np.full(12, 10), 3, 0).astype(int)},
    "operator": {"remote": pack_buttons(["L2", "B"])},
}
ROUNDS = {"torque": 3, "power": 6}


@pytest.mark.parametrize("state", MOVING)
@pytest.mark.parametrize("word", FAULTS)
def test_a_fault_damps_a_robot_that_moves_in_the_round_in_which_it_is_there(brought, state, word):
    rounds = brought(state)
    needed = ROUNDS.get(word, 1)
    rounds.turn(needed - 1, orders=walking(), **FAULTS[word])
    assert rounds.state is state
    rounds.turn(orders=walking(), **FAULTS[word])
    assert rounds.state is State.DAMPING
    assert rounds.machine.word == word
    assert rounds.machine.reason
    assert damping(rounds.orders)


def after(rounds, seen):
    """Return the machine after one more round with this reading."""
    inputs = Inputs(rounds.machine.memory.now + ROUND, Arrival(seen), walking())
    return step(rounds.machine, inputs, LIMITS).machine


def test_where_no_reading_came_the_last_one_is_not_held_against_a_motion_that_went_on(brought):
    rounds = brought(State.STANDING_UP)
    rounds.turn(200)
    now, motion = rounds.machine.memory.now, rounds.machine.motion
    (near, _), (far, _) = (moves.desired_state(motion, now + k * ROUND) for k in (1, 4))
    joint = int(np.argmax(np.abs(far - near)))
    behind = near[joint] - 0.4999 * np.sign(far[joint] - near[joint])
    machine = after(rounds, reading(at(near, joint, behind)))
    assert np.abs(far[joint] - behind) > LIMITS.deviation
    for k in (2, 3, 4):
        assert machine.state is State.STANDING_UP
        machine = step(machine, Inputs(now + k * ROUND), LIMITS).machine
    assert machine.state is State.STANDING_UP


@pytest.mark.parametrize("state", [State.STAND, State.WALK])
def test_joints_keep_their_margin_where_the_robot_stands(brought, state):
    rounds = brought(state)
    near = after(rounds, reading(at(rounds.q, 0, 0.73)))
    assert (near.state, near.word) == (State.DAMPING, "joint")


@pytest.mark.parametrize("state", [State.STANDING_UP, State.LYING_DOWN])
def test_joints_may_be_at_their_stops_on_the_way_up_and_down(brought, state):
    rounds = brought(state)
    q = np.tile([0.75, 1.2, -2.75], 4)
    rounds.machine = rounds.machine._replace(motion=moves.lying_down(q, rounds.machine.memory.now))
    assert after(rounds, reading(q)).state is state


@pytest.mark.parametrize("state", [State.STANDING_UP, State.STAND, State.LYING_DOWN])
def test_a_joint_that_does_not_follow_ends_the_guards_own_motions(brought, state):
    rounds = brought(state)
    stuck = after(rounds, reading(at(rounds.orders.q, 1, rounds.orders.q[1] - 0.55)))
    assert (stuck.state, stuck.word) == (State.DAMPING, "joint")


def test_a_low_base_is_a_fall_where_the_robot_stands(brought):
    low = np.tile(leg.stand_angles(leg.A1, 0.17), 4)
    fallen = after(brought(State.WALK), reading(low))
    assert (fallen.state, fallen.word) == (State.DAMPING, "fall")


def test_a_fall_counts_though_the_operator_pressed_in_the_same_round(brought):
    rounds = brought(State.WALK)
    rounds.turn(orders=walking(), **FAULTS["fall"], **FAULTS["operator"])
    assert rounds.machine.word == "fall"


@pytest.mark.parametrize("state", [State.ARMED, State.RESTING])
def test_where_the_robot_lies_a_pause_of_the_link_is_forgiven_and_an_absence_is_not(brought, state):
    rounds = brought(state)
    rounds.turn(499, silent=True)
    assert rounds.state is state
    rounds.turn(1, silent=True)
    assert rounds.state is State.DAMPING
    assert rounds.machine.word == "link"


def test_a_motor_is_warned_of_after_a_second_of_more_than_20_newton_metres(brought):
    rounds = brought(State.STAND)
    rounds.turn(500, tau=np.full(12, 20.0))
    assert rounds.machine.warnings == ()
    rounds.turn(499, tau=at(ZERO, 3, -20.1))
    assert rounds.machine.warnings == ()
    rounds.turn(tau=at(ZERO, 3, -20.1))
    assert [name for name, _ in rounds.machine.warnings] == ["strain"]


def test_the_largest_torque_itself_damps_nobody(brought):
    rounds = brought(State.STAND)
    rounds.turn(20, tau=at(ZERO, 3, -33.5))
    assert rounds.state is State.STAND


@pytest.mark.parametrize("name", ["temperature", "tau"])
def test_warnings_stop_nothing(brought, name):
    rounds = brought(State.STAND)
    rounds.turn(500, **{name: np.full(12, 25.0 if name == "tau" else 55.0)})
    assert rounds.state is State.STAND
    assert len(rounds.machine.warnings) == 1
    rounds.turn()
    assert rounds.machine.warnings == ()


# Beginnings.


@pytest.mark.parametrize("state", [State.ARMED, State.RESTING])
@pytest.mark.parametrize(
    "trouble",
    [{"temperature": WARM}, {"silent": True}, {"quaternion": leaning(0.6)}, {"remote": pack_buttons(["R2"])}],
    ids=str,
)
def test_the_robot_does_not_stand_up_unless_all_is_well(brought, state, trouble):
    rounds = brought(state)
    rounds.turn(10, **trouble)
    before = rounds.state
    assert rounds.ask("stand")
    assert rounds.state is before


def test_no_walk_begins_with_a_warm_motor(brought):
    rounds = brought(State.STAND)
    rounds.turn(temperature=WARM)
    assert rounds.ask("walk")
    assert rounds.state is State.STAND


REFUSED = [(do, state) for do, (origins, _) in states.BEGINNINGS.items() for state in State
           if state not in origins and (do, state) not in {("stand", State.STANDING_UP), ("stand", State.STAND),
                                                           ("walk", State.WALK), ("excite", State.EXCITE),
                                                           ("excite_held", State.EXCITE_HELD)}
           and state is not State.OFF]  # fmt: skip


@pytest.mark.parametrize(("do", "state"), REFUSED)
def test_a_motion_begins_only_where_the_table_says(brought, do, state):
    rounds = brought(state)
    assert rounds.ask(do)
    assert rounds.state is state


@pytest.mark.parametrize("do", ["halt", "lie", "damp", "stand", "walk", "excite", "excite_held"])
def test_nothing_begins_before_the_robot_is_connected(do):
    rounds = Rounds()
    rounds.ask(do)
    assert rounds.state is State.OFF


# Ends.


@pytest.mark.parametrize("state", [State.WALK, State.EXCITE, State.EXCITE_HELD])
@pytest.mark.parametrize(("do", "end"), [("halt", State.STAND), ("lie", State.RESTING)])
def test_a_client_is_asked_to_stop_and_stopped_if_it_does_not(brought, do, end, state):
    rounds = brought(state)
    assert rounds.ask(do, "operator") is None
    assert rounds.state is state
    assert rounds.machine.wanted.state is end
    assert rounds.turn(2000, orders=walking(), until=State.STAND) == states.RAMP // ROUND
    assert rounds.machine.word == "operator"
    rounds.turn(2000, until=State.RESTING)
    assert rounds.state is end
    assert rounds.machine.word == "operator"


def test_a_client_that_stops_when_asked_ends_as_it_was_asked(brought):
    rounds = brought(State.WALK)
    rounds.ask("lie", "operator")
    rounds.turn(300, orders=walking())
    assert rounds.ask("halt") is None
    assert rounds.state is State.STAND
    assert rounds.machine.word == "operator"
    assert rounds.ask("walk")  # it is to lie down
    rounds.turn(2000, until=State.RESTING)
    assert rounds.state is State.RESTING


def test_a_full_disk_leaves_the_client_no_time(brought):
    rounds = brought(State.WALK)
    rounds.machine = transitions.stop(rounds.machine, True, "disk", "the disk is full", at_once=True)
    assert rounds.state is State.STAND
    rounds.turn(2000, until=State.RESTING)
    assert rounds.state is State.RESTING
    assert rounds.machine.word == "disk"


@pytest.mark.parametrize("state", list(State))
def test_a_client_that_dies_leaves_the_robot_damped_where_it_is_up(brought, state):
    rounds = Rounds() if state is State.OFF else brought(state)
    alone = transitions.leave(rounds.machine, rounds.machine.memory.now)
    if state in (State.STANDING_UP, State.STAND, State.WALK, State.EXCITE, State.EXCITE_HELD):
        assert (alone.state, alone.word) == (State.DAMPING, "client")
    else:
        assert alone is rounds.machine


def test_a_client_may_leave_once_the_robot_is_to_lie_down(brought):
    rounds = brought(State.STAND)
    rounds.ask("lie", "operator")
    rounds.machine = transitions.leave(rounds.machine, rounds.machine.memory.now)
    rounds.turn(2000, until=State.RESTING)
    assert rounds.state is State.RESTING


@pytest.mark.parametrize("state", [s for s in State if s not in (State.OFF, State.LINKED, State.DAMPING)])
@pytest.mark.parametrize(
    ("role", "word"), [("client", "client"), ("operator", "operator"), (None, "operator")]
)
def test_anybody_may_damp_the_robot(brought, state, role, word):
    rounds = brought(state)
    assert rounds.ask("damp", role, "because") is None
    assert (rounds.state, rounds.machine.word, rounds.machine.reason) == (State.DAMPING, word, "because")


def test_nothing_but_a_reset_leaves_damping_and_then_the_robot_must_be_armed_anew(brought):
    rounds = brought(State.WALK)
    rounds.ask("damp", "operator", "first")
    for do in ("stand", "walk", "halt", "lie"):
        assert rounds.ask(do)
    rounds.ask("damp", "client", "second")
    rounds.machine = transitions.leave(rounds.machine, rounds.machine.memory.now)
    rounds.machine = transitions.connect(transitions.arm(rounds.machine, 0), 0)
    rounds.turn(5000, orders=walking(20.0))
    assert (rounds.state, rounds.machine.reason) == (State.DAMPING, "first")
    assert damping(rounds.orders)
    rounds.machine = transitions.reset(rounds.machine, rounds.machine.memory.now)
    assert rounds.state is State.LINKED
    assert transitions.unready(rounds.machine, READY, LIMITS)  # no state has come since
    assert rounds.ask("stand")
    rounds.turn(300)
    assert limp(rounds.orders)


# What never happens, whatever comes.

ASKED = st.tuples(st.just("ask"), st.sampled_from(sorted(set(ROLES) & {"stand", "walk", "halt", "lie", "damp"})),
                  st.sampled_from(["client", "operator", None]))  # fmt: skip
CONSENT = st.tuples(st.sampled_from(["connect", "arm", "reset", "leave", "disk"]), st.none(), st.none())
TURNED = st.tuples(
    st.just("turn"),
    st.integers(1, 1200),
    st.sampled_from([{}, {"silent": True}, {"bad": True}, {"orders": walking(9.0)}, *FAULTS.values()]),
)


@settings(max_examples=examples(200), deadline=None)
@given(st.lists(st.one_of(ASKED, CONSENT, TURNED, TURNED), max_size=25))
def test_whatever_comes_no_gain_leaves_without_consent_and_damping_stays(events):
    rounds, consent = Rounds(), False
    for event, first, second in [("connect", None, None), ("turn", 300, {}), ("arm", None, None), *events]:
        before, now = rounds.machine, rounds.machine.memory.now
        if event == "turn":
            # A long turn has the same end as a few rounds, or the length of a motion.
            rounds.turn(first if first > 900 else min(first, 12), **second)
        elif event == "ask":
            rounds.ask(first, second)
        elif event == "connect":
            rounds.machine = transitions.connect(before, now)
        elif event == "arm" and not transitions.unready(before, READY, LIMITS):
            rounds.machine = transitions.arm(before, now)
            consent = consent or rounds.state is State.ARMED
        elif event == "reset":
            rounds.machine = transitions.reset(before, now)
        elif event == "leave":
            rounds.machine = transitions.leave(before, now)
        elif event == "disk":
            rounds.machine = transitions.stop(before, True, "disk", "full", at_once=True)
        after = rounds.machine
        if before.state is State.DAMPING and event != "reset":
            assert after.state is State.DAMPING
        if after.state is State.LINKED:
            consent = False
        if after.state not in (State.OFF, State.LINKED):
            assert consent
        if after.state is State.WALK and before.state is not State.WALK:
            assert (event, first) == ("ask", "walk")
        if after.state is State.DAMPING:
            assert after.word
            assert after.reason
        orders = RULES[after.state].orders(after, after.memory.now, LIMITS)
        if after.state in (State.LINKED, State.ARMED):
            assert limp(orders)
        elif after.state is State.OFF:
            assert orders is None
        else:
            assert (np.abs(orders.tau) <= LIMITS.torque).all()
            assert np.isfinite(orders).all()


def test_the_table_has_a_row_for_every_state():
    assert set(RULES) == set(State)
    for row in RULES.values():
        assert not row.client or row.stands
        assert row.then is None or row.then in RULES
    assert {state for _, state in states.BEGINNINGS.values()} <= set(State)
    assert Machine().state is State.OFF
    assert SECOND == 500 * ROUND


def test_the_guard_loads_no_simulator_and_no_library_of_one():
    names = "wire link datagrams ticks remote rawlog vendor guard guard.loop guard.answers guard.start guard.__main__"
    imports = "; ".join(f"import s2r_a1.{name}" for name in names.split())
    done = subprocess.run(
        [sys.executable, "-c", f"{imports}; import sys; print(' '.join(sys.modules))"],
        capture_output=True,
        text=True,
        check=True,
    )
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    assert not loaded & {"mujoco", "pinocchio", "torch", "scipy", "numba", "s2r_sim", "piqp", "pandas"}
