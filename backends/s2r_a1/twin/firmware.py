"""What the motors of a twin do with the commands that arrive, and without them.

Nobody has published what an A1 does when commands stop: sources speak of a brake, of free joints and of damping.
A twin does one of the three, once no valid command came for more than 30 ms, and obeys the next one again.
"""

from __future__ import annotations

from collections import deque
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_a1.wire import CLOSED_LOOP, MOTORS, Layout, Orders, unpack_orders

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Silence = Literal["brake", "free", "damp"]

PATIENCE = 15
"""A level: rounds of 2 ms without a valid command, after which the motors are on their own: 30 ms, the vendor's
"safe frequency" of 33 Hz. Twice as many let a robot without commands go on for 60 ms."""
_ZERO = np.zeros(MOTORS)
_DAMPING = 3.0
"""A level: [N·m·s/rad] of the rule ``damp``, as the vendor's own passive state has it."""
_STIFFNESS, _BRAKE = np.tile([60.0, 40.0, 80.0], 4), np.tile([5.0, 4.0, 7.0], 4)
"""Levels: [N·m/rad] and [N·m·s/rad] of the rule ``brake``, which holds the angles of that moment; as the vendor's
own stand. A real brake may be weaker; this one differs most from the other two rules."""


class Command(NamedTuple):
    """A command that arrived: what the motors are to do, and their modes (12,)."""

    orders: Orders
    mode: IntArray


def read_command(data: bytes, layout: Layout) -> Command:
    """Return the command that a packet carries.

    Raises:
        WireError: the packet must not be used.
    """
    orders = unpack_orders(data, layout)
    motors = np.frombuffer(data, layout.command).reshape(())["motors"][:MOTORS]
    return Command(orders, motors["mode"].astype(np.int64))


class Firmware:
    """Keeps the last command, from its arrival over its way to the motors to the silence after it.

    Attributes:
        mode: (12,) modes that the motors report: those of the last command that arrived.
    """

    def __init__(self, delay: int, rule: Silence) -> None:
        self.mode = np.full(MOTORS, CLOSED_LOOP, dtype=np.int64)
        self._delay, self._rule = delay, rule
        self._under_way: deque[tuple[int, Orders]] = deque()
        self._orders = Orders(_ZERO, _ZERO, _ZERO, _ZERO, _ZERO)
        self._last = 0
        self._alone = False

    def take(self, round_: int, command: Command) -> None:
        """Note that a command arrived in this round."""
        self.mode = command.mode
        self._last = round_
        self._under_way.append((round_ + self._delay, command.orders))

    def orders(self, round_: int, q: FloatArray) -> Orders:
        """Return what the motors do in this round, at (12,) joint angles [rad]."""
        while self._under_way and self._under_way[0][0] <= round_:
            self._orders, self._alone = self._under_way.popleft()[1], False
        if round_ - self._last > PATIENCE and not self._alone:
            self._orders, self._alone = _alone(self._rule, q), True
        return self._orders


def _alone(rule: Silence, q: FloatArray) -> Orders:
    """Return what motors at (12,) angles do from the moment on at which commands stopped."""
    if rule == "brake":
        return Orders(q, _ZERO, _STIFFNESS, _BRAKE, _ZERO)
    damping = _DAMPING if rule == "damp" else 0.0
    return Orders(_ZERO, _ZERO, _ZERO, np.full(MOTORS, damping), _ZERO)
