"""The packets of the robot's low-level interface, byte by byte.

A command goes to the robot every 2 ms, and a state comes back. Both are packed little-endian structures that end with
a CRC-32/MPEG-2 of their words. Two robots are supported: the A1 (610 and 771 bytes) and the Go1 (614 and 807 bytes).

Motors are in the order FR, FL, RR, RL, each hip, thigh, calf. Units: rad, rad/s, N·m, N·m/rad, N·m·s/rad.
Source: packets of the vendor's compiled library (unitree_legged_sdk v3.2 to v3.8.4), byte by byte; the two vectors
and the Go1's packets in ``tests/a1/test_wire.py``.
"""

from __future__ import annotations

import zlib
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from struct import Struct
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MOTORS = 12
"""A definition: motors of a quadruped. The packets have room for 20."""
CLOSED_LOOP = 0x0A
"""A definition: the mode of a motor that follows its commands; in a state any other mode is a fault."""
LOW_LEVEL = 0xFF
"""A definition: the level flag of a packet for the motors. Other levels control the vendor's own walking."""
POSITION_OFF = 2.146e9
"""A definition: a commanded angle [rad] that switches the position loop off (the vendor's ``PosStopF``)."""
SPEED_OFF = 16000.0
"""A definition: a commanded speed [rad/s] that switches the speed loop off (the vendor's ``VelStopF``)."""

KP, KD, TAU = 32.0, 16.0, 256.0
"""Definitions: counts of the fields per N·m/rad, N·m·s/rad, N·m."""
_SCALES = np.array([[KP], [KD], [TAU]])
_COUNTS = 32768.0  # of a 16-bit integer, on either side of 0
_BOUNDS = np.array(
    [[float(np.finfo(np.float32).max)]] * 2 + (_COUNTS / _SCALES).tolist()
)  # q, dq, kp, kd, tau

Fault = Literal["length", "level", "crc", "number"]
"""A wrong length, level or checksum of a packet, or a number that is not finite or does not fit its field."""


class WireError(ValueError):
    """A packet, or a number for a packet, is not valid; ``fault`` says which part of it."""

    def __init__(self, fault: Fault, sentence: str) -> None:
        super().__init__(sentence)
        self.fault: Fault = fault


class Orders(NamedTuple):
    """Commands for the twelve motors, each (12,): τ = tau + kp (q − q_measured) + kd (dq − dq_measured)."""

    q: FloatArray
    dq: FloatArray
    kp: FloatArray
    kd: FloatArray
    tau: FloatArray


class MotorPacket(NamedTuple):
    """A packet's commands for the twelve motors, in its own numbers: rad, rad/s, and counts of torques and gains."""

    data: bytes
    layout: Layout
    mode: tuple[int, ...]
    q: tuple[float, ...]
    dq: tuple[float, ...]
    tau: tuple[int, ...]
    kp: tuple[int, ...]
    kd: tuple[int, ...]

    def plain(self) -> bool:
        """Return whether the packet equals the one that :func:`pack` makes of its orders."""
        return self.mode == _ALL_CLOSED and self.layout.spare.unpack(self.data) == self.layout.nothing

    def orders(self) -> Orders:
        """Return the commands that the motors follow; see :func:`unpack_orders`."""
        numbers = np.array((self.q, self.dq, self.kp, self.kd, self.tau), dtype=np.float64)
        gains = numbers[2:]
        gains /= _SCALES
        orders = Orders(*numbers)
        if self.mode != _ALL_CLOSED:
            gains[:, np.array(self.mode) != CLOSED_LOOP] = 0.0
        if max(self.q) >= 0.99 * POSITION_OFF:
            orders.kp[orders.q >= 0.99 * POSITION_OFF] = 0.0
        if max(self.dq) >= 0.99 * SPEED_OFF:
            orders.kd[orders.dq >= 0.99 * SPEED_OFF] = 0.0
        return orders


