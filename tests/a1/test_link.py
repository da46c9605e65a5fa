"""Links over sockets on loopback, and what a robot's ticks say of its states."""

import socket
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from s2r_a1 import datagrams
from s2r_a1.datagrams import (
    FROM_ROBOT,
    TO_ROBOT,
    LinkError,
    LockStepSocket,
    RealTimeSocket,
    is_loopback,
    open_socket,
)
from s2r_a1.link import Link, RobotSide, UdpLink
from s2r_a1.ticks import PERIOD, Counters, Ticks, elapsed_ticks, unit_of
from s2r_a1.vendor import VendorLink
from s2r_a1.wire import A1, GO1, Orders, Reading, WireError, pack, pack_reading
from tests.examples import examples

ZERO = Orders(*np.zeros((5, 12)))
HERE = "127.0.0.1"


def state(tick, layout=A1, **fields):
    zero = np.zeros(12)
    reading = Reading(
        np.array([1.0, 0, 0, 0]), np.zeros(3), np.array([0, 0, 9.81]), zero, zero, zero, zero, np.full(12, 10), tick
    )  # fmt: skip
    return pack_reading(reading._replace(**fields), layout)


NAN = {"gyro": np.full(3, np.nan)}


def joined(kind, layout=A1, unit="ms"):
    mine, theirs = kind(), kind()
    mine.connect((HERE, theirs.port))
    theirs.connect((HERE, mine.port))
    return SimpleNamespace(
        link=UdpLink(mine, layout, unit), robot=RobotSide(theirs, layout), mine=mine, theirs=theirs
    )


@pytest.fixture(params=[RealTimeSocket, LockStepSocket], ids=["real time", "lock step"])
def leg(request):
    both = joined(request.param)
    yield both
    both.link.close()
    both.robot.close()


@pytest.fixture
def real():
    both = joined(RealTimeSocket)
    yield both
    both.link.close()
    both.robot.close()


@pytest.fixture
def step():
    both = joined(LockStepSocket)
    yield both
    both.link.close()
    both.robot.close()


@pytest.fixture
def other_sender():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind((HERE, 0))
        yield one


def test_orders_and_states_go_both_ways(leg):
    orders = Orders(*np.arange(60.0).reshape(5, 12))
    leg.link.write(orders)
    read = leg.robot.read()
    assert np.array_equal(read, orders)
    assert leg.robot.packet == pack(orders, A1)
    leg.robot.send(state(4))
    reading = leg.link.read()
    assert reading.tick == 4
    assert leg.link.packet == state(4)
    assert leg.link.fault is None


def test_a_go1_s_packets_go_over_the_same_link():
    both = joined(RealTimeSocket, GO1)
    both.link.write(ZERO)
    assert both.robot.read() is not None
    both.robot.send(state(1, GO1))
    assert both.link.read().tick == 1
    both.robot.send(state(2, A1))
    assert both.link.read() is None
    assert both.link.fault == "length"
    both.link.close()
    both.robot.close()


def test_every_datagram_is_seen_with_its_direction(leg):
    seen = []
    leg.link.tap = lambda *what: seen.append(what)
    leg.link.write(ZERO)
    leg.robot.send(b"rubbish")
    leg.link.read()
    leg.link.send(b"as it is")
    assert seen == [(TO_ROBOT, pack(ZERO, A1)), (FROM_ROBOT, b"rubbish"), (TO_ROBOT, b"as it is")]


def test_orders_that_do_not_fit_are_not_sent(leg):
    with pytest.raises(WireError):
        leg.link.write(ZERO._replace(tau=np.full(12, 200.0)))
    leg.link.send(b"next")
    leg.robot.read()
    assert leg.robot.packet == b"next"


@pytest.mark.parametrize(
    ("data", "fault", "counter"),
    [
        (b"short", "length", "corrupt"),
        (bytes(771), "crc", "corrupt"),
        (state(5)[:100] + b"\x99" + state(5)[101:], "crc", "corrupt"),
        (state(5, **NAN), "number", "numbers"),
        (state(3), "repeated", "repeated"),
        (state(1), "backwards", "backwards"),
        (state(3 + 60_000), "clock", "clock"),
    ],
)
def test_a_state_that_must_not_be_used_is_counted_and_its_fault_named(leg, data, fault, counter):
    leg.robot.send(state(3))
    leg.link.read()
    leg.robot.send(data)
    assert leg.link.read() is None
    assert leg.link.fault == fault
    assert leg.link.packet == data
    assert vars(leg.link.counters) == vars(Counters()) | {"received": 2, "late": 1, counter: 1}
    leg.robot.send(state(5))
    assert leg.link.read().tick == 5


