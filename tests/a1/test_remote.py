"""The buttons of the remote control."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from s2r_a1 import remote
from s2r_a1.remote import BUTTONS, is_on, pack_buttons, pressed_buttons, stop


@given(held=st.frozensets(st.sampled_from(BUTTONS)))
def test_buttons_come_back(held):
    data = pack_buttons(held)
    assert len(data) == remote.SIZE
    assert pressed_buttons(data) == held
    assert is_on(data)


@pytest.mark.parametrize(
    ("button", "bits"), [("R1", 0x0001), ("R2", 0x0010), ("L2", 0x0020), ("left", 0x8000)]
)
def test_bits_are_the_vendor_s(button, bits):
    assert struct.unpack_from("<H", pack_buttons([button]), 2)[0] == bits


@given(held=st.frozensets(st.sampled_from(BUTTONS)))
def test_r2_and_l2_with_a_or_b_stop_the_robot_whatever_else_is_held(held):
    wanted = "R2" in held or ("L2" in held and held & {"A", "B"})
    assert bool(stop(pack_buttons(held))) == bool(wanted)


def test_a_stop_counts_without_a_head():
    assert stop(bytes(2) + struct.pack("<H", 0x0220) + bytes(36)) == "L2 + B"


def test_a_remote_that_is_off_is_not_seen_and_stops_nothing():
    assert not is_on(bytes(40))
    assert stop(bytes(40)) is None
    assert pressed_buttons(bytes(40)) == frozenset()