class Reading(NamedTuple):
    """One state of the robot.

    Attributes:
        quaternion: (4,) attitude w, x, y, z.
        gyro: (3,) angular velocity in base axes [rad/s].
        accelerometer: (3,) specific force, base axes [m/s²]; +9.81 in z at rest.
        q: (12,) joint angles [rad].
        dq: (12,) joint speeds [rad/s].
        tau: (12,) torques that the motors report [N·m].
        temperature: (12,) temperatures of the motors [°C].
        mode: (12,) modes of the motors; see ``CLOSED_LOOP``.
        tick: the robot's clock, 32 bits; its unit is measured (:mod:`s2r_a1.ticks`).
        remote: the 40 bytes of the remote control.
        error: (12,) error words of the motors; 0 for no error.
        foot_force: (4,) raw counts of the foot sensors.
    """

    quaternion: FloatArray
    gyro: FloatArray
    accelerometer: FloatArray
    q: FloatArray
    dq: FloatArray
    tau: FloatArray
    temperature: FloatArray
    mode: IntArray
    tick: int
    remote: bytes = bytes(40)
    error: IntArray = np.zeros(MOTORS, dtype=np.int64)
    foot_force: FloatArray = np.zeros(4)


_ORDER = [
    ("mode", "u1"), ("q", "<f4"), ("dq", "<f4"), ("tau", "<i2"), ("kp", "<i2"), ("kd", "<i2"), ("reserve", "<u4", 3),
]  # fmt: skip
_STATE = [
    ("mode", "u1"), ("q", "<f4"), ("dq", "<f4"), ("ddq", "<i2"), ("tau", "<i2"), ("q_raw", "<f4"), ("dq_raw", "<f4"),
    ("ddq_raw", "<i2"), ("temperature", "i1"), ("error", "<u4"), ("reserve", "<u4"),
]  # fmt: skip
_IMU = [
    ("quaternion", "<f4", 4), ("gyro", "<f4", 3), ("accelerometer", "<f4", 3), ("rpy", "<f4", 3), ("heat", "i1"),
]  # fmt: skip
_FEET = [("foot_force", "<i2", 4), ("foot_force_estimate", "<i2", 4), ("tick", "<u4")]
_A1_HEAD = [("level", "u1"), ("version", "<u2"), ("robot", "<u2"), ("serial", "<u4"), ("bandwidth", "u1")]
_GO1_HEAD = [
    ("head", "u1", 2), ("level", "u1"), ("frame", "u1"), ("serial", "<u4", 2), ("version", "<u4", 2),
    ("bandwidth", "<u2"),
]  # fmt: skip
_REMOTE = [("remote", "u1", 40), ("spare", "<u4"), ("crc", "<u4")]


@dataclass(frozen=True, eq=False)
class Layout:
    """The fields of a robot's packets: packed types of command and state, and their ``head`` up to the level flag."""

    name: str
    command: np.dtype[Any]
    state: np.dtype[Any]
    head: bytes

    # A guard reads and writes packets 500 times per second, with cold caches each time: the standard library's
    # structures touch less memory than numpy's.

    @cached_property
    def orders(self) -> Struct:
        """Structure of each motor's mode, q, dq, tau, kp, kd in a command."""
        return _struct(self.command, motors=MOTORS * "Bffhhh12x")

    @cached_property
    def spare(self) -> Struct:
        """Structure of the other bytes of a command, up to its checksum."""
        start = int(self.command.fields["motors"][1])  # type: ignore[index]
        rest = self.command.itemsize - start - MOTORS * 27 - 4
        return Struct(f"<{start}s{MOTORS * '15x12s'}{rest}s4x")

    @cached_property
    def nothing(self) -> tuple[bytes, ...]:
        """The other bytes of a command that :func:`pack` makes."""
        fields: tuple[bytes, ...] = self.spare.unpack(bytes(self.command.itemsize))
        return (self.head + fields[0][len(self.head) :], *fields[1:])

    @cached_property
    def readings(self) -> Struct:
        """Structure of a state: IMU; each motor's mode, q, dq, tau, temperature, error; feet; tick; remote."""
        return _struct(
            self.state,
            quaternion="10f",
            motors=MOTORS * "Bff2xh10xbI4x",
            foot_force="4h",
            tick="I",
            remote="40s",
        )


def _struct(kind: np.dtype[Any], **fields: str) -> Struct:
    """Return a structure with some fields of a packed type, in order; it skips the bytes of other fields."""
    text, size = "<", 0
    for name, form in fields.items():
        start = int(kind.fields[name][1])  # type: ignore[index]
        text += f"{start - size}x{form}"
        size = Struct(text).size
    return Struct(f"{text}{kind.itemsize - size}x")


