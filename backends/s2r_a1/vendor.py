"""Connect to a robot through the vendor's own Python module, if a user has one.

Two modules are in use. *Binding A* has a class ``RobotInterface`` with ``send_command`` of 60 numbers, five per motor
(q, kp, dq, kd, tau), and ``receive_observation``. *Binding B* has ``UDP``, ``LowCmd`` and ``LowState``.

A :class:`VendorLink` never uses the module's ``Safety``, which ends the calling process before the motors are damped.
It does not rely on the module for new states, because a dead link returns the last state again: only the robot's tick
shows a new one. All data pass through :mod:`s2r_a1.wire`, with the same checks.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from importlib import import_module
from typing import Any

import numpy as np

from s2r_a1 import wire
from s2r_a1.datagrams import FROM_ROBOT, TO_ROBOT, Address, LinkError, RealTimeSocket
from s2r_a1.link import Link
from s2r_a1.ticks import Counters
from s2r_a1.wire import Layout, MotorPacket, Orders, Reading

COMPILED_IN: Address = ("192.168.123.10", 8007)
"""A definition: the only robot that binding A can reach; its address is compiled in."""


class BindingA:
    """A module with a ``RobotInterface``."""

    def __init__(self, module: Any, peer: Address) -> None:
        """Open the module's socket; nothing is sent.

        Raises:
            LinkError: the module cannot reach this robot.
        """
        if peer != COMPILED_IN:
            raise LinkError(
                f"this module reaches {COMPILED_IN[0]}:{COMPILED_IN[1]} only, not {peer[0]}:{peer[1]}; "
                "leave module out to use the built-in wire protocol"
            )
        try:
            self._robot = module.RobotInterface(wire.LOW_LEVEL)
        except TypeError:  # older modules have the low level only
            self._robot = module.RobotInterface()

    def read(self) -> Any:
        """Return the vendor's ``LowState``; the last one again if no new one arrived."""
        return self._robot.receive_observation()

    def write(self, orders: Orders) -> None:
        """Send orders that fit their fields; the module clips angles to its own limits."""
        q, dq, kp, kd, tau = orders
        self._robot.send_command(np.stack((q, kp, dq, kd, tau), axis=1).ravel().tolist())


class BindingB:
    """A module with ``UDP``, ``LowCmd`` and ``LowState``."""

    def __init__(self, module: Any, layout: Layout, peer: Address, port: int) -> None:
        """Open the module's socket on a local port; nothing is sent."""
        self._state, self._command = module.LowState(), module.LowCmd()
        try:  # the newest module takes the lengths of the packets
            self._udp = module.UDP(port, *peer, layout.command.itemsize, layout.state.itemsize, -1)
        except TypeError:
            self._udp = module.UDP(wire.LOW_LEVEL, port, *peer)
        self._udp.InitCmdData(self._command)
        self._command.levelFlag = wire.LOW_LEVEL
        self._motors = self._command.motorCmd

    def read(self) -> Any:
        """Return the vendor's ``LowState``; the last one again if no new one arrived."""
        self._udp.Recv()
        self._udp.GetRecv(self._state)
        return self._state

    def write(self, orders: Orders) -> None:
        """Send orders that fit their fields."""
        for motor, q, dq, kp, kd, tau in zip(self._motors, *(row.tolist() for row in orders), strict=False):
            motor.mode = wire.CLOSED_LOOP
            motor.q, motor.dq, motor.Kp, motor.Kd, motor.tau = q, dq, kp, kd, tau
        self._udp.SetSend(self._command)
        self._udp.Send()


