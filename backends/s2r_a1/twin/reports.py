"""Faults in the reported state of a twin."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from s2r_a1 import remote
from s2r_a1.ticks import SECONDS, TickUnit
from s2r_a1.twin.injects import REMOTE_OFF, Inject, Injects, acting_faults
from s2r_a1.wire import Layout, Reading, checksum, pack_reading
from s2r_sim.robot import rotation


def tick(round_: int, start: int, unit: TickUnit, injects: Injects) -> int:
    """Return the tick of a round's state: ``start`` [ms] plus 2 ms per round, in ``unit``.

    Faults can stop it, set it back, or change its unit.
    """
    for stuck in acting_faults(injects, round_, "stuck_tick"):
        round_ = min(round_, stuck.first - 1)
    milliseconds = start + 2 * (round_ + 1)
    for back in acting_faults(injects, round_, "back_tick"):
        milliseconds -= int(back.number)
    for other in acting_faults(injects, round_, "tick_unit"):
        unit = "us" if other.value == "us" else "ms"
    return round(milliseconds * 1e-3 / SECONDS[unit]) & 0xFFFFFFFF


def distort(reading: Reading, round_: int, injects: Injects) -> Reading:
    """Return the reading with the faults of this round."""
    for inject in acting_faults(injects, round_, *_REPORTS):
        reading = _REPORTS[inject.kind](reading, inject)
    return reading


def pack(reading: Reading, layout: Layout) -> bytes:
    """Return the packet of a state, with roll, pitch and yaw [rad] computed from its quaternion.

    :class:`Reading` has no such angles, because s2r reads the quaternion; other programs may read the angles.
    """
    data = bytearray(pack_reading(reading, layout))
    np.frombuffer(data, layout.state)["rpy"][0] = rotation.rpy_from_wxyz(*reading.quaternion.tolist())
    data[-4:] = checksum(bytes(data)).to_bytes(4, "little")
    return bytes(data)


def _nan(reading: Reading, inject: Inject) -> Reading:
    name = str(inject.value)
    values = getattr(reading, name).copy()
    values[0] = np.nan
    return reading._replace(**{name: values})


def _tilt(reading: Reading, inject: Inject) -> Reading:
    w, x, y, z = reading.quaternion.tolist()
    roll, pitch, yaw = rotation.rpy_from_wxyz(w, x, y, z)
    x, y, z, w = rotation.quaternion(roll + inject.number, pitch, yaw)
    return reading._replace(quaternion=np.array([w, x, y, z]))


def _button(reading: Reading, inject: Inject) -> Reading:
    names = str(inject.value).split("+")
    return reading._replace(remote=bytes(remote.SIZE) if REMOTE_OFF in names else remote.pack_buttons(names))


def _of_motors(field: str) -> Callable[[Reading, Inject], Reading]:
    def report(reading: Reading, inject: Inject) -> Reading:
        values = getattr(reading, field).copy()
        values[list(inject.per_motor.motors)] = inject.per_motor.number
        return reading._replace(**{field: values})

    return report


_REPORTS: dict[str, Callable[[Reading, Inject], Reading]] = {
    "nan": _nan,
    "quaternion": lambda reading, inject: reading._replace(quaternion=inject.number * reading.quaternion),
    "gyro": lambda reading, inject: reading._replace(gyro=np.array([inject.number, *reading.gyro[1:]])),
    "tilt": _tilt,
    "button": _button,
    "joint": _of_motors("q"),
    "speed": _of_motors("dq"),
    "torque": _of_motors("tau"),
    "heat": _of_motors("temperature"),
    "mode": _of_motors("mode"),
    "error": _of_motors("error"),
}
