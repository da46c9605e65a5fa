"""Make a trace from the raw recording of a walk: every packet in both directions, as the guard wrote them.

Measurements, commands and times come from the packets. The controller's internal values come from the worker's notes.
If the worker was killed and left none, the controller runs again on the recorded readings. In lock step this gives the
same values; in real time it also uses readings that a late worker missed. The cause of a walk's end is in the worker's
own trace, or else in the guard's events.

t = 0 is the control tick of the command. The torque of a sample is the one that the next state reports, as in the
simulator: the torque in the 2 ms after the sample.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np

from s2r_a1 import rawlog
from s2r_a1.channels import EXCITED, OWN, SHARED, channels
from s2r_a1.datagrams import FROM_ROBOT, TO_ROBOT
from s2r_a1.guard.limits import ROBOT_WORDS
from s2r_a1.pilot import Note, Pilot
from s2r_a1.rawlog import RawLog
from s2r_a1.schedule import Schedule
from s2r_a1.ticks import elapsed_ticks
from s2r_a1.wire import LAYOUTS, FloatArray, Layout, Orders, Reading, WireError, unpack, unpack_orders
from s2r_sim.controller.gains import RATE
from s2r_sim.plant.physics import Physics
from s2r_sim.plant.recorder import Recorder
from s2r_sim.robot.constants import A1
from s2r_sim.robot.signals import VelocityCommand
from s2r_sim.settings import Settings
from s2r_spec.errors import TraceError
from s2r_spec.trace import Trace

Content = TypeVar("Content")


def header_of(test: Mapping[str, float], schedule: Schedule, about: Mapping[str, Any]) -> dict[str, Any]:
    """Return the header of a recording, with which its packets alone make a trace.

    ``about`` has facts on robot and run: ``layout``, ``tick_unit``, and others for a reader.
    """
    plan = {"command": schedule.command._asdict(), "trot": schedule.trot, "hold": schedule.hold}
    return {**about, "params": dict(test), **plan}


@dataclass(frozen=True, eq=False)
class Packets:
    """The valid packets of a recording, in order."""

    log: RawLog

    @cached_property
    def layout(self) -> Layout:
        """Layout of the recorded packets."""
        return LAYOUTS[str(self.log.header["layout"]).lower()]

    @cached_property
    def readings(self) -> tuple[tuple[int, Reading], ...]:
        """(index, reading) of every valid state that is newer than the one before."""
        readings: list[tuple[int, Reading]] = []
        for place, reading in self._valid(FROM_ROBOT, unpack):
            if not readings or elapsed_ticks(readings[-1][1].tick, reading.tick) > 0:
                readings.append((place, reading))
        return tuple(readings)

    @cached_property
    def sent(self) -> tuple[tuple[int, Orders], ...]:
        """(index, orders) of every valid command."""
        return tuple(self._valid(TO_ROBOT, unpack_orders))

    def _valid(
        self, direction: int, decode: Callable[[bytes, Layout], Content]
    ) -> Iterator[tuple[int, Content]]:
        for place in np.flatnonzero(self.log.directions == direction).tolist():
            with suppress(WireError):
                yield place, decode(self.log.packets[place], self.layout)

    def walked(self) -> Iterator[Reading]:
        """Yield the readings from the beginning of the walk to its end.

        While the robot stands or lies, the guard holds its joints by gains without torques. The controller's first
        commands are torques without position gains, because four feet are on the ground.
        """
        begun = next((place for place, orders in self.sent if orders.tau.any() and not orders.kp.any()), None)
        if begun is None:
            return
        places = [place for place, _ in self.readings]
        first = max(0, int(np.searchsorted(places, begun)) - 1)
        ending = ending_of(self.log)
        for place, reading in self.readings[first:]:
            if ending and self.log.times[place] >= ending.time:
                return
            yield reading


class Ending(NamedTuple):
    """The end of a walk: the guard's word and reason, and the time [ns] of the damping or of the request to stop."""

    word: str
    reason: str
    time: int


def ending_of(log: RawLog) -> Ending | None:
    """Return the early end of a recorded walk by the guard's events; None if there is none.

    There is none if the walk went as planned, the guard was killed, or the recording has no events.
    """
    walks = [place for place, event in enumerate(log.events) if event.get("state") == "WALK"]
    request: dict[str, Any] | None = None
    for event in log.events[walks[-1] + 1 :] if walks else ():
        if event.get("event") == "wanted" and request is None:
            request = event
        if event.get("event") == "state":
            if not event.get("word"):
                return None
            first = request if request and request.get("word") == event["word"] else event
            return Ending(str(event["word"]), str(event.get("reason") or ""), first["time"])
    if request is None:
        return None
    return Ending(str(request["word"]), str(request.get("reason") or ""), request["time"])


def decided_again(packets: Packets, pilot: Pilot) -> list[Note]:
    """Run the controller again on the recorded readings, and return its notes up to the end of the test."""
    header = packets.log.header
    schedule = Schedule(VelocityCommand(**header["command"]), int(header["trot"]), int(header["hold"]))
    pilot.begin(schedule, header["tick_unit"])
    notes = []
    for reading in packets.walked():
        notes.append(pilot.step(reading))
        if is_last(notes[-1], notes, schedule.hold):
            break
    return notes


def is_last(note: Note, notes: Sequence[Note], hold: int) -> bool:
    """Return whether a note is the last of a test of ``hold`` control ticks.

    If the first states after the command were lost, the test lasts as long from the first one that arrived.
    """
    return note.tick >= hold + next((one.tick for one in notes if one.tick >= 0), 0)


