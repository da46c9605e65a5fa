"""The motors' response to commands, and to their absence, in a twin.

The behaviour of an A1 without commands is not published: sources mention a brake, free joints and damping. A twin does
one of the three after more than 30 ms without a valid command, and follows the next command again.
"""

from __future__ import annotations

from collections import deque
from typing import Literal

import numpy as np

from s2r_a1.wire import CLOSED_LOOP, MOTORS, FloatArray, MotorPacket, Orders

Silence = Literal["brake", "free", "damp"]

PATIENCE = 15
"""A level: rounds of 2 ms without a valid command before the rule for silence applies: 30 ms, the vendor's "safe
frequency" of 33 Hz."""
_ZERO = np.zeros(MOTORS)
_SILENT = {
    "damp": (_ZERO, np.full(MOTORS, 3.0)),
    "brake": (np.tile([60.0, 40.0, 80.0], 4), np.tile([5.0, 4.0, 7.0], 4)),
    "free": (_ZERO, _ZERO),
}
"""Levels [N·m/rad] and [N·m·s/rad]: gains of each rule for silence. ``damp`` is as the vendor's passive state, and
``brake`` holds the angles at its begin as the vendor's stand does. A real brake may be weaker; this one differs most
from the other two rules."""


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

    def take(self, round_: int, command: MotorPacket) -> None:
        """Accept a command that arrives in this round."""
        self.mode = np.array(command.mode, dtype=np.int64)
        self._last = round_
        self._queue.append((round_ + self._delay, command.orders()))

    def orders(self, round_: int, q: FloatArray) -> Orders:
        """Return the motors' commands in this round, at (12,) joint angles [rad]."""
        while self._queue and self._queue[0][0] <= round_:
            self._orders, self._silent = self._queue.popleft()[1], False
        if round_ - self._last > PATIENCE and not self._silent:
            self._orders, self._silent = Orders(q, _ZERO, *_SILENT[self._rule], _ZERO), True
        return self._orders
