"""The network between a twin and its guard, which loses, delays, repeats or damages packets."""

from __future__ import annotations

import numpy as np

from s2r_a1.twin.injects import Injects, acting_faults


class Network:
    """A simulated link of one datagram per round.

    Without injected faults, datagrams arrive immediately and in order.
    """

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng([seed, 4])
        self._held: list[tuple[int, bytes]] = []
        self._behind: list[bytes] = []

    def hears(self, round_: int, injects: Injects) -> bool:
        """Return whether a command of this round reaches the robot."""
        return not self._happens(round_, injects, "deaf")

    def carry(self, round_: int, injects: Injects, data: bytes) -> list[bytes]:
        """Send these bytes in a round, and return the datagrams that arrive in it, in order of arrival."""
        behind, self._behind = self._behind, []
        delay = sum(int(inject.number) for inject in acting_faults(injects, round_, "delay"))
        if not any(acting_faults(injects, round_, "silence")) and not self._happens(round_, injects, "loss"):
            data = self._damaged(round_, injects, data)
            overtaken = self._happens(round_, injects, "reorder")
            if overtaken or self._happens(round_, injects, "duplicate"):
                self._behind.append(data)
            if not overtaken:
                self._held.append((round_ + delay, data))
        arrived = []
        # A queue without overtaking: all delayed datagrams arrive when the delay ends.
        while self._held and (self._held[0][0] <= round_ or delay == 0):
            arrived.append(self._held.pop(0)[1])
        return arrived + behind

    def _happens(self, round_: int, injects: Injects, kind: str) -> bool:
        """Draw for every fault of this kind whether it occurs; all are drawn, even if the first one occurs."""
        occurs = [self._random.random() < inject.number for inject in acting_faults(injects, round_, kind)]
        return any(occurs)

    def _damaged(self, round_: int, injects: Injects, data: bytes) -> bytes:
        if self._happens(round_, injects, "corrupt"):
            bits = bytearray(data)
            # In the words that the checksum covers, without the head and the last bytes.
            bits[int(self._random.integers(4, len(data) // 4 * 4 - 4))] ^= 1 << int(self._random.integers(8))
            data = bytes(bits)
        if self._happens(round_, injects, "short"):
            data = data[: int(self._random.integers(1, len(data)))]
        return data