@pytest.mark.parametrize(
    ("data", "fault", "counter"),
    [
        (bytes(610), "crc", "corrupt"),
        (b"short", "length", "corrupt"),
        (state(1), "length", "corrupt"),
    ],
)
def test_orders_that_must_not_be_used_are_counted_and_their_fault_named(leg, data, fault, counter):
    leg.link.send(data)
    assert leg.robot.read() is None
    assert (leg.robot.fault, leg.robot.packet) == (fault, data)
    assert vars(leg.robot.counters) == vars(Counters()) | {"received": 1, "late": 1, counter: 1}


def test_of_several_states_the_newest_counts(real):
    for tick in (2, 4, 8, 6, 8):
        real.robot.send(state(tick))
    real.robot.send(b"corrupt")
    assert real.link.read().tick == 8
    assert real.link.packet == state(8)
    counters = real.link.counters
    assert (counters.received, counters.backwards, counters.repeated, counters.corrupt) == (6, 1, 1, 1)
    assert (counters.lost, counters.late) == (1, 0)  # tick 6 was missing when 8 came
    assert real.link.read() is None
    assert (real.link.fault, real.link.packet, counters.late) == ("silence", b"", 1)


def test_of_several_orders_the_newest_counts(real):
    for tau in (1.0, 2.0, 3.0):
        real.link.write(ZERO._replace(tau=np.full(12, tau)))
    real.link.send(b"corrupt")
    assert real.robot.read().tau[0] == 3.0
    assert real.robot.counters.corrupt == 1


def test_packets_from_another_address_are_left_out(leg, other_sender):
    for end, read in ((leg.mine, leg.link.read), (leg.theirs, leg.robot.read)):
        other_sender.sendto(state(99), (HERE, end.port))
        other_sender.sendto(pack(ZERO, A1), (HERE, end.port))
        leg.link.write(ZERO)
        leg.robot.send(state(2))
        assert read() is not None
    assert leg.link.packet == state(2)


@pytest.mark.parametrize("kind", [RealTimeSocket, LockStepSocket])
def test_packets_that_came_before_the_peer_was_known_are_its_own_or_left_out(kind, other_sender):
    mine, theirs = kind(), kind()
    theirs.connect((HERE, mine.port))
    other_sender.sendto(state(99), (HERE, mine.port))
    theirs.send(state(2))
    other_sender.sendto(state(98), (HERE, mine.port))
    mine.connect((HERE, theirs.port))
    link = UdpLink(mine, A1)
    assert link.read().tick == 2
    theirs.send(state(4))
    assert link.read().tick == 4
    assert link.counters.foreign == 2
    mine.close()
    theirs.close()


def test_a_robot_that_is_not_there_is_silence_in_real_time():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind((HERE, 0))
        nobody = one.getsockname()
    link = UdpLink(open_socket(nobody), A1)
    for _ in range(5):
        link.write(ZERO)
        assert link.read() is None
        assert link.fault == "silence"
    link.close()


def test_a_robot_that_comes_later_gets_the_first_command_after_it_came():
    first = RealTimeSocket()
    port = first.port
    mine = open_socket((HERE, port))
    link = UdpLink(mine, A1)
    first.close()
    link.write(ZERO)  # to nobody, which the network says on the next use
    robot = RealTimeSocket(port=port)
    robot.connect((HERE, mine.port))
    link.write(ZERO)
    assert RobotSide(robot, A1).read() is not None
    assert link.counters.unsent == 0
    link.close()
    robot.close()


def test_a_peer_that_ended_is_gone_in_lock_step(step):
    step.robot.close()
    step.link.write(ZERO)
    assert step.link.read() is None
    assert step.link.fault == "gone"
    step.link.write(ZERO)  # harmless
    assert step.link.read() is None


