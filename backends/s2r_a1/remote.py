"""Read the buttons of the robot's remote control from the 40 bytes in every state.

Layout: 2 bytes of head, 16 bits of buttons, five axes; 24 bytes are used. Three presses stop the robot: R2, as in
published controllers, and L2 with B or A, as in the factory's own firmware.

Source: ``unitree_joystick.h`` of unitree_legged_sdk. An all-zero head probably means that the remote is off; this must
be checked on a robot. A robot that repeats the last bytes of a lost remote would hide the loss.
"""

from __future__ import annotations

from collections.abc import Iterable

SIZE = 40
"""A definition: bytes of the remote control in a packet."""
BUTTONS = (
    "R1", "L1", "start", "select", "R2", "L2", "F1", "F2", "A", "B", "X", "Y", "up", "right", "down", "left",
)  # fmt: skip
"""A definition: the buttons, from the lowest bit."""
STOPS = (("R2",), ("L2", "B"), ("L2", "A"))
"""A definition: combinations of buttons that stop the robot."""

HEAD = b"\x55\x51"
"""A level: head of a remote that is on, for twins; any head other than zero counts as on."""

LOST = 1_000_000_000
"""A level [ns]: time with a head of zeros after which a remote that was on counts as lost; our figure, since none is
published."""


def mask(buttons: Iterable[str]) -> int:
    """Return the bits of some buttons."""
    return sum(1 << BUTTONS.index(name) for name in buttons)


_STOPS = tuple((" + ".join(buttons), mask(buttons)) for buttons in STOPS)


def is_on(remote: bytes) -> bool:
    """Return whether a remote is on and in reach."""
    return remote[:2] != b"\0\0"


def loss(since: int) -> str | None:
    """Return the reason why a remote last seen this long ago [ns] counts as lost; None if it does not."""
    if since < LOST:
        return None
    return f"the remote control has been off or out of reach for {since / 1e9:.0f} s; switch it on"


def pressed_buttons(remote: bytes) -> frozenset[str]:
    """Return the names of the buttons that are held."""
    bits = int.from_bytes(remote[2:4], "little")
    return frozenset(name for place, name in enumerate(BUTTONS) if bits >> place & 1)


def stop(remote: bytes) -> str | None:
    """Return the pressed combination that stops the robot, such as "L2 + B", or None.

    It counts even with a head of zeros: an unintended stop costs a test, and a missed one may cost a robot.
    """
    bits = int.from_bytes(remote[2:4], "little")
    return next((name for name, buttons in _STOPS if bits & buttons == buttons), None) if bits else None


def pack_buttons(buttons: Iterable[str] = ()) -> bytes:
    """Return the bytes of a remote that is on, with these buttons held."""
    return HEAD + mask(buttons).to_bytes(2, "little") + bytes(SIZE - 4)
