"""The command line of a twin."""

from __future__ import annotations

import argparse
import ipaddress
from collections.abc import Callable
from math import nan
from pathlib import Path
from typing import NoReturn, get_args

from s2r_a1.guard.place import PORT, Clock
from s2r_a1.hands import HIGHEST, LOWEST
from s2r_a1.ticks import TickUnit
from s2r_a1.twin.firmware import Silence
from s2r_a1.twin.injects import KINDS, read_inject
from s2r_a1.twin.places import PLACES, physics
from s2r_a1.twin.start import read_start
from s2r_a1.twin.twin import TwinSettings
from s2r_a1.wire import LAYOUTS
from s2r_spec.errors import UsageError

_MOST_DELAY = 10
"""A budget: rounds from a command's arrival to the motors, 20 ms, longer than any published estimate for an A1."""


class _Parser(argparse.ArgumentParser):
    """A parser that raises a UsageError for a wrong command line."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}; see {self.prog} --help")


def read_options(arguments: list[str]) -> argparse.Namespace:
    """Read a command line; raise UsageError if an option is not valid.

    The options have the settings of the ``twin``, the ``address`` at which it listens, ``clock``, the port ``mocap``
    for its true pose or None, and the file ``record`` for all packets or None.
    """
    options = _parser().parse_args(arguments)
    physics(options.place)
    options.twin = TwinSettings(
        place=options.place,
        layout=LAYOUTS[options.layout],
        seed=options.seed,
        delay=options.delay,
        noise=options.noise == "on",
        silence=options.silence,
        tick_unit=options.tick,
        injects=tuple(read_inject(text) for text in options.inject),
        start=read_start(options.start) if options.start else None,
        rig=options.rig,
    )
    options.address = _loopback(options.host), options.port
    return options


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="python -m s2r_a1.twin",
        description="Run a twin of an A1: a simulated robot behind the robot's wire protocol, only on this computer.",
        epilog="Injects: " + "; ".join(f"{name} {kind.does}" for name, kind in KINDS.items()) + ". "
        "Each may have =VALUE and @ROUND, @FIRST-LAST or @FIRST-, in rounds of 2 ms from the first command on.",
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("--place", default="lab", help=f"environment of the twin: {', '.join(PLACES)}; lab by default")
    add(
        "--host", default="127.0.0.1", help="loopback address on which the twin listens; 127.0.0.1 by default"
    )
    add(
        "--port",
        type=_whole(0, 65535),
        default=PORT,
        help="UDP port, 8007 by default; 0 for any free one",
    )
    add("--clock", choices=get_args(Clock), default="real", help="real, or lockstep: one state per command")
    add("--layout", choices=sorted(LAYOUTS), default="a1", help="layout of the packets; a1 by default")
    add("--seed", type=_whole(0, 2**63 - 1), default=0, help="seed of all random numbers; 0 by default")
    add(
        "--delay",
        type=_whole(0, _MOST_DELAY),
        default=1,
        help="delay of commands in rounds of 2 ms; 1 by default",
    )
    add("--noise", choices=("on", "off"), default="on", help="sensor noise; on by default")
    add("--tick", choices=get_args(TickUnit), default="ms", help="unit of the robot's clock; ms by default")
    add(
        "--mocap",
        type=_whole(1, 65535),
        metavar="PORT",
        help="send poses with the noise of markers to this port, as lines of JSON",
    )
    add(
        "--silence",
        choices=get_args(Silence),
        default="damp",
        help="the motors' behaviour when commands stop; damp by default",
    )
    add("--inject", action="append", default=[], metavar="FAULT", help="a fault; repeat for several faults")
    add("--record", type=Path, metavar="FILE", help="write all packets, in both directions, to a new file")
    add("--rig", type=_height, metavar="METRES", help="hold the base in a rig at this height, with free legs")
    add("--start", type=Path, metavar="FILE", help="begin from a saved state of the plant, not lying")
    return parser


def _whole(low: int, high: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{value} is not within {low}…{high}")
        return value

    return read


def _height(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = nan
    if not LOWEST <= value <= HIGHEST:
        raise argparse.ArgumentTypeError(f"{text!r} is not a height from {LOWEST:g} to {HIGHEST:g} m")
    return value


def _loopback(host: str) -> str:
    try:
        address = ipaddress.IPv4Address("127.0.0.1" if host == "localhost" else host)
    except ValueError:
        address = None
    if address is None or not address.is_loopback:
        raise UsageError(
            f"a twin listens only on this computer, and {host!r} is not 127.0.0.1; leave --host out"
        )
    return str(address)