A1 = Layout(
    "A1",
    np.dtype([*_A1_HEAD, ("motors", _ORDER, 20), ("led", "u1", 12), *_REMOTE]),
    np.dtype([*_A1_HEAD, *_IMU, ("motors", _STATE, 20), *_FEET, *_REMOTE]),
    bytes([LOW_LEVEL]),
)
"""610 bytes to the robot, 771 from it."""
GO1 = Layout(
    "Go1",
    np.dtype([*_GO1_HEAD, ("motors", _ORDER, 20), ("battery", "u1", 4), *_REMOTE]),
    np.dtype([*_GO1_HEAD, *_IMU, ("motors", _STATE, 20), ("battery", "u1", 24), *_FEET, *_REMOTE]),
    bytes([0xFE, 0xEF, LOW_LEVEL]),
)
"""614 bytes to the robot, 807 from it."""
LAYOUTS = {"a1": A1, "go1": GO1}

_WORD = "I"  # of 4 bytes on every machine that Python 3.11 runs on
_ALL_CLOSED = (CLOSED_LOOP,) * MOTORS
_SOUND_MODES, _NO_ERRORS = np.full(MOTORS, CLOSED_LOOP, dtype=np.int64), np.zeros(MOTORS, dtype=np.int64)
for _shared in (_SOUND_MODES, _NO_ERRORS):  # all readings of sound motors share them
    _shared.setflags(write=False)
_MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def checksum(packet: bytes) -> int:
    """Return the CRC-32/MPEG-2 of all whole words of a packet but the last, each from its highest bit on.

    As on the robots, it does not cover the bytes between the last of these words and the CRC itself.
    """
    words = array(_WORD, packet[: len(packet) // 4 * 4 - 4])
    words.byteswap()
    # MPEG-2's polynomial is zlib's, but zlib begins at the lowest bit and inverts the result.
    inverted = zlib.crc32(words.tobytes().translate(_MIRRORED)) ^ 0xFFFFFFFF
    return int.from_bytes(inverted.to_bytes(4, "little").translate(_MIRRORED), "big")


def pack(orders: Orders | MotorPacket, layout: Layout) -> bytes:
    """Return the packet with these commands; a packed command stays unchanged.

    Counts are truncated towards zero, as in the vendor's library: a kd of 0.8 is sent as 0.75.

    Raises:
        WireError: a number is not finite or does not fit. The vendor's library wraps around instead: it sends a torque
            of 200 as −56 N·m.
    """
    if isinstance(orders, MotorPacket):
        return orders.data
    (q, dq), (kp, kd, tau) = _counts(orders)
    return _command((q, dq, tau, kp, kd), layout)


def unpack(data: bytes, layout: Layout) -> Reading:
    """Return the state in a packet; raise WireError if length, level, checksum or a number is not valid."""
    data = bytes(data)  # of any buffer
    _check(data, layout, layout.state)
    values = layout.readings.unpack(data)
    imu, motors = values[:10], values[10:-6]
    mode, q, dq, tau, temperature, error = (motors[place::6] for place in range(6))
    _check_finite("state", *imu, *q, *dq)
    numbers = np.array((*imu, *q, *dq, *tau, *temperature, *values[-6:-2]), dtype=np.float64)
    torques = numbers[34:46]
    torques /= TAU
    return Reading(
        quaternion=numbers[:4],
        gyro=numbers[4:7],
        accelerometer=numbers[7:10],
        q=numbers[10:22],
        dq=numbers[22:34],
        tau=torques,
        temperature=numbers[46:58],
        mode=_SOUND_MODES if mode == _ALL_CLOSED else np.array(mode, dtype=np.int64),
        tick=values[-2],
        remote=values[-1],
        error=np.array(error, dtype=np.int64) if any(error) else _NO_ERRORS,
        foot_force=numbers[58:],
    )


def unpack_orders(data: bytes, layout: Layout) -> Orders:
    """Return the commands that a robot's motors follow, the inverse of :func:`pack`; raise WireError as :func:`unpack`.

    A motor in any mode but ``CLOSED_LOOP`` has no gains and no torque. With an angle of ``POSITION_OFF`` its kp is
    0, and with a speed of ``SPEED_OFF`` its kd.
    """
    return read_command(data, layout).orders()


def read_command(data: bytes, layout: Layout) -> MotorPacket:
    """Return the commands of a packet in its own numbers; raise WireError as :func:`unpack`."""
    data = bytes(data)  # of any buffer
    _check(data, layout, layout.command)
    values = layout.orders.unpack(data)
    mode, q, dq, tau, kp, kd = (values[place::6] for place in range(6))
    _check_finite("command", *q, *dq)
    return MotorPacket(data, layout, mode, q, dq, tau, kp, kd)


def pack_reading(reading: Reading, layout: Layout) -> bytes:
    """Return the packet of a state: the inverse of :func:`unpack`.

    Torques saturate at the limits of their field. Numbers that are not finite are sent unchanged, so that a twin can
    send the data of a broken sensor.
    """
    packet = np.zeros((), layout.state)
    for name in ("quaternion", "gyro", "accelerometer"):
        packet[name] = getattr(reading, name)
    motors = packet["motors"][:MOTORS]
    motors["mode"] = reading.mode
    motors["q"] = motors["q_raw"] = reading.q
    motors["dq"] = motors["dq_raw"] = reading.dq
    motors["tau"] = np.clip(np.trunc(reading.tau * TAU), -_COUNTS, _COUNTS - 1)
    motors["temperature"] = reading.temperature
    motors["error"] = reading.error
    packet["foot_force"] = reading.foot_force
    packet["tick"] = reading.tick & 0xFFFFFFFF
    packet["remote"] = np.frombuffer(reading.remote, "u1")
    return _close(packet.tobytes(), layout)


def _counts(orders: Orders) -> tuple[list[list[float]], list[list[int]]]:
    """Return q and dq, and kp, kd and tau in counts; raise WireError if a number is not finite, or does not fit."""
    try:
        values = np.array(orders).astype(np.float64, casting="same_kind", copy=False)
    except (TypeError, ValueError):  # different shapes, or no numbers
        values = np.empty(0)
    if values.shape != (len(orders), MOTORS):
        for name, row in zip(Orders._fields, orders, strict=True):
            if np.shape(row) != (MOTORS,):
                raise WireError("number", f"{name} must have {MOTORS} numbers, not the shape {np.shape(row)}")
        raise WireError("number", "orders must be numbers")
    right = np.abs(values) < _BOUNDS
    if not right.all():
        field, motor = divmod(int(np.argmin(right)), MOTORS)
        raise WireError(
            "number",
            f"{Orders._fields[field]} of motor {motor} is {values[field, motor]:g}; "
            f"it must lie within ±{_BOUNDS[field, 0]:g}",
        )
    return values[:2].tolist(), (values[2:] * _SCALES).astype(np.int64).tolist()


def _command(rows: Iterable[Sequence[float]], layout: Layout) -> bytes:
    """Return the packet for twelve motors in closed loop, from q, dq, tau, kp and kd."""
    fields: list[Any] = [CLOSED_LOOP] * (6 * MOTORS)
    for place, row in enumerate(rows, 1):
        fields[place::6] = row
    return _close(layout.orders.pack(*fields), layout)


def _check_finite(what: str, *numbers: float) -> None:
    """Raise WireError if a number is not finite; the sum of a few finite 32-bit numbers is always finite."""
    if not isfinite(sum(numbers)):
        raise WireError("number", f"a {what} has a number that is not finite")


def _close(packet: bytes, layout: Layout) -> bytes:
    data = layout.head + packet[len(layout.head) :]
    return data[:-4] + checksum(data).to_bytes(4, "little")


def _check(data: bytes, layout: Layout, kind: np.dtype[Any]) -> None:
    if len(data) != kind.itemsize:
        raise WireError("length", f"a packet of the {layout.name} has {kind.itemsize} bytes, not {len(data)}")
    if data[-4:] != checksum(data).to_bytes(4, "little"):
        raise WireError("crc", f"the checksum of a packet of the {layout.name} is wrong")
    if not data.startswith(layout.head):
        raise WireError("level", f"a packet is not a low-level packet of the {layout.name}")