def test_a_peer_that_says_nothing_is_gone_in_lock_step_after_a_while(step, monkeypatch):
    monkeypatch.setattr(datagrams, "PATIENCE", 0.01)
    assert step.link.read() is None
    assert step.link.fault == "gone"


def test_in_lock_step_a_round_is_one_datagram_and_time_is_rounds(step):
    for tick in (2, 4, 6):
        step.robot.send(state(tick))
    step.robot.skip()
    step.robot.send(state(10))
    assert [step.link.read().tick for _ in range(3)] == [2, 4, 6]
    assert step.link.read() is None
    assert (step.link.fault, step.link.packet) == ("silence", b"")
    assert step.link.read().tick == 10
    step.robot.send(state(12))
    assert step.mine.receive() == [(state(12), 6 * PERIOD)]
    assert (step.link.counters.received, step.link.counters.lost, step.link.counters.late) == (5, 1, 1)


def test_silence_is_a_datagram_in_lock_step_and_none_in_real_time(leg):
    leg.link.skip()
    if isinstance(leg.mine, LockStepSocket):  # a read that did not find it would wait
        assert leg.robot.read() is None
        assert leg.robot.fault == "silence"
    else:
        leg.link.write(ZERO)
        leg.robot.read()
        assert leg.robot.counters.received == 1


def test_a_flood_is_taken_in_parts(real, monkeypatch):
    monkeypatch.setattr(datagrams, "WAITING", 3)
    for tick in range(2, 18, 2):
        real.robot.send(state(tick))
    assert [real.link.read().tick for _ in range(3)] == [6, 12, 16]


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux stamps datagrams")
def test_a_reader_that_was_delayed_takes_the_next_state(real):
    """The socket keeps the oldest states of a delay and loses the newest ones: the next state is far ahead."""
    began = time.monotonic()
    sent = 0
    while sent < 400:
        real.robot.send(state(sent))
        sent += 2
        time.sleep(max(0.0, began + sent / 1000 - time.monotonic()))
    kept = real.link.read()
    assert kept is not None
    assert kept.tick < 300  # the buffer holds 0.2 s
    real.robot.send(state(sent))
    fresh = real.link.read()
    assert (real.link.fault, fresh and fresh.tick) == (None, sent)


def test_a_local_port_that_is_taken_is_an_error(other_sender):
    with pytest.raises(LinkError, match="cannot be opened"):
        open_socket((HERE, 9), port=other_sender.getsockname()[1])


@pytest.mark.parametrize(
    ("host", "port"), [("no.such.host.invalid", 8007), ("999.1.1.1", 8007), ("é" * 80, 8007), (HERE, 70_000)]
)
def test_an_address_that_is_none_is_an_error(host, port):
    with pytest.raises(LinkError, match="cannot be reached"):
        open_socket((host, port))


def test_a_local_port_that_is_none_is_an_error():
    with pytest.raises(LinkError, match="cannot be opened"):
        open_socket((HERE, 9), port=70_000)


@pytest.mark.parametrize("host", ["192.168.123.10", "8.8.8.8", "no.such.host.invalid"])
def test_lock_step_is_refused_with_another_machine(host):
    with pytest.raises(LinkError, match="this computer"):
        open_socket((host, 8007), lockstep=True)


def test_loopback_is_distinguished_from_networks():
    assert all(is_loopback(host) for host in ("127.0.0.1", "127.3.2.1", "localhost"))
    assert not any(is_loopback(host) for host in ("192.168.123.10", "0.0.0.0", "no.such.host.invalid", ""))


