"""One rollout of a robot: attach to its guard, record, walk, bring it to rest, and make a trace of the recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, closing, suppress
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from s2r_a1 import mocap, recording
from s2r_a1.client import Client
from s2r_a1.guard.limits import ROBOT_WORDS
from s2r_a1.guard.place import folder
from s2r_a1.mocap import Gyro, Listener, MocapError
from s2r_a1.pilot import Pilot
from s2r_a1.rawlog import SUFFIX
from s2r_a1.schedule import Schedule
from s2r_a1.ticks import SECONDS
from s2r_a1.undisturbed import undisturbed
from s2r_a1.walk import Walked, rest, walk
from s2r_sim.controller.gains import RATE
from s2r_sim.plant.recorder import yaw_rate
from s2r_sim.robot.signals import RobotState, VelocityCommand
from s2r_sim.settings import Settings
from s2r_spec.backend import Channel
from s2r_spec.errors import BackendError, NotBegunError, TraceError
from s2r_spec.trace import Trace

if TYPE_CHECKING:
    from s2r_a1.backend import A1Backend


@cache
def pilot() -> Pilot:
    """Return this process's pilot, with compiled code."""
    pilot = Pilot(Settings())
    pilot.practise()
    return pilot


def run(backend: A1Backend, test: Mapping[str, float], seed: int) -> Trace:
    """Run one test, and return its trace; see :meth:`s2r_a1.backend.A1Backend.rollout`.

    Raises:
        NotBegunError: the test ended before t = 0.
    """
    own = pilot()  # before the first request to the guard, which would take seconds of compiling for silence
    command = VelocityCommand(test["vd"], test["vy"], test["wz"])
    schedule = Schedule.of(command, seed, round(backend.duration * RATE), own.settings.gains)
    about = about_run(backend, seed)
    client, walked, path = carry_out(
        backend,
        about,
        recording.header_of(test, schedule, {}),
        lambda client: walk(client, own, schedule, client.ready, backend.begins),
        backend.reached.mocap,
    )
    try:
        trace = recording.trace_of(path, walked.notes, own)
    except TraceError as error:
        trace = lost_trace(backend.channels, about | {"params": dict(test)}, str(error))
    else:
        if client.mocap is not None:
            trace = _with_velocity(trace, walked, client.mocap, backend.placing, client)
    return ended_trace(trace, walked, schedule.hold, path)


def about_run(backend: A1Backend, seed: int) -> dict[str, Any]:
    """Return the facts on a run that its recording and its trace keep."""
    return {
        "backend": backend.name,
        "model_hash": backend.model_hash,
        "seed": seed,
        "begun": datetime.now(UTC).isoformat(timespec="seconds"),
        "twin": backend.reached.is_twin,
    }


def carry_out(
    backend: A1Backend,
    about: dict[str, Any],
    header: Mapping[str, Any],
    move: Callable[[Client], Walked],
    mocap: int | None = None,
) -> tuple[Client, Walked, Path]:
    """Attach to the robot's guard, move while it records, and bring the robot to rest; return its recording, too.

    A robot without an operator stays standing. The header of the recording is ``about`` and ``header``; layout and
    clock of the robot are added to ``about``. Poses are received at the UDP port ``mocap``, if any.

    Raises:
        NotBegunError: the guard, the port or the file cannot be used, or the motion did not begin.
    """
    stays = backend.reached.operator == "auto"
    with ExitStack() as stack:
        try:
            client = stack.enter_context(closing(Client(backend.reached, mocap)))
            about |= {"layout": client.layout, "tick_unit": client.unit}
            path = new_path(backend.folder, about["seed"])
            client.record(path, {**about, **header})
        except BackendError as error:
            raise NotBegunError(str(error)) from None
        try:
            with undisturbed(first=not client.lockstep):
                walked = move(client)
        except BackendError as error:
            stays = False
            raise NotBegunError(str(error)) from None
        finally:
            with suppress(BackendError):
                client.request("stop_recording")
            with suppress(BackendError):
                if stays:
                    client.request("leave")
                else:
                    rest(client)
    return client, walked, path


def new_path(kept: str | None, seed: int) -> Path:
    """Return the path of a new recording."""
    raw = folder() / "raw" if kept is None else Path(kept)
    raw.mkdir(parents=True, exist_ok=True)
    number = len(list(raw.glob(f"*{SUFFIX}")))
    while list(raw.glob(f"{number:04d}-*{SUFFIX}")):
        number += 1
    return raw / f"{number:04d}-seed{seed}{SUFFIX}"


def _with_velocity(
    trace: Trace, walked: Walked, listener: Listener, placing: mocap.Placing, client: Client
) -> Trace:
    """Return the trace with the velocity by motion capture; if there is none, the trace is void, with NaN for it."""
    second = SECONDS[client.unit]
    first = next(note for note in walked.notes if note.tick >= 0)
    states = RobotState(np.array([note.state.flat for note in walked.notes]).T)
    gyro = Gyro(np.array([note.clock * second for note in walked.notes]), states.omega.T, yaw_rate(states))
    meta: dict[str, Any] = dict(trace.meta)
    channels = dict(trace.channels)
    try:
        velocity = mocap.velocity(
            listener.poses(), placing, gyro, trace.times - first.tick / RATE + first.clock * second
        )
    except MocapError as error:
        nothing = np.full(len(trace), np.nan)
        channels |= {"vx": nothing, "vy": nothing}
        meta |= {"void": "mocap", "reason": str(error)}
    else:
        channels |= {"vx": velocity.forward, "vy": velocity.left}
        aligned = {name: getattr(velocity, name) for name in ("offset", "correlation", "turned")}
        meta["mocap"] = {**aligned, "refused": listener.refused}
    return Trace(trace.times, channels, trace.units, meta)


def lost_trace(channels: Iterable[Channel], about: Mapping[str, Any], reason: str) -> Trace:
    """Return the placeholder for a run without a valid recording: one sample of NaN, void because of the disk."""
    nothing = {c.name: np.full((1, c.width) if c.width > 1 else 1, np.nan) for c in channels}
    units = {name: recording.UNITS[name] for name in nothing}
    return Trace(np.zeros(1), nothing, units, {**about, "void": "disk", "reason": reason})


def ended_trace(trace: Trace, walked: Walked, hold: int, path: Path) -> Trace:
    """Return the trace of a run with the cause of an early end and the name of its raw recording.

    ``hold`` is the last control tick of the test or protocol itself.

    An end by the robot counts even if its recording is lost. A test whose recording ends before it is void.
    """
    meta: dict[str, Any] = {**trace.meta, "raw": path.name}
    ending = walked.ending
    if ending is not None and walked.notes[-1].tick >= hold:
        meta["after"] = ending.word  # the test itself was over
        meta.setdefault("reason", ending.reason)
    elif ending is not None and ending.word in ROBOT_WORDS:
        meta |= {"failure": ending.word, "reason": ending.reason}
        meta.pop("void", None)
    elif ending is not None:
        meta |= {"void": ending.word or "operator", "reason": ending.reason}
    if not {"failure", "void"} & meta.keys() and round(trace.times[-1] * RATE) < hold:
        meta |= {
            "void": "disk",
            "reason": f"the recording ends {trace.times[-1]:g} s after the command, before the end of the test",
        }
    return Trace(trace.times, trace.channels, trace.units, meta)
