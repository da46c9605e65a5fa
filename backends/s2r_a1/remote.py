"""Reads the buttons of the robot's remote control from the 40 bytes that come with every state.

Layout: 2 bytes of head, 16 bits of buttons, five axes; 24 bytes are used. Three presses stop the robot: R2 alone is
what published controllers stop by, L2 with B or with A what the factory's own firmware does.

Source: ``unitree_joystick.h`` of unitree_legged_sdk. That a remote that is off has an all-zero head is likely, and
to be checked on a robot. A robot that goes on to send the last bytes of a remote that is lost would hide the loss.
"""

from __future__ import annotations

from collections.abc import Iterable

SIZE = 40
"""A definition: bytes of the remote in a packet."""
BUTTONS = (
    "R1", "L1", "start", "select", "R2", "L2", "F1", "F2", "A", "B", "X", "Y", "up", "right", "down", "left",
)  # fmt: skip
"""A definition: the buttons, from the lowest bit on."""
STOPS = (("R2",), ("L2", "B"), ("L2", "A"))
"""A definition: buttons that, held together, stop the robot."""

HEAD = b"\x55\x51"
"""A level: head of a remote that is on, for twins; any but zero is taken for one."""

LOST = 1_000_000_000
"""A level [ns]: how long a remote that was on may have a head of zeros, until it is taken for lost; ours, nobody has
published one. Twice as long lets a robot walk on without its operator's stop for a second more."""


def mask(buttons: Iterable[str]) -> int:
    """Return the bits of some buttons."""
    return sum(1 << BUTTONS.index(name) for name in buttons)


_STOPS = tuple((" + ".join(buttons), mask(buttons)) for buttons in STOPS)


def seen(remote: bytes) -> bool:
    """Return whether a remote is on and in reach."""
    return remote[:2] != b"\0\0"


def lost(since: int) -> str | None:
    """Return a sentence about a remote that was on, and was last seen so long ago [ns], if it is lost."""
    if since < LOST:
        return None
    return f"the remote control, which was on, has been off or out of reach for {since / 1e9:.0f} s; switch it on"


def pressed(remote: bytes) -> frozenset[str]:
    """Return the names of the buttons that are held."""
    bits = int.from_bytes(remote[2:4], "little")
    return frozenset(name for place, name in enumerate(BUTTONS) if bits >> place & 1)


def stop(remote: bytes) -> str | None:
    """Return the press that asks for a stop, as "L2 + B", or None.

    A head of zeros does not hide it: a stop that is not meant costs a test, and one that is missed a robot.
    """
    bits = int.from_bytes(remote[2:4], "little")
    return next((name for name, wanted in _STOPS if bits & wanted == wanted), None) if bits else None


def packed(buttons: Iterable[str] = ()) -> bytes:
    """Return the bytes of a remote that is on, with these buttons held."""
    return HEAD + mask(buttons).to_bytes(2, "little") + bytes(SIZE - 4)
