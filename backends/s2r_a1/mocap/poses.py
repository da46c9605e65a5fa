"""Poses of a tracked body, as motion capture sends them, and the place of the body on the robot."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from s2r_a1.datagrams import open_port
from s2r_a1.wire import FloatArray
from s2r_spec.errors import BackendError, UsageError

FARTHEST = 1.0
"""A level [m]: largest distance of a body from the middle of the base of an A1, which is 0.6 m long."""
LARGEST = 65536
_NAMES = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")


class MocapError(BackendError):
    """Motion capture gives no velocity of a rollout; the message says why."""


@dataclass(frozen=True)
class Placing:
    """Pose, in base axes, of the tracked body: its origin [m], and the heading of its x axis to the left [deg]."""

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading: float = 0.0


class Poses(NamedTuple):
    """Poses from motion capture.

    Attributes:
        times: (n,) times on its own clock [s], increasing.
        arrived: (n,) times of arrival on the robot's clock [s].
        position: (n, 3) positions [m].
        quaternion: (n, 4) attitudes w, x, y, z.
    """

    times: FloatArray
    arrived: FloatArray
    position: FloatArray
    quaternion: FloatArray


class Listener:
    """Collects poses on a port of this computer; ``refused`` counts lines that are not poses."""

    def __init__(self, port: int) -> None:
        """Open the port; raise MocapError if it cannot be opened."""
        self.refused = 0
        self._rows: list[tuple[float, ...]] = []
        self._socket = open_port(("127.0.0.1", port), MocapError, "the UDP port {} for motion capture")

    @property
    def port(self) -> int:
        """The UDP port."""
        return int(self._socket.getsockname()[1])

    def take(self, now: float) -> None:
        """Collect the poses that have arrived by this time of the robot [s]."""
        while True:
            try:
                data = self._socket.recv(LARGEST)
            except OSError:
                return
            for line in data.splitlines():
                row = _row(line)
                if row is None:
                    self.refused += 1
                elif not self._rows or row[0] > self._rows[-1][0]:
                    self._rows.append((*row, now))

    def poses(self) -> Poses:
        """Return all poses so far."""
        rows = np.array(self._rows).reshape(-1, 9)
        return Poses(rows[:, 0], rows[:, 8], rows[:, 1:4], rows[:, 4:8])

    def close(self) -> None:
        """Release the port."""
        self._socket.close()


def _row(line: bytes) -> tuple[float, ...] | None:
    """Return the eight numbers of a line, or None if it is not a pose."""
    try:
        pose = json.loads(line)
        row = tuple(float(pose[name]) for name in _NAMES)
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    return row if np.isfinite(row).all() and abs(np.linalg.norm(row[4:]) - 1.0) < 0.01 else None


def read_placing(body: str | None, heading: str | None) -> Placing:
    """Read a placing from texts such as ``0.1:0:0.05`` and ``90``.

    Raises:
        UsageError: a text has another form, or a number is impossible.
    """
    placing = Placing()
    try:
        if body is not None:
            x, y, z = (float(part) for part in body.split(":"))
            placing = Placing((x, y, z))
        if heading is not None:
            placing = Placing(placing.position, float(heading))
    except ValueError:
        raise UsageError(
            "body=X:Y:Z is the tracked body's position in base axes [m], and heading=DEGREES its x axis, "
            "left of the robot's; for example body=0.1:0:0.05,heading=90"
        ) from None
    if not np.isfinite([*placing.position, placing.heading]).all():
        raise UsageError("body and heading must be finite numbers, as in body=0.1:0:0.05,heading=90")
    if max(map(abs, placing.position)) > FARTHEST:
        raise UsageError(
            f"body = {body!r} is {max(map(abs, placing.position)):g} m from the middle of the base, beyond the robot; "
            "write it in metres, as in body=0.1:0:0.05"
        )
    return placing
