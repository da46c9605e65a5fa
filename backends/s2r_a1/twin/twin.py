"""A twin of the robot at the level of packets: commands in, states out, in rounds of 2 ms.

A twin is a pure function of its settings and of the received bytes: it reads no clock, opens nothing and draws all
random numbers from its seed.

    twin = Twin(TwinSettings(place="lab"))
    states = twin.round([command])      # datagrams received in this round -> datagrams that reach the sender
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from s2r_a1 import remote
from s2r_a1.ticks import TickUnit
from s2r_a1.twin.body import Body
from s2r_a1.twin.firmware import Firmware, Silence
from s2r_a1.twin.injects import Injects, acting_faults
from s2r_a1.twin.mocap import Mocap
from s2r_a1.twin.network import Network
from s2r_a1.twin.places import physics
from s2r_a1.twin.reports import distort, pack, tick
from s2r_a1.twin.start import write_start
from s2r_a1.wire import A1, FloatArray, Layout, MotorPacket, Orders, WireError, read_command
from s2r_sim.plant.noise import Noise
from s2r_sim.plant.plant import Saved
from s2r_sim.robot.signals import RobotState

LEAST_TICK, MOST_TICK = 10_000, 1_000_000
"""Levels [ms]: range of the robot's clock at the first command, drawn from the seed, because it need not start at 0."""


@dataclass(frozen=True)
class TwinSettings:
    """Settings of a twin.

    Attributes:
        place: environment, one of :data:`s2r_a1.twin.places.PLACES`.
        layout: layout of the packets.
        seed: seed of noise, random faults and initial clocks.
        delay: rounds from the arrival of a command to the motors, on top of the environment's own delay.
        noise: whether the sensors are noisy.
        silence: the motors' behaviour when commands stop.
        tick_unit: unit of the tick in a state.
        injects: faults.
        start: state of the plant at the first command; None for a robot that lies on its belly.
        rig: height of the base in a rig [m]; None for a robot on the ground.
    """

    place: str = "lab"
    layout: Layout = A1
    seed: int = 0
    delay: int = 1
    noise: bool = True
    silence: Silence = "damp"
    tick_unit: TickUnit = "ms"
    injects: Injects = ()
    start: Saved | None = None
    rig: float | None = None


@dataclass
class Counts:
    """Counts of packets sent to a twin: used, superseded in their round, lost, and refused by fault."""

    used: int = 0
    superseded: int = 0
    lost: int = 0
    refused: dict[str, int] = field(default_factory=dict)


class Twin:
    """The A1's plant of `s2r_sim` behind the A1's wire.

    ``injects`` are at first the faults of the settings, and may be replaced between rounds. ``rounds`` is 0 before the
    first valid command.
    """

    def __init__(self, settings: TwinSettings) -> None:
        self.settings = settings
        self.injects = settings.injects
        self.rounds = 0
        self.counts = Counts()
        seed = settings.seed
        noise = Noise() if settings.noise else Noise.off()
        self._body = Body(physics(settings.place), seed, noise, settings.start)
        if settings.rig is not None:
            self._body.put(settings.rig)
        self._firmware = Firmware(settings.delay, settings.silence)
        self._network = Network(seed)
        self._mocap = Mocap(seed)
        self._start_tick = int(np.random.default_rng([seed, 6]).integers(LEAST_TICK, MOST_TICK))

    @property
    def begun(self) -> bool:
        """Whether a valid command has arrived; before it a twin sends nothing, and no time passes."""
        return self.counts.used > 0

    @property
    def temperature(self) -> FloatArray:
        """(12,) true temperatures of the motors [°C]; a state reports whole degrees."""
        return self._body.temperature

    def truth(self) -> RobotState:
        """Return the true state of the robot, which no packet contains."""
        return self._body.truth()

    def saved(self) -> Saved:
        """Return the state of the plant, without sensors and temperatures, as a start for this or another twin."""
        return self._body.save()

    def put(self, rig: float | None) -> None:
        """Hang the robot into a rig at a height [m], or lay it onto its floor (None), between two rounds."""
        self._body.put(rig)

    def save(self, path: Path) -> None:
        """Write the state of the plant to a file; see :mod:`s2r_a1.twin.start`."""
        write_start(path, self.saved())

    def accepts(self, data: bytes) -> bool:
        """Return whether a datagram is a command that the robot would use."""
        try:
            read_command(data, self.settings.layout)
        except WireError:
            return False
        return True

    def round(self, arrived: Sequence[bytes]) -> list[bytes]:
        """Return the states that reach the sender in this round, in order of arrival.

        ``arrived`` are the datagrams that reach the robot in this round; the newest valid one counts, and an empty one
        means no packet.
        """
        newest = self._newest(arrived)
        if newest:
            self._firmware.take(self.rounds, newest)
        if not self.begun:
            return []
        state = self._step()
        arriving = self._network.carry(self.rounds, self.injects, state)
        self.rounds += 1
        return arriving

    def mocap(self) -> list[bytes]:
        """Return the lines of motion capture since the last call; call this after every round, or never."""
        return self._mocap.lines(self.rounds - 1, self.truth()) if self.begun else []

    def _newest(self, arrived: Sequence[bytes]) -> MotorPacket | None:
        newest = None
        for data in filter(None, arrived):
            if self.begun and not self._network.hears(self.rounds, self.injects):
                self.counts.lost += 1
                continue
            try:
                command = read_command(data, self.settings.layout)
            except WireError as error:
                refused = self.counts.refused
                refused[error.fault] = refused.get(error.fault, 0) + 1
            else:
                self.counts.superseded += newest is not None
                self.counts.used += newest is None
                newest = command
        return newest

    def _step(self) -> bytes:
        settings, injects, round_ = self.settings, self.injects, self.rounds
        orders = self._firmware.orders(round_, self.truth().q)
        push = np.zeros(3)
        for pushed in acting_faults(injects, round_, "push"):
            push[1] += pushed.number
        reading = self._body.step(_limp(orders, injects, round_), push)._replace(
            mode=self._firmware.mode,
            tick=tick(round_, self._start_tick, settings.tick_unit, injects),
            remote=remote.pack_buttons(),
        )
        return pack(distort(reading, round_, injects), settings.layout)


def _limp(orders: Orders, injects: Injects, round_: int) -> Orders:
    for dropped in acting_faults(injects, round_, "mode"):
        works = np.ones_like(orders.tau)
        works[list(dropped.per_motor.motors)] = 0.0
        orders = orders._replace(kp=works * orders.kp, kd=works * orders.kd, tau=works * orders.tau)
    return orders
