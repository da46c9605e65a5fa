"""Makes a trace of what was recorded of a walk: every packet, both ways, as the guard wrote them.

What the robot measured, what it was sent and when come from the packets. What the controller made of it comes from
the worker's notes; where there are none, because the worker was killed, the controller decides again by the recorded
readings. In lock step that gives the same; in real time it takes readings into account that a late worker missed.
What ended a walk is not among the packets: the worker's own trace says it, and without one the guard's events do.

t = 0 is the control tick of the command. A sample's torque is the one that the next state reports, as in the
simulator: of the 2 ms after the sample.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_a1 import rawlog
from s2r_a1.channels import OWN, SHARED
from s2r_a1.datagrams import FROM_ROBOT, TO_ROBOT
from s2r_a1.guard.limits import ROBOT_WORDS
from s2r_a1.pilot import Note, Pilot
from s2r_a1.rawlog import RawLog
from s2r_a1.schedule import Schedule
from s2r_a1.ticks import elapsed
from s2r_a1.wire import LAYOUTS, Layout, Orders, Reading, WireError, unpack, unpack_orders
from s2r_sim.controller.gains import RATE
from s2r_sim.plant.physics import Physics
from s2r_sim.plant.recorder import Recorder
from s2r_sim.robot.figures import A1
from s2r_sim.robot.signals import Command
from s2r_sim.settings import Settings
from s2r_spec.errors import TraceError
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Velocity = tuple[FloatArray, FloatArray]
"""(n,) forward and (n,) left in the heading frame [m/s]."""


def header_of(test: Mapping[str, float], schedule: Schedule, about: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a recording must say of a walk so that its packets alone make a trace.

    Args:
        test: parameters of the test.
        schedule: of its control ticks.
        about: of the robot and the run: ``layout``, ``tick_unit``, and whatever a reader may want to know.
    """
    command = schedule.command._asdict()
    return {
        **about,
        "params": dict(test),
        "command": command,
        "trot": schedule.trot,
        "hold": schedule.hold,
    }


@dataclass(frozen=True, eq=False)
class Packets:
    """The packets of a recording that can be used, in order.

    Attributes:
        log: the recording.
    """

    log: RawLog

    @cached_property
    def layout(self) -> Layout:
        """Of the robot that was recorded."""
        return LAYOUTS[str(self.log.header["layout"]).lower()]

    @cached_property
    def readings(self) -> tuple[tuple[int, Reading], ...]:
        """(place, reading) of every state that is whole and newer than the one before."""
        found: list[tuple[int, Reading]] = []
        for place in np.flatnonzero(self.log.directions == FROM_ROBOT).tolist():
            try:
                reading = unpack(self.log.packets[place], self.layout)
            except WireError:
                continue
            if not found or elapsed(found[-1][1].tick, reading.tick) > 0:
                found.append((place, reading))
        return tuple(found)

    @cached_property
    def sent(self) -> tuple[tuple[int, Orders], ...]:
        """(place, orders) of every command that is whole."""
        found: list[tuple[int, Orders]] = []
        for place in np.flatnonzero(self.log.directions == TO_ROBOT).tolist():
            try:
                found.append((place, unpack_orders(self.log.packets[place], self.layout)))
            except WireError:
                continue
        return tuple(found)

    def walked(self) -> Iterator[Reading]:
        """Yield the readings from the one at which the walk began, up to what ended it.

        While a robot stands or lies, the guard holds its joints with gains and no torque. The controller's first
        orders are of four feet that stand: torques, and no gain on any angle.
        """
        begun = next((place for place, orders in self.sent if orders.tau.any() and not orders.kp.any()), None)
        if begun is None:
            return
        known = [place for place, _ in self.readings]
        first = max(0, int(np.searchsorted(known, begun)) - 1)
        ending = ending_of(self.log)
        for place, reading in self.readings[first:]:
            if ending and self.log.times[place] >= ending.time:
                return
            yield reading


class Ending(NamedTuple):
    """What ended a walk: the guard's word and sentence, and when [ns] it was damped, or asked to stop."""

    word: str
    reason: str
    time: int


def ending_of(log: RawLog) -> Ending | None:
    """Return what ended the walk of a recording before its time, as the guard says; None where it says nothing of it.

    Nothing is said of a walk that went as planned, of one whose guard was killed, and in recordings without events.
    """
    walks = [place for place, event in enumerate(log.events) if event.get("state") == "WALK"]
    asked: dict[str, Any] | None = None
    for event in log.events[walks[-1] + 1 :] if walks else ():
        if event.get("event") == "wanted" and asked is None:
            asked = event
        if event.get("event") == "state":
            if not event.get("word"):
                return None
            first = asked if asked and asked.get("word") == event["word"] else event
            return Ending(str(event["word"]), str(event.get("reason") or ""), first["time"])
    return Ending(str(asked["word"]), str(asked.get("reason") or ""), asked["time"]) if asked else None


