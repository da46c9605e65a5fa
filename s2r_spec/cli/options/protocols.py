"""Options of a diagnosis about protocols: which ones may run, and where the references of the next one go."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from s2r_spec.base.errors import UsageError
from s2r_spec.cli.options.groups import output_option, search_option
from s2r_spec.cli.options.output import writable

Protocols = Annotated[
    str | None,
    search_option(
        help="Protocols that may run, separated by commas; `s2r backends NAME` lists them.",
        show_default="all that the simulator and the machine have",
    ),
]
NoProtocols = Annotated[
    bool, search_option("--no-protocols", help="Run no protocols. Those in logs are still used.")
]
Passive = Annotated[
    bool,
    search_option("--passive", help="Use tests of the specification alone, from a machine or from logs."),
]
Next = Annotated[
    Path | None,
    output_option(
        "--next",
        help="Print the experiment to run next. If it is a protocol, its references go to this .csv file.",
        show_default=False,
    ),
]


def playable(path: Path | None) -> None:
    """Check, before anything runs, that a protocol's references can be written to a file.

    Raises:
        UsageError: its name does not end in .csv, or it cannot be written.
    """
    if path is None:
        return
    if path.suffix.lower() != ".csv":
        raise UsageError(f"--next {path}: the file of a protocol must end in .csv")
    writable(path)


def protocol_names(
    protocols: str | None, no_protocols: bool = False, passive: bool = False
) -> tuple[str, ...] | None:
    """Return the names of the protocols that may run; None for all of them.

    Raises:
        UsageError: several of the options are given, or a name is empty.
    """
    if (protocols is not None) + no_protocols + passive > 1:
        raise UsageError("give only one of --protocols, --no-protocols and --passive")
    if protocols is None:
        return () if no_protocols or passive else None
    names = tuple(name.strip() for name in protocols.split(","))
    if not all(names):
        raise UsageError(
            f"--protocols {protocols!r} has an empty name; give names such as squat,sway, or use --no-protocols"
        )
    return names
