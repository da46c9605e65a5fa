"""Judge whether a robot may go on, and what of a client's commands it may follow: pure functions.

Data: the newest reading of the robot, and counts of the state machine (:class:`CheckedQuantities`). A check returns the
reason for a stop, or None. ``states.RULES`` lists the checks of each state. The word of a check names the cause of a
stopped rollout.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from math import acos, inf, isfinite
from operator import le, mul
from typing import NamedTuple

import numpy as np

from s2r_a1 import remote
from s2r_a1.guard import leg
from s2r_a1.guard.limits import MS, ROUND, SECOND, Limits, Word
from s2r_a1.wire import CLOSED_LOOP, MOTORS, FloatArray, IntArray, MotorPacket, Orders, Reading

JOINTS = tuple(f"{side} {part}" for side in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf"))
"""A definition: names of the motors in the order of the wire."""

_ALL_CLOSED = np.full(MOTORS, CLOSED_LOOP, dtype=np.int64).tobytes()
_NO_ERROR = np.zeros(MOTORS, dtype=np.int64).tobytes()


class CheckedQuantities(NamedTuple):
    """The quantities that the checks judge; ``bad`` to ``strained`` as in :class:`s2r_a1.guard.states.GuardMemory`.

    Attributes:
        reading: newest valid reading.
        desired: (12,) reference angles of the guard's own motion [rad]; None during a client's motion.
        link: time since the newest valid reading [ns].
        client: time since the client's newest commands [ns]; 0 if none are due.
        late: time between the last two rounds of the guard [ns].
    """

    reading: Reading
    desired: FloatArray | None
    link: int
    bad: int
    client: int
    late: int
    power: int
    strong: IntArray
    strained: IntArray


class LimitCheck(NamedTuple):
    """One limit.

    Attributes:
        name: name in the table of limits.
        word: cause of the end of a rollout that it stops.
        find: returns the reason for a stop, or None.
        measures: whether it judges the reading; such a check waits in a round without one.
        covered: whether it passes every reading that is :func:`is_calm`.
    """

    name: str
    word: Word
    find: Callable[[Limits, CheckedQuantities], str | None]
    measures: bool = True
    covered: bool = False


def is_calm(limits: Limits, reading: Reading) -> bool:
    """Return whether a reading is possible, and so far from every limit that it passes all covered checks.

    Nearly all readings of a walk are calm, so one test replaces six checks.
    """
    # Numbers of Python: with cold caches, as in every round, arrays take twice the time.
    w, x, y, z = reading.quaternion.tolist()
    numbers = [w, x, y, z, *chain.from_iterable([row.tolist() for row in reading[1:7]])]
    least, most = limits.calm
    if not (all(map(le, least, numbers)) and all(map(le, numbers, most))):  # NaN is neither
        return False
    return bool(abs(w * w + x * x + y * y + z * z - 1.0) <= 2.0 * limits.norm)


def impossibility(limits: Limits, reading: Reading) -> str | None:
    """Return the reason why a reading is impossible for an intact robot, or None; NaN is impossible."""
    w, x, y, z = reading.quaternion.tolist()
    norm = w * w + x * x + y * y + z * z
    if not abs(norm - 1.0) <= 2.0 * limits.norm:
        return f"the attitude's quaternion has the norm {norm**0.5:.3g}, not 1"
    gyro, force = reading.gyro.tolist(), reading.accelerometer.tolist()
    if not max(map(abs, gyro)) <= limits.wild_turn or not isfinite(sum(gyro)):
        return f"the gyroscope reports {max(map(abs, gyro)):.3g} rad/s, which is beyond its range"
    if not isfinite(sum(force)):
        return "the accelerometer reports a number that is not finite"
    middle, inverse = limits.possible
    off = np.abs((reading.q - middle) * inverse)
    if not off.max() <= 1.0:
        joint = int(off.argmax())
        return f"the encoder of the {JOINTS[joint]} reports {reading.q[joint]:.3g} rad, an impossible angle"
    if not np.abs(reading.dq).max() <= limits.wild_speed:
        joint = int(np.abs(reading.dq).argmax())
        return (
            f"the encoder of the {JOINTS[joint]} reports {reading.dq[joint]:.3g} rad/s, an impossible speed"
        )
    if not reading.temperature.min() >= limits.cold:
        joint = int(reading.temperature.argmin())
        degrees = reading.temperature[joint]
        return f"the motor of the {JOINTS[joint]} reports {degrees:.0f} °C, an impossible temperature"
    return None


def power(reading: Reading) -> float:
    """Return Σ |dq · tau| of all motors [W], as in the vendor's protection."""
    watts: list[float] = list(map(mul, reading.dq.tolist(), reading.tau.tolist()))
    return sum(map(abs, watts))


