"""Packets against the tables and vectors that were taken from the vendor's compiled library."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from s2r_a1.wire import (
    A1,
    GO1,
    LAYOUTS,
    POSITION_OFF,
    SPEED_OFF,
    Orders,
    Reading,
    WireError,
    checksum,
    pack,
    pack_reading,
    unpack,
    unpack_orders,
)
from tests.examples import examples

BOTH = pytest.mark.parametrize("layout", [A1, GO1], ids=["A1", "Go1"])
LENGTHS = {"A1": (610, 771), "Go1": (614, 807)}
HEAD = {"A1": b"\xff" + bytes(9), "Go1": b"\xfe\xef\xff" + bytes(19)}
MOTORS_AT = {"A1": (10, 63), "Go1": (22, 75)}  # in a command, in a state

# The vectors, as the vendor's library sends and takes them.
INIT = (
    b"\xff" + bytes(9) + 20 * (bytes.fromhex("0ab9d2ff4e00007a46") + bytes(18)) + bytes(56)
    + bytes.fromhex("2f695913")
)  # fmt: skip
STAND = (
    b"\xff" + bytes(9)
    + b"".join(
        b"\x0a" + bytes.fromhex(["00000000", "6666663f", "6666e6bf"][i % 3]) + bytes(4)
        + bytes.fromhex(["8021", "a8f3"][i % 2]) + bytes.fromhex("80020c00") + bytes(12)
        for i in range(12)
    )
    + bytes(8 * 27 + 56) + bytes.fromhex("37bcbd1f")
)  # fmt: skip


def still(tick=0):
    zero = np.zeros(12)
    return Reading(
        np.array([1.0, 0, 0, 0]), np.zeros(3), np.array([0, 0, 9.81]), zero, zero, zero, zero, np.full(12, 10), tick
    )  # fmt: skip


def sealed(data):
    """Return a packet whose checksum is made right, by another way than ours: bit by bit."""
    register = 0xFFFFFFFF
    for (word,) in struct.iter_unpack("<I", data[: (len(data) // 4 - 1) * 4]):
        for bit in range(31, -1, -1):
            top = (register >> 31) ^ (word >> bit & 1)
            register = (register << 1 & 0xFFFFFFFF) ^ (0x04C11DB7 if top else 0)
    return data[:-4] + struct.pack("<I", register)


def changed(data, place, value):
    return sealed(data[:place] + value + data[place + len(value) :])


def refused(data, layout, read=unpack):
    with pytest.raises(WireError) as caught:
        read(data, layout)
    return caught.value.fault


def test_the_vendor_s_first_command_is_read():
    assert len(INIT) == 610
    orders = unpack_orders(INIT, A1)
    assert np.all(orders.q == np.float32(POSITION_OFF))
    assert np.all(orders.dq == 16000)
    assert not np.any([orders.kp, orders.kd, orders.tau])


def test_a_standing_command_is_the_vendor_s_to_the_byte():
    legs = np.tile([0.0, 0.9, -1.8], 4)
    tau = np.tile([33.5, -12.345], 6)
    assert pack(Orders(legs, np.zeros(12), np.full(12, 20.0), np.full(12, 0.8), tau), A1) == STAND
    back = unpack_orders(STAND, A1)
    assert np.allclose(back.q, legs, atol=1e-7)
    assert np.all(back.kp == 20)
    assert np.all(back.kd == 0.75)  # cut off at 1/16
    assert np.all(back.tau[::2] == 33.5)
    assert np.all(back.tau[1::2] == -12.34375)


def test_a_state_has_the_checksum_that_the_vendor_s_programs_accept():
    body = bytearray(771)
    body[0] = 0xFF
    struct.pack_into("<4f", body, 10, 0.5, 0.5, 0.25, 0.5)
    struct.pack_into("<3f", body, 38, 0, 0, 9.81)
    body[62] = 40
    for i in range(12):
        place = 63 + 32 * i
        struct.pack_into("<Bf", body, place, 10, 0.1 * i - 0.3)
        struct.pack_into("<f", body, place + 13, 0.1 * i - 0.3)
        body[place + 23] = 30
    struct.pack_into("<I", body, 719, 2)
    assert checksum(bytes(body)).to_bytes(4, "little") == bytes.fromhex("3e7ddba6")
    reading = unpack(bytes(body[:-4]) + bytes.fromhex("3e7ddba6"), A1)
    assert reading.quaternion.tolist() == [0.5, 0.5, 0.25, 0.5]
    assert np.allclose(reading.q, 0.1 * np.arange(12) - 0.3, atol=1e-7)
    assert reading.temperature.tolist() == [30] * 12
    assert reading.tick == 2


finite = st.floats(-1e6, 1e6, width=32)
slow = st.floats(-1e4, 1e4, width=32)  # faster is the vendor's VelStopF


def rows(elements):
    return st.lists(elements, min_size=12, max_size=12).map(np.array)


ORDERS = st.builds(
    Orders,
    rows(finite), rows(slow), rows(st.floats(0, 1023)), rows(st.floats(0, 2047)), rows(st.floats(-127.99, 127.99)),
)  # fmt: skip


@BOTH
@given(orders=ORDERS)
@settings(max_examples=examples(200), deadline=None)
def test_orders_come_back_cut_off_towards_zero(layout, orders):
    data = pack(orders, layout)
    assert len(data) == LENGTHS[layout.name][0]
    assert data == sealed(data)
    back = unpack_orders(data, layout)
    for name, count in (("kp", 32), ("kd", 16), ("tau", 256)):
        cut = [math.trunc(value * count) / count for value in getattr(orders, name)]
        assert getattr(back, name).tolist() == cut
    assert back.q.tolist() == orders.q.tolist()
    assert back.dq.tolist() == orders.dq.tolist()
    assert pack(back, layout) == data


@BOTH
@given(orders=ORDERS)
@settings(max_examples=examples(50), deadline=None)
def test_a_command_has_its_fields_where_the_table_has_them(layout, orders):
    data = pack(orders, layout)
    assert data.startswith(HEAD[layout.name])
    start = MOTORS_AT[layout.name][0]
    for i in range(20):
        mode, q, dq, tau, kp, kd, *reserve = struct.unpack_from("<Bffhhh3I", data, start + 27 * i)
        assert reserve == [0, 0, 0]
        if i >= 12:
            assert (mode, q, dq, tau, kp, kd) == (0, 0, 0, 0, 0, 0)
            continue
        assert (mode, q, dq) == (0x0A, orders.q[i], orders.dq[i])
        assert tau == math.trunc(orders.tau[i] * 256)
        assert kp == math.trunc(orders.kp[i] * 32)
        assert kd == math.trunc(orders.kd[i] * 16)
    assert not any(data[start + 540 : -4])


ticks = st.integers(0, 2**32 - 1)
counts = st.integers(-32768, 32767)
READINGS = st.builds(
    Reading,
    quaternion=st.lists(finite, min_size=4, max_size=4).map(np.array),
    gyro=st.lists(finite, min_size=3, max_size=3).map(np.array),
    accelerometer=st.lists(finite, min_size=3, max_size=3).map(np.array),
    q=rows(finite),
    dq=rows(finite),
    tau=rows(counts).map(lambda count: count / 256),
    temperature=rows(st.integers(-128, 127)),
    mode=rows(st.integers(0, 255)),
    tick=ticks,
    remote=st.binary(min_size=40, max_size=40),
    error=rows(ticks),
    foot_force=st.lists(counts, min_size=4, max_size=4).map(np.array),
)


@BOTH
@given(reading=READINGS)
@settings(max_examples=examples(200), deadline=None)
def test_a_state_comes_back_as_it_was(layout, reading):
    data = pack_reading(reading, layout)
    assert len(data) == LENGTHS[layout.name][1]
    assert data == sealed(data)
    back = unpack(data, layout)
    for name, value in reading._asdict().items():
        assert np.array_equal(getattr(back, name), value), name
    assert pack_reading(back, layout) == data


# Offsets of a state after the head, as struct has them.
FIELDS = {
    "A1": {"quaternion": 10, "gyro": 26, "accelerometer": 38, "foot_force": 703, "tick": 719, "remote": 723},
    "Go1": {"quaternion": 22, "gyro": 38, "accelerometer": 50, "foot_force": 739, "tick": 755, "remote": 759},
}
KINDS = {"quaternion": "<4f", "gyro": "<3f", "accelerometer": "<3f", "foot_force": "<4h", "tick": "<I"}


@BOTH
@given(reading=READINGS)
@settings(max_examples=examples(50), deadline=None)
def test_a_state_has_its_fields_where_the_table_has_them(layout, reading):
    data = pack_reading(reading, layout)
    assert data.startswith(HEAD[layout.name])
    places = FIELDS[layout.name]
    for name, kind in KINDS.items():
        values = struct.unpack_from(kind, data, places[name])
        assert np.array_equal(values, np.atleast_1d(getattr(reading, name))), name
    assert data[places["remote"] : places["remote"] + 40] == reading.remote
    for i in range(12):
        place = MOTORS_AT[layout.name][1] + 32 * i
        mode, q, dq, _, tau = struct.unpack_from("<Bffhh", data, place)
        assert (mode, q, dq) == (reading.mode[i], reading.q[i], reading.dq[i])
        assert tau / 256 == reading.tau[i]
        assert struct.unpack_from("<bI", data, place + 23) == (reading.temperature[i], reading.error[i])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("tau", 128.0), ("tau", -128.0), ("tau", 200.0), ("kp", 1024.0), ("kp", 2000.0), ("kd", 2048.0),
        ("kd", 5000.0), ("q", 1e39), ("dq", -1e39),
        *[(name, bad) for name in Orders._fields for bad in (math.nan, math.inf, -math.inf)],
    ],
)  # fmt: skip
@pytest.mark.parametrize("motor", [0, 11])
def test_orders_that_do_not_fit_are_refused(field, value, motor):
    rows_ = {name: np.zeros(12) for name in Orders._fields}
    rows_[field][motor] = value
    with pytest.raises(WireError, match=f"{field} of motor {motor}") as caught:
        pack(Orders(**rows_), A1)
    assert caught.value.fault == "number"


@pytest.mark.parametrize("field", Orders._fields)
@pytest.mark.parametrize("values", [np.zeros(11), np.zeros((12, 1)), 0.0, np.zeros(20), ["x"] * 12])
def test_orders_that_are_not_twelve_numbers_are_refused(field, values):
    with pytest.raises(WireError) as caught:
        pack(Orders(**{name: np.zeros(12) for name in Orders._fields} | {field: values}), A1)
    assert caught.value.fault == "number"


@BOTH
def test_a_packet_of_another_length_is_refused(layout):
    state, command = pack_reading(still(), layout), pack(Orders(*np.zeros((5, 12))), layout)
    for data, read in ((state, unpack), (command, unpack_orders)):
        for wrong in (b"", data[:1], data[:-1], data + b"\0", bytes(2000)):
            assert refused(wrong, layout, read) == "length"
    assert refused(command, layout) == "length"  # no state
    assert refused(state, GO1 if layout is A1 else A1) == "length"


@BOTH
def test_the_vendor_s_first_packet_of_zeros_is_refused(layout):
    command, state = LENGTHS[layout.name]
    assert refused(bytes(command), layout, unpack_orders) == "crc"
    assert refused(bytes(state), layout) == "crc"


@BOTH
def test_a_packet_for_another_level_is_refused(layout):
    level = len(layout.head) - 1
    for flag in (0x00, 0xEE):
        assert refused(changed(pack_reading(still(), layout), level, bytes([flag])), layout) == "level"
    command = pack(Orders(*np.zeros((5, 12))), layout)
    assert refused(changed(command, level, b"\xee"), layout, unpack_orders) == "level"


def test_a_go1_s_packet_without_its_head_is_refused():
    assert refused(changed(pack_reading(still(), GO1), 0, b"\0\0"), GO1) == "level"


@BOTH
@pytest.mark.parametrize("field", ["quaternion", "gyro", "accelerometer", "q", "dq"])
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_state_with_a_number_that_is_not_finite_is_refused(layout, field, bad):
    values = getattr(still(), field).copy()
    values[-1] = bad
    assert refused(pack_reading(still()._replace(**{field: values}), layout), layout) == "number"


@BOTH
@pytest.mark.parametrize("place", [1, 5])
def test_a_command_with_a_number_that_is_not_finite_is_refused(layout, place):
    data = pack(Orders(*np.zeros((5, 12))), layout)
    wrong = changed(data, MOTORS_AT[layout.name][0] + 27 * 11 + place, struct.pack("<f", math.nan))
    assert refused(wrong, layout, unpack_orders) == "number"


@BOTH
def test_one_wrong_byte_is_found_wherever_the_checksum_covers_it(layout):
    """It covers whole words from the front: two bytes of a command and three of a state before it are not covered."""
    for data, read in (
        (pack_reading(still(7), layout), unpack),
        (pack(Orders(*np.ones((5, 12))), layout), unpack_orders),
    ):
        covered = (len(data) // 4 - 1) * 4
        assert len(data) - 4 - covered == len(data) % 4
        for place in range(len(data)):
            wrong = data[:place] + bytes([data[place] ^ 0x10]) + data[place + 1 :]
            if covered <= place < len(data) - 4:
                read(wrong, layout)
            else:
                assert refused(wrong, layout, read) == "crc", place


FAULTS = {"length", "level", "crc", "number"}


@given(data=st.binary(max_size=900))
@settings(max_examples=examples(300), deadline=None)
def test_any_bytes_are_a_packet_or_an_error_with_its_fault(data):
    for layout in LAYOUTS.values():
        for read in (unpack, unpack_orders):
            assert fault_of(data, layout, read) in FAULTS | {None}


@BOTH
@given(noise=st.randoms(use_true_random=False))
@settings(max_examples=examples(30), deadline=None)
def test_any_fields_under_a_right_checksum_are_a_packet_or_an_error_with_its_fault(layout, noise):
    for length, read in zip(LENGTHS[layout.name], (unpack_orders, unpack), strict=True):
        data = sealed(layout.head + noise.randbytes(length - len(layout.head)))
        assert fault_of(data, layout, read) in {"number", None}


def fault_of(data, layout, read):
    try:
        read(data, layout)
    except WireError as error:
        return error.fault
    return None


def test_a_motor_that_is_off_gets_neither_gains_nor_torque():
    data = pack(Orders(*np.ones((5, 12))), A1)
    for mode in (0, 5):
        orders = unpack_orders(changed(data, 10 + 27 * 3, bytes([mode])), A1)
        assert (orders.kp[3], orders.kd[3], orders.tau[3]) == (0, 0, 0)
        assert orders.kp[2] == orders.tau[4] == 1


def test_an_angle_that_is_off_has_no_stiffness_and_a_speed_no_damping():
    q = np.array([POSITION_OFF, 1e9, *np.zeros(10)])
    orders = unpack_orders(pack(Orders(q, *np.ones((4, 12))), A1), A1)
    assert orders.kp.tolist() == [0, *[1] * 11]
    assert orders.kd.tolist() == orders.tau.tolist() == [1] * 12
    orders = unpack_orders(pack(Orders(np.zeros(12), q * 0 + SPEED_OFF, *np.ones((3, 12))), A1), A1)
    assert orders.kd.tolist() == [0] * 12
    assert orders.kp.tolist() == [1] * 12


def test_torques_of_a_state_are_cut_to_their_field():
    reading = still()._replace(tau=np.array([500.0, -500.0] * 6))
    assert unpack(pack_reading(reading, A1), A1).tau.tolist() == [32767 / 256, -128.0] * 6


@BOTH
def test_a_packet_may_come_as_any_bytes(layout):
    data = pack_reading(still(7), layout)
    twice = np.repeat(np.frombuffer(data, "u1"), 2)
    for kind in (bytearray(data), memoryview(data), memoryview(twice)[::2]):
        assert unpack(kind, layout).tick == 7
    assert unpack_orders(memoryview(pack(Orders(*np.ones((5, 12))), layout)), layout).kp[0] == 1
    assert refused(memoryview(data[:-1]), layout) == "length"
    assert refused(memoryview(bytes(len(data))), layout) == "crc"


@pytest.mark.parametrize("field", Orders._fields)
@pytest.mark.parametrize("value", [10**400, 1j, None, "x"], ids=["10**400", "1j", "None", "x"])
def test_what_is_no_number_of_64_bits_is_refused(field, value):
    for row in ([0.0] * 11 + [value], np.array([0.0] * 11 + [value])):
        orders = Orders(*np.zeros((5, 12)))._replace(**{field: row})
        with pytest.raises(WireError):
            pack(orders, A1)
