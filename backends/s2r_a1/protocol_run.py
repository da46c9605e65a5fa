"""One run of a protocol on a robot: attach to its guard, record, play, bring it to rest, and make a trace."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from s2r_a1 import recording
from s2r_a1.channels import EXCITED
from s2r_a1.client import Client
from s2r_a1.excitation import REHEARSED, SHARES, Player, plan
from s2r_a1.protocols import height_in_rig
from s2r_a1.rollout import about_run, carry_out, ended_trace, lost_trace, pilot
from s2r_a1.schedule import Schedule
from s2r_a1.walk import Walked, move, walk
from s2r_sim.controller.gains import RATE
from s2r_sim.protocols.references import MOTIONS
from s2r_sim.robot.signals import VelocityCommand
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
    shares = () if key in _rehearsed else SHARES
    hold = round(MOTIONS[protocol].duration * RATE)
    about = about_run(backend, seed) | {PROTOCOL: protocol, "params": dict(values)}

    def play(client: Client) -> Walked:
        try:
            return _play(client, backend, protocol, values, shares)
        except BackendError as error:
            raise NotBegunError(f"{protocol} ended before its t = 0: {error}") from None

    _, walked, path = carry_out(backend, about, {"hold": hold}, play)
    try:
        trace = recording.protocol_trace(path, walked.notes)
    except TraceError as error:
        trace = lost_trace([c for c in backend.channels if c.name in EXCITED], about, str(error))
    if walked.ending is None:
        _rehearsed.add(key)
    return ended_trace(trace, walked, hold, path)


def _play(
    client: Client, backend: A1Backend, protocol: str, values: Mapping[str, float], shares: Sequence[float]
) -> Walked:
    """Play a protocol after rehearsals; raise NotBegunError if a rehearsal or the run ended before t = 0."""
    amplitude, gain = values["amplitude"], values["gain"]
    for share in shares:
        player = Player(plan(protocol, share * amplitude, gain, REHEARSED), client.unit)
        rehearsed = _move(client, protocol, player)
        if rehearsed.ending is not None:
            raise NotBegunError(f"in a rehearsal at {share:g} of the amplitude, {rehearsed.ending.reason}")
        client.send(None)  # the answer to the last reading
    return _move(client, protocol, Player(plan(protocol, amplitude, gain), client.unit), backend.begins)


def _move(client: Client, protocol: str, player: Player, begins: Callable[[], None] | None = None) -> Walked:
    """Move the robot once; on the ground it first trots in place.

    A robot that has stood up from its belly pushes its feet against each other, by up to the friction, and ``squeeze``
    leaves them outside. Steps in place put every foot under its hip.
    """
    if height_in_rig(protocol) is not None:
        return move(client, player, "excite_held", begins=begins)
    own = pilot()
    stepped = walk(client, own, Schedule.of(VelocityCommand(), 0, 0, own.settings.gains))
    if stepped.ending is not None:
        raise NotBegunError(f"while stepping in place, {stepped.ending.reason}")
    client.send(None)  # the answer to the last reading
    return move(client, player, "excite", begins=begins)