def power_count(limits: Limits, count: int, watts: float) -> int:
    """Return the vendor's count of power after one more reading: up by one above the level's power, else down by one.

    Source: observed behaviour of ``Safety.PowerProtect`` in the vendor's compiled library: levels 1 to 10 are 100 to
    1000 W, and other levels are the nearest of these.
    """
    return count + 1 if watts > limits.watts else max(count - 1, 0)


def is_allowed(limits: Limits, command: MotorPacket) -> bool:
    """Return whether a client's command may be passed on unchanged: :func:`clip` would change nothing in it."""
    least, most = limits.allowed
    numbers = [*command.q, *command.dq, *command.tau, *command.kp, *command.kd]
    return all(map(le, least, numbers)) and all(map(le, numbers, most)) and command.plain()


def clip(limits: Limits, orders: Orders) -> tuple[Orders, int] | None:
    """Return a client's commands within the limits, and the number of clipped values.

    None if a number is not finite or a gain is negative. A speed beyond the joint's limit switches the speed loop off:
    the motor's kd is 0, as with the vendor's ``VelStopF``.
    """
    flat = np.concatenate(orders)
    least, most = limits.ordered
    if ((flat >= least) & (flat <= most)).all():  # as nearly always, in a third of the time
        return orders, 0
    if not np.isfinite(flat).all() or orders.kp.min() < 0.0 or orders.kd.min() < 0.0:
        return None
    low, high = limits.span
    fast = np.abs(orders.dq) > limits.speed
    within = Orders(
        q=np.clip(orders.q, low, high),
        dq=np.where(fast, 0.0, orders.dq),
        kp=np.minimum(orders.kp, limits.kp),
        kd=np.where(fast, 0.0, np.minimum(orders.kd, limits.kd)),
        tau=np.clip(orders.tau, -limits.torque, limits.torque),
    )
    # With a gain of 0 the angle or speed has no effect, and programs may leave any number there.
    beyond = (
        (within.q != orders.q) & (orders.kp > 0.0),
        within.kp != orders.kp,
        within.kd != orders.kd,
        within.tau != orders.tau,
    )
    return within, int(np.count_nonzero(beyond))


def _link(limits: Limits, checked: CheckedQuantities) -> str | None:
    if checked.link >= limits.silence:
        return f"the robot has sent no new state for {checked.link / MS:.0f} ms"
    return None


def _absent(limits: Limits, checked: CheckedQuantities) -> str | None:
    if checked.link >= limits.absence:
        return f"the robot has sent no new state for {checked.link / SECOND:.1f} s"
    return None


def _numbers(limits: Limits, checked: CheckedQuantities) -> str | None:
    return "two states in a row had impossible numbers" if checked.bad >= 2 else None


def _client(limits: Limits, checked: CheckedQuantities) -> str | None:
    if checked.client >= limits.silence:
        return f"the program that moves the robot has sent no valid command for {checked.client / MS:.0f} ms"
    return None


def _guard_delay(limits: Limits, checked: CheckedQuantities) -> str | None:
    if checked.late >= limits.silence:
        return f"the guard itself was delayed by {checked.late / MS:.0f} ms; run no other programs on its machine"
    return None


def _button(limits: Limits, checked: CheckedQuantities) -> str | None:
    pressed = remote.stop(checked.reading.remote)
    return f"{pressed} was pressed on the remote control" if pressed else None


def _motor(limits: Limits, checked: CheckedQuantities) -> str | None:
    mode, error = checked.reading.mode, checked.reading.error
    # Bytes compare in a tenth of the time that arrays take.
    if mode.tobytes() != _ALL_CLOSED:
        joint = int(np.argmax(mode != CLOSED_LOOP))
        return f"the motor of the {JOINTS[joint]} is in mode {mode[joint]}, not {CLOSED_LOOP}, and follows no commands"
    if error.tobytes() != _NO_ERROR:
        joint = int(np.argmax(error != 0))
        return f"the motor of the {JOINTS[joint]} reports error {error[joint]}"
    return None


