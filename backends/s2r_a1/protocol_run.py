"""One run of a protocol on a robot: attach to its guard, record, play, bring it to rest, and make a trace."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from typing import TYPE_CHECKING

from s2r_a1 import recording
from s2r_a1.channels import EXCITED
from s2r_a1.client import Client
from s2r_a1.excitation import Player, plan
from s2r_a1.protocols import height_in_rig
from s2r_a1.rollout import about_run, carried_out, ended, fresh, lost, pilot
from s2r_a1.schedule import Schedule
from s2r_a1.walk import Walked, move, walk
from s2r_sim.controller.gains import RATE
from s2r_sim.protocols.references import MOTIONS
from s2r_sim.robot.signals import Command
from s2r_spec.errors import BackendError, NotBegunError, TraceError
from s2r_spec.protocols import PROTOCOL
from s2r_spec.trace import Trace

if TYPE_CHECKING:
    from s2r_a1.backend import A1Backend

_rehearsed: set[tuple[str, int, str, float]] = set()
"""Robot, protocol and gain of every complete run of this process."""


def run(backend: A1Backend, protocol: str, values: Mapping[str, float], seed: int) -> Trace:
    """Run a protocol, and return its trace; see :meth:`s2r_a1.backend.A1Backend.run`.

    Raises:
        NotBegunError: the run ended before t = 0.
    """
    pilot()  # before the first request to the guard, which would take seconds of compiling for silence
    key = (backend.reached.host, backend.reached.port, protocol, values["gain"])
    segments = plan(protocol, values["amplitude"], values["gain"], rehearse=key not in _rehearsed)
    hold = round(MOTIONS[protocol].duration * RATE)
    about = about_run(backend, seed) | {PROTOCOL: protocol, "params": dict(values)}
    with ExitStack() as stack:
        try:
            client = Client(backend.robot)
            stack.callback(client.close)
            about |= {"layout": client.layout, "tick_unit": client.unit}
            path = fresh(backend.folder, seed)
            client.record(path, {**about, "hold": hold})
        except BackendError as error:
            raise NotBegunError(str(error)) from None
        player = Player(segments, client.unit)
        try:
            walked = carried_out(client, backend, lambda: _played(client, backend, protocol, player))
        except NotBegunError as error:
            where = f"while {player.words}: " if player.words else ""
            raise NotBegunError(f"{protocol} ended before it began, {where}{error}") from None
    try:
        trace = recording.protocol_trace(path, walked.notes)
    except TraceError as error:
        trace = lost([c for c in backend.channels if c.name in EXCITED], about, str(error))
    if walked.ending is None:
        _rehearsed.add(key)
    return ended(trace, walked, hold, path)


def _played(client: Client, backend: A1Backend, protocol: str, player: Player) -> Walked:
    """Play a protocol; on the ground the robot first trots in place.

    A robot that has stood up from its belly pushes its feet against each other, by up to the friction. Steps in place
    put every foot under its hip.
    """
    if height_in_rig(protocol) is not None:
        return move(client, player, "excite_held", begins=backend.begins)
    own = pilot()
    stepped = walk(client, own, Schedule.of(Command(), 0, 0, own.settings.gains))
    if stepped.ending is not None:
        raise NotBegunError(f"while stepping in place: {stepped.ending.reason}")
    client.send(None)  # the answer to the last reading of the walk
    return move(client, player, "excite", begins=backend.begins)
