"""The motors' response to commands, and to their absence, in a twin.

The behaviour of an A1 without commands is not published: sources mention a brake, free joints and damping. The worst
is ``hold``, which keeps the last command with its torque. A twin does one of the four after more than 30 ms without a
valid command, and follows the next command again.
"""

from __future__ import annotations

from collections import deque
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_a1.wire import CLOSED_LOOP, MOTORS, Layout, Orders, unpack_orders

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Silence = Literal["brake", "free", "damp", "hold"]

PATIENCE = 15
"""A level: rounds of 2 ms without a valid command before the rule for silence applies: 30 ms, the vendor's "safe
frequency" of 33 Hz."""
_ZERO = np.zeros(MOTORS)
_DAMPING = 3.0
"""A level [N·m·s/rad]: speed gain of the rule ``damp``, as in the vendor's own passive state."""
_STIFFNESS, _BRAKE = np.tile([60.0, 40.0, 80.0], 4), np.tile([5.0, 4.0, 7.0], 4)
"""Levels [N·m/rad] and [N·m·s/rad]: gains of the rule ``brake``, which holds the present angles; as in the vendor's own
stand. A real brake may be weaker; this one differs most from the other two rules."""


class ReceivedCommand(NamedTuple):
    """A received command: motor commands, and modes (12,) of the motors."""

    orders: Orders
    mode: IntArray


def read_command(data: bytes, layout: Layout) -> ReceivedCommand:
    """Return the command in a packet.

    Raises:
        WireError: the packet is not valid.
    """
    orders = unpack_orders(data, layout)
    motors = np.frombuffer(data, layout.command).reshape(())["motors"][:MOTORS]
    return ReceivedCommand(orders, motors["mode"].astype(np.int64))


class Firmware:
    """Delays commands on their way to the motors, and applies the rule for silence.

    Attributes:
        mode: (12,) modes that the motors report: the modes of the last received command.
    """

    def __init__(self, delay: int, rule: Silence) -> None:
        self.mode = np.full(MOTORS, CLOSED_LOOP, dtype=np.int64)
        self._delay, self._rule = delay, rule
        self._queue: deque[tuple[int, Orders]] = deque()
        self._orders = Orders(_ZERO, _ZERO, _ZERO, _ZERO, _ZERO)
        self._last = 0
        self._silent = False

    def take(self, round_: int, command: ReceivedCommand) -> None:
        """Accept a command that arrives in this round."""
        self.mode = command.mode
        self._last = round_
        self._queue.append((round_ + self._delay, command.orders))

    def orders(self, round_: int, q: FloatArray) -> Orders:
        """Return the motors' commands in this round, at (12,) joint angles [rad]."""
        while self._queue and self._queue[0][0] <= round_:
            self._orders, self._silent = self._queue.popleft()[1], False
        if round_ - self._last > PATIENCE and not self._silent:
            self._orders, self._silent = _without_commands(self._rule, q, self._orders), True
        return self._orders


def _without_commands(rule: Silence, q: FloatArray, last: Orders) -> Orders:
    """Return the motors' commands after silence, for motors at (12,) angles [rad] when it began."""
    if rule == "hold":
        return last
    if rule == "brake":
        return Orders(q, _ZERO, _STIFFNESS, _BRAKE, _ZERO)
    damping = _DAMPING if rule == "damp" else 0.0
    return Orders(_ZERO, _ZERO, _ZERO, np.full(MOTORS, damping), _ZERO)