def _too_hot(limit: float, checked: CheckedQuantities) -> str | None:
    temperature = checked.reading.temperature
    if temperature.max() < limit:
        return None
    joint = int(np.argmax(temperature))
    return f"the motor of the {JOINTS[joint]} is at {temperature[joint]:.0f} °C; the limit is {limit:.0f} °C"


def _torque(limits: Limits, checked: CheckedQuantities) -> str | None:
    if checked.strong.max() < limits.torque_rounds:
        return None
    joint = int(np.argmax(checked.strong))
    return (
        f"the torque of the {JOINTS[joint]} is {checked.reading.tau[joint]:.1f} N·m, beyond ±{limits.torque:g} N·m, "
        f"in {limits.torque_rounds} states in a row"
    )


def _strain(limits: Limits, checked: CheckedQuantities) -> str | None:
    if checked.strained.max() * ROUND < limits.strain_time:
        return None
    joint = int(np.argmax(checked.strained))
    return f"the torque of the {JOINTS[joint]} has exceeded {limits.strain:g} N·m for {limits.strain_time / SECOND:g} s"


def _power(limits: Limits, checked: CheckedQuantities) -> str | None:
    if checked.power < limits.power_rounds:
        return None
    watts = power(checked.reading)
    return f"the motors take {watts:.0f} W; level {limits.power_level} of 10 allows {limits.watts:.0f} W"


def _joints(limits: Limits, checked: CheckedQuantities) -> str | None:
    q = checked.reading.q
    middle, inverse = limits.kept
    off = np.abs((q - middle) * inverse)
    if off.max() <= 1.0:
        return None
    joint = int(off.argmax())
    bound = (limits.lowest if q[joint] < middle[joint] else limits.highest)[joint % 3]
    return f"the {JOINTS[joint]} is at {q[joint]:.2f} rad, within {limits.margin:g} rad of its limit of {bound:.2f} rad"


def _deviation(limits: Limits, checked: CheckedQuantities) -> str | None:
    if checked.desired is None:
        return None
    off = np.abs(checked.reading.q - checked.desired)
    if off.max() <= limits.deviation:
        return None
    joint = int(off.argmax())
    return (
        f"the {JOINTS[joint]} is {off[joint]:.2f} rad from where it should be; "
        "check what holds it, and whether its motor is weak"
    )


def _tilt(limits: Limits, checked: CheckedQuantities) -> str | None:
    _, x, y, _ = checked.reading.quaternion.tolist()
    upright = 1.0 - 2.0 * (x * x + y * y)
    if upright >= limits.upright:
        return None
    return f"the base is tilted by {acos(max(upright, -1.0)):.2f} rad; the limit is {limits.tilt:g} rad"


def _height(limits: Limits, checked: CheckedQuantities) -> str | None:
    highest = -inf
    for height in leg.heights(limits.legs, checked.reading.q.tolist(), checked.reading.quaternion.tolist()):
        if height >= limits.height:  # mostly the first foot, and one is enough
            return None
        highest = max(highest, height)
    return f"the base is {highest:.2f} m over the lowest foot; the limit is {limits.height:g} m"


LINK = LimitCheck("link", "link", _link, measures=False)
ABSENT = LimitCheck("absence", "link", _absent, measures=False)
NUMBERS = LimitCheck("numbers", "link", _numbers, measures=False)
CLIENT = LimitCheck("client", "client", _client, measures=False)
HELD_UP = LimitCheck("guard", "link", _guard_delay, measures=False)
BUTTON = LimitCheck("button", "operator", _button)
MOTOR = LimitCheck("motor", "motor", _motor)
HEAT = LimitCheck("heat", "heat", lambda limits, checked: _too_hot(limits.hot, checked), covered=True)
WARMTH = LimitCheck("warmth", "heat", lambda limits, checked: _too_hot(limits.warm, checked), covered=True)
TORQUE = LimitCheck("torque", "torque", _torque, covered=True)
STRAIN = LimitCheck("strain", "torque", _strain, covered=True)
POWER = LimitCheck("power", "power", _power)
JOINT = LimitCheck("joint", "joint", _joints, covered=True)
DEVIATION = LimitCheck("deviation", "joint", _deviation)
TILT = LimitCheck("tilt", "fall", _tilt, covered=True)
HEIGHT = LimitCheck("height", "fall", _height)