def test_links_and_recordings_load_no_simulator():
    """The guard is made of them, and must start fast and stay small."""
    code = (
        "import sys, s2r_a1.link, s2r_a1.rawlog, s2r_a1.remote, s2r_a1.vendor; "
        "print(*{name.split('.')[0] for name in sys.modules})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = {"s2r_sim", "mujoco", "pinocchio", "torch", "scipy", "numba", "piqp", "pint", "lark"}
    assert not heavy & set(done.stdout.split())


def test_every_link_has_the_whole_protocol(leg):
    names = set(Link.__annotations__) | {name for name in vars(Link) if not name.startswith("_")}
    for kind in (leg.link, VendorLink(None, A1)):
        assert all(hasattr(kind, name) for name in names)


# The robot's clock


@pytest.mark.parametrize(("per_round", "unit"), [(2, "ms"), (2000, "us"), (1, None), (33, None), (200, None)])
@pytest.mark.parametrize("start", [0, 2**32 - 300])
def test_the_unit_is_measured_over_half_a_second(per_round, unit, start):
    ticks = Ticks(Counters())
    for k in range(260):
        assert ticks.judge((start + k * per_round) % 2**32, k * PERIOD) is None
        if k * PERIOD < 0.5:
            assert ticks.unit is None
            assert ticks.refusal is None
    assert ticks.unit == unit
    assert (ticks.refusal is None) == (unit is not None)


def test_the_unit_is_measured_over_a_link_in_lock_step():
    both = joined(LockStepSocket, unit=None)
    for k in range(1, 260):
        both.robot.send(state(2000 * k))
        assert both.link.read().tick == 2000 * k
    assert both.link.unit == "us"
    both.link.forget()
    assert both.link.unit is None
    both.robot.send(state(3))
    assert both.link.read().tick == 3
    both.link.close()
    both.robot.close()


@given(seed=st.integers(0, 2**32))
@settings(max_examples=examples(50), deadline=None)
def test_the_unit_is_found_with_packets_that_are_late_by_eight_milliseconds(seed):
    ticks = Ticks(Counters())
    for k, late in enumerate(np.random.default_rng(seed).choice([0.0, 0.008], 400)):
        ticks.judge(2 * k, k * PERIOD + late)
    assert ticks.unit == "ms"


def test_a_clock_of_no_known_unit_may_still_settle():
    ticks = Ticks(Counters())
    now, tick = 0.0, 0
    for per_round, rounds in ((50, 260), (2, 520)):
        for _ in range(rounds):
            ticks.judge(tick, now)
            now, tick = now + PERIOD, tick + per_round
    assert ticks.unit == "ms"
    assert ticks.refusal is None


@pytest.mark.parametrize(("unit", "other", "fault"), [("ms", 2000, "clock"), ("us", 2, "repeated")])
def test_a_clock_that_changes_its_unit_brings_nothing_new(unit, other, fault):
    ticks = Ticks(Counters(), unit)
    assert ticks.judge(1000, 0.0) is None
    faults = {ticks.judge(1000 + other * k, k * PERIOD) for k in range(1, 40)}
    assert faults == {fault}


@pytest.mark.parametrize("unit", ["ms", "us"])
def test_a_clock_may_begin_again_after_32_bits(unit):
    counters = Counters()
    ticks = Ticks(counters, unit)
    step = 2 if unit == "ms" else 2000
    for k in range(10):
        assert ticks.judge((2**32 - 5 * step + k * step) % 2**32, k * PERIOD) is None
    assert vars(counters) == vars(Counters())


def test_a_robot_that_sends_every_millisecond_loses_nothing():
    counters = Counters()
    ticks = Ticks(counters, "ms")
    for k in range(100):
        assert ticks.judge(k, k * 0.001) is None
    assert counters.lost == 0


def test_a_long_silence_is_lost_states_and_no_fault():
    counters = Counters()
    ticks = Ticks(counters, "ms")
    ticks.judge(0, 0.0)
    assert ticks.judge(5000, 5.0) is None
    assert counters.lost == 2499


@given(before=st.integers(0, 2**32 - 1), step=st.integers(-(2**31), 2**31 - 1))
@settings(max_examples=examples(300), deadline=None)
def test_ticks_are_subtracted_on_a_circle(before, step):
    assert elapsed_ticks(before, (before + step) % 2**32) == step


@given(ticks=st.lists(st.integers(0, 40), max_size=60))
@settings(max_examples=examples(200), deadline=None)
def test_no_state_is_new_twice_and_none_is_older_than_one_before(ticks):
    judge = Ticks(Counters(), "ms")
    new = [tick for k, tick in enumerate(ticks) if judge.judge(tick, k * PERIOD) is None]
    assert new == sorted(set(new))


def test_rates_between_the_units_are_neither():
    assert [unit_of(rate) for rate in (1000, 950, 1050, 1e6)] == ["ms", "ms", "ms", "us"]
    assert {unit_of(rate) for rate in (0, -1000, 800, 1200, 30_000, 2e6)} == {None}