def channels_of(packets: Packets, notes: Sequence[Note]) -> dict[str, FloatArray]:
    """Return the samples of all channels but the true velocity; raise TraceError if a note's reading is missing."""
    places = {reading.tick: i for i, (_, reading) in enumerate(packets.readings)}
    recorder = Recorder(A1, Physics(), VelocityCommand())
    commanded = [place for place, _ in packets.sent]
    rows: dict[str, list[FloatArray]] = {"foot_force_raw": [], "motor_temperature": [], "tau_cmd": []}
    for note in notes:
        at = places.get(note.clock)
        if at is None:
            raise TraceError(
                f"the raw recording has no state with the tick {note.clock}, which the worker received; "
                "the disk may have been full"
            )
        place, reading = packets.readings[at]
        _, following = packets.readings[min(at + 1, len(packets.readings) - 1)]
        recorder.write(note.state, note.state, note.done, following.tau, np.zeros(12))
        rows["foot_force_raw"].append(reading.foot_force)
        rows["motor_temperature"].append(reading.temperature)
        order = int(np.searchsorted(commanded, place))
        sent = packets.sent[order][1] if order < len(commanded) else Orders(*note.done.motors)
        rows["tau_cmd"].append(sent.tau + sent.kp * (sent.q - reading.q) + sent.kd * (sent.dq - reading.dq))
    velocity = np.array([note.state.velocity for note in notes])
    own = recorder.channels(velocity, fallen=False)
    commands = np.array([note.command for note in notes]).T
    own |= dict(zip(("vx_cmd", "vy_cmd", "wz_cmd"), commands, strict=True))
    own |= {name: np.array(values) for name, values in rows.items()}
    own["late"] = np.array([float(note.late) for note in notes])
    return {name: own[name] for name in (*SHARED, *(channel.name for channel in OWN))}


def protocol_trace(path: str | os.PathLike[str], notes: Sequence[Note]) -> Trace:
    """Return the trace of a recorded run of a protocol, by the worker's notes.

    It has no velocity, since neither the robot's estimate nor the alignment of motion capture works without a gait.

    Raises:
        TraceError: the recording cannot be read, or ends before t = 0.
    """
    packets = Packets(rawlog.read(path))
    notes = _recorded(packets, notes)
    if not notes:
        raise TraceError(f"{os.fspath(path)}: the recording ends before the protocol, at t = 0")
    samples = channels_of(packets, notes)
    samples = {name: samples[name] for name in EXCITED}
    return _trace(notes, samples, {name: UNITS[name] for name in EXCITED}, _meta(packets))


def trace_of(
    path: str | os.PathLike[str], notes: Sequence[Note] | None = None, pilot: Pilot | None = None
) -> Trace:
    """Return the trace of a recorded walk, with the robot's own estimate as its velocity.

    Args:
        path: file of the raw recording.
        notes: the worker's notes; without them the controller runs again.
        pilot: pilot for this; None for a new one.

    Raises:
        TraceError: the recording cannot be read, or ends before t = 0.
    """
    packets = Packets(rawlog.read(path))
    header = packets.log.header
    missing = {"layout", "tick_unit", "command", "trot", "hold"} - header.keys()
    if missing:
        raise TraceError(
            f"{os.fspath(path)}: the header of the recording lacks {', '.join(sorted(missing))}; "
            "name the recording of a test"
        )
    again = notes is None
    notes = _recorded(packets, decided_again(packets, pilot or Pilot(Settings())) if notes is None else notes)
    if not notes:
        raise TraceError(f"{os.fspath(path)}: the recording ends before the command, at t = 0")
    samples = channels_of(packets, notes)
    samples = {"vx": samples["vx_est"], "vy": samples["vy_est"], **samples}
    meta = _meta(packets)
    if again:
        meta["decided_again"] = True
        if ending := ending_of(packets.log):
            over = notes[-1].tick >= int(header["hold"])
            kind = "after" if over else "failure" if ending.word in ROBOT_WORDS else "void"
            meta |= {kind: ending.word, "reason": ending.reason}
    meta["qp_failures"] = int(np.sum(samples["qp_solved"] == 0.0))
    return _trace(notes, samples, UNITS, meta)


def _meta(packets: Packets) -> dict[str, Any]:
    left_out = ("command", "trot", "hold", "limits")
    return {name: value for name, value in packets.log.header.items() if name not in left_out}


def _recorded(packets: Packets, notes: Sequence[Note]) -> list[Note]:
    """Return the recorded notes of the test itself: from t = 0 to its duration, or a little longer."""
    if not packets.log.finished:  # the guard was killed before it wrote the last packets
        written = {reading.tick for _, reading in packets.readings}
        notes = [note for note in notes if note.clock in written]
    hold = int(packets.log.header["hold"])
    last = next((place for place, note in enumerate(notes) if is_last(note, notes, hold)), len(notes))
    return [note for note in notes[: last + 1] if note.tick >= 0]


def _trace(
    notes: Sequence[Note], samples: dict[str, FloatArray], units: dict[str, str], meta: dict[str, Any]
) -> Trace:
    meta["late"] = int(np.sum(samples["late"]))
    return Trace(np.array([note.tick for note in notes]) / RATE, samples, units, meta)


UNITS = {channel.name: channel.unit for channel in channels("")}
"""Units of the channels of a trace."""
