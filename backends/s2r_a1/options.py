"""Read the options after ``a1:``, and write them."""

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass
from typing import Literal, TypeVar, get_args

from s2r_a1.guard.place import PORT, Clock, RobotAddress
from s2r_spec import effects
from s2r_spec.backend import Option
from s2r_spec.errors import UsageError, one_of

Operating = Literal["tty", "auto"]
Word = TypeVar("Word", bound=str)

OFFERED = (
    Option("host", None, "IPv4 address of the robot's motion controller; 127.0.0.1 is a twin"),
    Option(
        "robot",
        "none, for a twin",
        "name of the robot, as it stands on its body; every A1 has the same address",
    ),
    Option("port", str(PORT), "UDP port of the motion controller"),
    Option("velocity", None, "source of vx and vy: onboard, or mocap:PORT for motion capture"),
    Option("body", "0:0:0", "position X:Y:Z [m], in base axes, of the body that motion capture tracks"),
    Option("heading", "0", "angle of that body's x axis from the robot's [deg], positive to the left"),
    Option(
        "operator", "tty", "who answers: tty for a person at the terminal, auto for nobody, with a twin only"
    ),
    Option("clock", "real", "real, or lockstep with a twin only"),
    Option("layout", "a1", "layout of the packets; go1 is refused, since s2r cannot walk a Go1 yet"),
    Option(
        "local", "any free one", "UDP port of this computer for the robot; the vendor's program uses 8080"
    ),
    Option("module", "none", "the vendor's Python module to use for the connection, in real time"),
)
"""A definition: all options."""
NAMES = tuple(option.name for option in OFFERED)
EXAMPLE = "host=192.168.123.10,robot=a1-07,velocity=onboard"
"""A definition: options of a robot as its vendor delivers it."""
_EXAMPLE = f"a1:{EXAMPLE}"


@dataclass(frozen=True)
class Options(RobotAddress):
    """Connection and measurement of a robot.

    Attributes:
        mocap: UDP port of this computer that receives motion capture; None for the robot's own estimate.
        body: position of the tracked body, as text; see :func:`s2r_a1.mocap.read_placing`.
        heading: heading of the tracked body, as text.
        operator: "tty" for a person at the terminal, "auto" for nobody.
    """

    mocap: int | None = None
    body: str | None = None
    heading: str | None = None
    operator: Operating = "tty"

    @property
    def is_twin(self) -> bool:
        """Whether the address belongs to this computer, where only a twin can be."""
        return ipaddress.ip_address(self.host).is_loopback

    @property
    def velocity(self) -> str:
        """Source of the velocity, in the form of the option."""
        return "onboard" if self.mocap is None else f"mocap:{self.mocap}"


def read_options(text: str) -> Options:
    """Read options such as ``host=127.0.0.1,velocity=onboard``.

    Raises:
        UsageError: an option is unknown, missing, given twice or wrong; the message says what is right.
    """
    words, _ = effects.read_options("a1", text, dict.fromkeys(NAMES, ()))
    if "host" not in words:
        raise UsageError(
            f"a1 needs the address of the robot, which has no default: {_EXAMPLE}, or host=127.0.0.1 for a twin"
        )
    if "velocity" not in words:
        raise UsageError(
            "an A1 does not measure its velocity; write velocity=onboard for its own estimate, or velocity=mocap:PORT "
            "for motion capture that sends to this port"
        )
    mocap = _mocap(words["velocity"])
    if mocap is None and words.keys() & {"body", "heading"}:
        raise UsageError(
            "body and heading describe the body that motion capture tracks; add velocity=mocap:PORT, or leave them out"
        )
    if _one_of("layout", words.get("layout", "a1"), ("a1", "go1")) == "go1":
        raise UsageError(
            "layout=go1: s2r can read a Go1 but not make it walk, because it has no masses and gains for it; use an A1"
        )
    options = Options(
        host=_host(words["host"]),
        port=_port("port", words.get("port", str(PORT))),
        mocap=mocap,
        body=words.get("body"),
        heading=words.get("heading"),
        operator=_one_of("operator", words.get("operator", "tty"), get_args(Operating)),
        clock=_one_of("clock", words.get("clock", "real"), get_args(Clock)),
        local=_port("local", words["local"]) if "local" in words else 0,
        module=_module(words["module"]) if "module" in words else "",
        robot=_robot(words["robot"]) if "robot" in words else "",
    )
    if not (options.robot or options.is_twin):  # every A1 has the same address
        raise UsageError(
            f"a robot at {options.host} needs its name, so that no run mixes two robots; write the name on its body, "
            f"as in {_EXAMPLE}"
        )
    if options.module and options.clock == "lockstep":
        raise UsageError("the vendor's module has no lock step: leave out module or clock=lockstep")
    for name, value in (("operator", "auto"), ("clock", "lockstep")):
        if getattr(options, name) == value and not options.is_twin:
            raise UsageError(
                f"{name}={value} needs a twin on this computer, and {options.host} is another computer: leave it out"
            )
    return options


def write_options(options: Options) -> str:
    """Return options as text that :func:`read_options` reads, without the defaults."""
    names = ("robot", "port", "velocity", "body", "heading", "operator", "clock", "local", "module")
    values = {name: getattr(options, name) for name in names}
    defaults = vars(Options("")) | {"velocity": None}
    changed = [f"{name}={value}" for name, value in values.items() if value != defaults[name]]
    return ",".join([f"host={options.host}", *changed])


def _host(value: str) -> str:
    if value == "localhost":
        return "127.0.0.1"
    try:
        address = ipaddress.IPv4Address(value)
    except ValueError:
        raise UsageError(f"host = {value!r} is not an IPv4 address, such as 192.168.123.10") from None
    # Linux takes 0.0.0.0 for this machine: a twin would pass for a robot. The others are many hosts.
    if address.is_unspecified or address.is_multicast or address.is_reserved:
        raise UsageError(
            f"host = {value} is not the address of one computer; write the robot's, such as 192.168.123.10, or "
            "127.0.0.1 for a twin"
        )
    return str(address)


def _port(name: str, value: str) -> int:
    if not (value.isascii() and value.isdigit() and 1 <= int(value) <= 65535):
        raise UsageError(f"{name} = {value!r} is not a UDP port; it must be a whole number from 1 to 65535")
    return int(value)


def _module(value: str) -> str:
    if not all(part.isidentifier() for part in value.split(".")):
        raise UsageError(
            f"module = {value!r} is not the name of a Python module; write, for example, robot_interface"
        )
    return value


def _robot(value: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,39}", value):
        raise UsageError(
            f"robot = {value!r} is not a name of at most 40 letters, digits, dots, - and _, such as a1-07"
        )
    return value


def _mocap(value: str) -> int | None:
    if value == "onboard":
        return None
    kind, colon, port = value.partition(":")
    if kind != "mocap" or not colon:
        raise UsageError(
            f"velocity = {value!r} is not one of onboard (the robot's own estimate), mocap:PORT (motion capture)"
        )
    return _port("velocity=mocap:PORT, where PORT", port)


def _one_of(name: str, value: str, allowed: tuple[Word, ...]) -> Word:
    for one in allowed:
        if value == one:
            return one
    raise UsageError(f"{name} = {value!r} is not one of {one_of(allowed)}")