class VendorLink(Link):
    """A link over the vendor's module, in real time.

    An exception of the module counts as silence, or as a command that was not sent: the guard must survive it.
    ``packet`` is packed from the module's numbers.
    """

    def __init__(
        self, driver: BindingA | BindingB, layout: Layout, clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(layout, Counters())
        self._driver: BindingA | BindingB | None = driver
        self._clock = clock

    def read(self) -> Reading | None:
        """Return the module's state; None if it was returned before or is not valid."""
        self.packet, self.fault = b"", "silence"
        reading = self._fresh()
        self.counters.late += reading is None
        return reading

    def write(self, orders: Orders | MotorPacket) -> None:
        """Send orders to the motors; raise WireError if a number does not fit its field."""
        data = wire.pack(orders, self._layout)
        driver = self._opened()
        try:
            driver.write(wire.unpack_orders(data, self._layout))
        except Exception:
            self.counters.unsent += 1
            return
        if self.tap:
            self.tap(TO_ROBOT, data)

    def skip(self) -> None:
        """Send nothing: silence needs no packet in real time."""

    def fileno(self) -> None:
        """Return None, because the module hides its socket and must be polled."""

    def close(self) -> None:
        """Release the module's objects; the module then closes its socket."""
        self._driver = None

    def _opened(self) -> BindingA | BindingB:
        if self._driver is None:
            raise LinkError("this link is closed; open a new one")
        return self._driver

    def _fresh(self) -> Reading | None:
        driver = self._opened()
        try:
            state = driver.read()
            if not any(state.imu.quaternion):  # no state has arrived: the module's state is all zero
                return None
            raw = _to_reading(state)
        except Exception:
            return None
        self.counters.received += 1
        try:
            if not np.isfinite(raw.tau).all():  # the integer field of the packet would hide it
                raise wire.WireError("number", "a torque is not finite")
            self.packet = wire.pack_reading(raw, self._layout)
            reading = wire.unpack(self.packet, self._layout)
        except (ValueError, OverflowError):  # WireError is one
            self.counters.numbers += 1
            self.fault = "number"
            return None
        self.fault = self._ticks.judge(reading.tick, self._clock())
        if self.fault:
            return None
        if self.tap:
            self.tap(FROM_ROBOT, self.packet)
        return reading


def open_link(
    name: str, layout: Layout, peer: Address, port: int = 0, clock: Callable[[], float] = time.monotonic
) -> VendorLink:
    """Return a link over an installed module, such as "robot_interface", to a robot of a layout.

    ``port`` is the local one; 0 is any free one for binding B, and binding A has its own. The robot's ticks are
    measured against the ``clock`` [s].

    Raises:
        LinkError: there is no such module, it has neither binding, or it is not for this robot.
    """
    try:
        module = import_module(name)
    except Exception as error:  # third-party code may raise anything
        raise LinkError(f"the vendor's module {name!r} cannot be imported: {error}; leave it out") from None
    binding_a = hasattr(module, "RobotInterface")
    if not binding_a and not all(hasattr(module, part) for part in ("UDP", "LowCmd", "LowState")):
        raise LinkError(
            f"the module {name!r} has neither RobotInterface nor UDP, LowCmd and LowState; "
            "name the vendor's module, or leave it out"
        )
    if hasattr(getattr(module, "LowState", None), "bms") != (layout is wire.GO1):  # the battery is the Go1's
        raise LinkError(
            f"the fields of the module {name!r} do not fit the {layout.name}; "
            "name the module of this robot, or leave it out"
        )
    try:
        if binding_a:
            return VendorLink(BindingA(module, peer), layout, clock)
        with closing(RealTimeSocket("")) as free:
            port = port or free.port
        return VendorLink(BindingB(module, layout, peer, port), layout, clock)
    except LinkError:
        raise
    except Exception as error:
        raise LinkError(f"the module {name!r} cannot be opened: {error}; leave it out") from None


def _to_reading(state: Any) -> Reading:
    """Return the vendor's ``LowState`` as a reading."""
    motors = state.motorState[: wire.MOTORS]
    return Reading(
        quaternion=np.array(state.imu.quaternion, dtype=np.float64),
        gyro=np.array(state.imu.gyroscope, dtype=np.float64),
        accelerometer=np.array(state.imu.accelerometer, dtype=np.float64),
        q=np.array([motor.q for motor in motors], dtype=np.float64),
        dq=np.array([motor.dq for motor in motors], dtype=np.float64),
        tau=np.array([motor.tauEst for motor in motors], dtype=np.float64),
        temperature=np.array([motor.temperature for motor in motors], dtype=np.float64),
        mode=np.array([motor.mode for motor in motors], dtype=np.int64),
        tick=int(state.tick),
        remote=bytes(state.wirelessRemote),
        error=np.array([motor.reserve[0] for motor in motors], dtype=np.int64),
        foot_force=np.array(state.footForce, dtype=np.float64),
    )
