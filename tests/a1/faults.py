"""The table of faults: what happens to a robot that walks, and how it must end.

A fault is what a robot, a network, a program, a person or a machine can do: bytes that arrive or do not, requests, a
connection that ends, a disk. Each row is given to a :class:`~tests.a1.rig.Rig`, which then turns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from s2r_a1.guard.states import State
from tests.a1.rig import HELD, STAND_ON, Rig, raw

MOVING = (State.STANDING_UP, State.STAND, State.WALK, State.LYING_DOWN)
UPRIGHT = (State.STAND, State.WALK)
CLIENTS = (State.STANDING_UP, State.STAND, State.WALK)


@dataclass(frozen=True)
class Fault:
    """One row.

    Attributes:
        name: of the row.
        begins: gives the fault to a rig, from its next round on.
        rounds: with the fault until the condition is met: 1 is the first, 10 are 20 ms.
        word: what the rollout is said to have ended by.
        states: in which it must end so.
        wall: whether it is of interest how long it takes by the clock on the wall, and not only in rounds.
    """

    name: str
    begins: Callable[[Rig], object]
    rounds: int
    word: str
    states: tuple[State, ...] = (State.WALK,)
    wall: bool = False


def robot(*injects: str) -> Callable[[Rig], object]:
    return lambda rig: rig.inject(*injects)


def sends(data: bytes) -> Callable[[Rig], object]:
    return lambda rig: setattr(rig, "orders", data)


def asks(who: str, do: str, **fields: str) -> Callable[[Rig], object]:
    return lambda rig: getattr(rig, who).ask(do, **fields)


def every(rounds: int) -> Callable[[Rig], object]:
    """Return what lets the client send once in so many rounds."""

    def begins(rig: Rig) -> None:
        count = iter(range(10**6))
        rig.orders = lambda data: b"" if (next(count) + 1) % rounds else STAND_ON

    return begins


def wrong(data: bytes) -> bytes:
    """Return a packet whose checksum is that of another one."""
    return data[:100] + bytes([data[100] ^ 1]) + data[101:]


SILENCE = 10
"""Rounds of 2 ms until nothing that can be used is silence."""

DAMPED = (
    # The robot's side of the wire.
    Fault("silence", robot("silence"), SILENCE, "link", MOVING, wall=True),
    Fault("tick stands still", robot("stuck_tick"), SILENCE, "link", MOVING, wall=True),
    Fault("tick jumps back", robot("back_tick=1000"), SILENCE, "link"),
    Fault("tick jumps ahead", robot("back_tick=-1000"), SILENCE, "link"),
    Fault("tick changes its unit", robot("tick_unit=us"), SILENCE, "link"),
    Fault("states are corrupt", robot("corrupt"), SILENCE, "link", MOVING),
    Fault("states are cut off", robot("short"), SILENCE, "link"),
    Fault("quaternion NaN", robot("nan=quaternion"), 2, "link", MOVING),
    Fault("gyro NaN", robot("nan=gyro"), 2, "link"),
    Fault("accelerometer NaN", robot("nan=accelerometer"), 2, "link"),
    Fault("q NaN", robot("nan=q"), 2, "link", MOVING),
    Fault("dq NaN", robot("nan=dq"), 2, "link"),
    Fault("quaternion of norm 2", robot("quaternion=2"), 2, "link"),
    Fault("gyro of 100 rad/s", robot("gyro=100"), 2, "link"),
    Fault("q that cannot be", robot("joint=3:2.9"), 2, "link", MOVING),
    Fault("dq that cannot be", robot("speed=3:60"), 2, "link"),
    # The robot.
    Fault("motor in mode 8", robot("mode=4:8"), 1, "motor", MOVING),
    Fault("motor error 4", robot("error=4:4"), 1, "motor", MOVING, wall=True),
    Fault("motor of 60 °C", robot("heat=4:60"), 1, "heat", MOVING),
    Fault("torque of 34 N·m", robot("torque=4:34"), 3, "torque", MOVING),
    Fault("power of 600 W", robot("torque=4:30", "speed=4:20"), 6, "power", MOVING),
    Fault("joint within its margin", robot("joint=3:0.75"), 1, "joint", UPRIGHT),
    Fault("joint held back", robot("joint=4:2.2"), 1, "joint", (State.STAND,)),
    Fault("tilt of 0.6 rad", robot("tilt=0.6"), 1, "fall", MOVING, wall=True),
    Fault("low base", robot("joint=thigh:1.27", "joint=calf:-2.55"), 1, "fall", UPRIGHT),
    # Who moves it.
    Fault("client silent", sends(b""), SILENCE, "client", wall=True),
    Fault("client sends NaN", sends(raw(HELD, q=np.nan)), SILENCE, "client"),
    Fault("client sends Kp 2000 as the vendor wraps it", sends(raw(HELD, kp=-48 * 32)), SILENCE, "client"),
    Fault("client's Kd is negative", sends(raw(HELD, kd=-1)), SILENCE, "client"),
    Fault("client's checksum is wrong", sends(wrong(STAND_ON)), SILENCE, "client"),
    Fault("client sends zeros", sends(bytes(610)), SILENCE, "client"),
    Fault("client cuts off", sends(STAND_ON[:-1]), SILENCE, "client"),
    Fault("client at 40 Hz", every(12), SILENCE, "client"),
    Fault("client's connection ends", lambda rig: rig.client.close(), 1, "client", CLIENTS, wall=True),
    Fault("client asks for damping", asks("client", "damp"), 1, "client", MOVING),
    # Who watches it.
    Fault("operator's connection ends", lambda rig: rig.operator.close(), 1, "operator", CLIENTS),
    Fault("R2", robot("button=R2"), 1, "operator", MOVING, wall=True),
    Fault("L2 + B", robot("button=L2+B"), 1, "operator", MOVING),
    Fault("L2 + A", robot("button=L2+A"), 1, "operator", MOVING),
    Fault("second Ctrl-C", asks("operator", "damp", reason="Ctrl-C twice"), 1, "operator", MOVING, wall=True),
)  # fmt: skip
"""A definition: what ends in DAMPING, latched, at the latest in the round after its condition is met."""

UNHARMED = (
    ("one state in a hundred lost", robot("loss=0.01"), "lost"),
    ("one state in a hundred comes twice", robot("duplicate=0.01"), "backwards"),
    ("one state in a hundred is overtaken", robot("reorder=0.01"), "backwards"),
    ("one state in a hundred corrupt", robot("corrupt=0.01"), "corrupt"),
    ("one state in a hundred cut off", robot("short=0.01"), "corrupt"),
    ("one command in a hundred lost", robot("deaf=0.01"), None),
    ("0.1 s without a remote", robot("button=off"), None),
    ("18 ms of silence", lambda rig: rig.inject("silence", rounds=9), "late"),
    ("one state with NaN", lambda rig: rig.inject("nan=q", rounds=1), "numbers"),
    ("one state that cannot be", lambda rig: rig.inject("gyro=100", rounds=1), None),
    ("two states of 34 N·m", lambda rig: rig.inject("torque=4:34", rounds=2), None),
    ("five states of 600 W", lambda rig: rig.inject("torque=4:30", "speed=4:20", rounds=5), None),
    ("client at 50 Hz", every(10), None),
)  # fmt: skip
"""A definition: what a walk goes on through, and the counter of the guard that tells of it."""

CLIPPED = (
    ("tau 127", raw(HELD, tau=127 * 256), "tau", 33.5),
    ("tau −128", raw(HELD, tau=-128 * 256), "tau", -33.5),
    ("Kp 1000", raw(HELD, kp=1000 * 32), "kp", 100.0),
    ("Kd 2000", raw(HELD, kd=2000 * 16), "kd", 10.0),
    ("q beyond its limit", raw(HELD, q=9.0), "q", 4.19),
    ("q below its limit", raw(HELD, q=-9.0), "q", -1.05),
)
"""A definition: a client's order of motor 4, a thigh, and what the robot gets instead."""