def decided_again(packets: Packets, pilot: Pilot) -> list[Note]:
    """Return the notes that the controller makes of the recorded readings, up to the end of the test."""
    header = packets.log.header
    schedule = Schedule(Command(**header["command"]), int(header["trot"]), int(header["hold"]))
    pilot.begin(schedule, header["tick_unit"])
    notes = []
    for reading in packets.walked():
        notes.append(pilot.step(reading))
        if notes[-1].tick >= schedule.hold:
            break
    return notes


def channels_of(packets: Packets, notes: Sequence[Note]) -> dict[str, FloatArray]:
    """Return the samples at these notes of all channels but the true velocity.

    Raises:
        TraceError: the reading of a note was not recorded.
    """
    places = {reading.tick: i for i, (_, reading) in enumerate(packets.readings)}
    recorder = Recorder(A1, Physics(), Command())
    commanded = [place for place, _ in packets.sent]
    rows: dict[str, list[FloatArray]] = {
        name: [] for name in ("foot_force_raw", "motor_temperature", "tau_cmd")
    }
    for note in notes:
        at = places.get(note.clock)
        if at is None:
            raise TraceError(
                f"the raw recording has no state of the robot with the tick {note.clock}, which the worker saw; "
                "the disk may have been full"
            )
        place, reading = packets.readings[at]
        _, following = packets.readings[min(at + 1, len(packets.readings) - 1)]
        recorder.write(note.state, note.state, note.done, following.tau, np.zeros(12))
        rows["foot_force_raw"].append(reading.foot_force)
        rows["motor_temperature"].append(reading.temperature)
        order = int(np.searchsorted(commanded, place))
        sent = packets.sent[order][1] if order < len(commanded) else Orders(*note.done.motors)
        asked = sent.tau + sent.kp * (sent.q - reading.q) + sent.kd * (sent.dq - reading.dq)
        rows["tau_cmd"].append(asked)
    velocity = np.array([note.state.velocity for note in notes])
    own = recorder.channels(velocity, fallen=False)
    commands = np.array([note.command for note in notes]).T
    own |= dict(zip(("vx_cmd", "vy_cmd", "wz_cmd"), commands, strict=True))
    own |= {name: np.array(values) for name, values in rows.items()}
    own["late"] = np.array([float(note.late) for note in notes])
    return {name: own[name] for name in (*SHARED, *(channel.name for channel in OWN))}


def test_of(notes: Sequence[Note], hold: int) -> list[Note]:
    """Return the notes of the test itself: from t = 0 to its duration, or to the first tick after it."""
    found = []
    for note in notes:
        if note.tick >= 0:
            found.append(note)
        if note.tick >= hold:
            break
    return found


def trace_of(
    path: str | os.PathLike[str], notes: Sequence[Note] | None = None, pilot: Pilot | None = None
) -> Trace:
    """Return the trace of a recorded walk, with the robot's own estimate as its velocity.

    Args:
        path: of the raw recording.
        notes: the worker's; without them the controller decides again.
        pilot: that does so; a new one if there is none.

    Raises:
        TraceError: the recording cannot be read, or ends before t = 0.
    """
    packets = Packets(rawlog.read(path))
    header = packets.log.header
    missing = {"layout", "tick_unit", "command", "trot", "hold"} - header.keys()
    if missing:
        raise TraceError(
            f"{os.fspath(path)}: the header of the recording does not say {', '.join(sorted(missing))}; "
            "it is of no test"
        )
    again = notes is None
    if notes is None:
        notes = decided_again(packets, pilot or Pilot(Settings()))
    if not packets.log.finished:  # what the guard had not written yet when it was killed is gone
        written = {reading.tick for _, reading in packets.readings}
        notes = [note for note in notes if note.clock in written]
    notes = test_of(notes, int(header["hold"]))
    if not notes:
        raise TraceError(f"{os.fspath(path)}: the recording ends before the command, at t = 0")
    samples = channels_of(packets, notes)
    samples = {"vx": samples["vx_est"], "vy": samples["vy_est"], **samples}
    meta = {
        name: value for name, value in header.items() if name not in ("command", "trot", "hold", "limits")
    }
    if again:
        meta |= {"decided_again": True, **_ended(packets.log, over=notes[-1].tick >= int(header["hold"]))}
    meta["qp_failures"] = int(np.sum(samples["qp_solved"] == 0.0))
    meta["late"] = int(np.sum(samples["late"]))
    return Trace(np.array([note.tick for note in notes]) / RATE, samples, UNITS, meta)


def _ended(log: RawLog, over: bool) -> dict[str, Any]:
    """Return what the guard says of a walk's end: an outcome, a void walk, or what came after the test was over."""
    ending = ending_of(log)
    if ending is None:
        return {}
    kind = "after" if over else "failure" if ending.word in ROBOT_WORDS else "void"
    return {kind: ending.word, "reason": ending.reason}


def _units() -> dict[str, str]:
    from s2r_a1.channels import channels

    return {channel.name: channel.unit for channel in channels("")}


UNITS = _units()
"""Of the channels of a trace."""
