"""Everything s2r raises on purpose derives from :class:`S2RError`.

An error is built from facts: it says what was found, what would have been
valid, and what to do. The command line prints ``str(error)`` after ``error:``
and exits with ``exit_code``.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import ClassVar, Literal

from s2r_spec.printable import one_line

MOST_NAMES = 60
"""Budget: names that an error lists; twice as many fill a screen."""
LONGEST_NAME = 100
"""Budget: letters of a name that an error shows, and of names that are compared; the comparison is quadratic."""

ErrorCode = Literal[2, 4, 130]
"""Exit code of an error: 2 usage or specification, 4 backend or internal, 130 the operator stopped the run."""


def one_of(names: Iterable[str]) -> str:
    """Return ``a, b, c`` in order, or ``(none)``: how every error lists the valid names."""
    found = sorted(names)
    shown = ", ".join(shortened(name) for name in found[:MOST_NAMES]) or "(none)"
    return f"{shown} and {len(found) - MOST_NAMES} more" if len(found) > MOST_NAMES else shown


def shortened(text: str) -> str:
    """Return a text as an error shows it: its beginning, if it is long."""
    return text if len(text) <= LONGEST_NAME else f"{text[:LONGEST_NAME]}…"


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Return ``"; did you mean 'vx'?"`` when one of ``names`` is close, else an empty string."""
    among = [one for one in names if len(one) <= LONGEST_NAME][:10_000]
    close = difflib.get_close_matches(name[:LONGEST_NAME], among, n=1)
    return f"; did you mean {close[0]!r}?" if close else ""


def suggest(name: str, names: Iterable[str]) -> str:
    """Return :func:`did_you_mean`, or ``";"``: what joins a wrong name and the list of valid ones."""
    return did_you_mean(name, names) or ";"


class S2RError(Exception):
    """Root of all errors that s2r raises on purpose; each is one line, whatever names and causes it quotes."""

    exit_code: ClassVar[ErrorCode] = 4

    def __str__(self) -> str:
        return one_line(super().__str__().strip())


class UsageError(S2RError):
    """What the user gave cannot be used: a spec, a trace, a name, a setting."""

    exit_code: ClassVar[ErrorCode] = 2


class TraceError(UsageError):
    """A trace breaks the contract of :class:`s2r_spec.trace.Trace`, or lacks what a spec needs."""


class TraceNote(UserWarning):
    """What a reader of a trace's file did that its user should know of: a row that is cut was left out."""


class SamplingError(TraceError):
    """A time window of the spec is shorter than the time between two samples of a trace."""


class BackendError(S2RError):
    """A backend failed while it ran, or broke its declared contract."""


class NotBegunError(BackendError):
    """A rollout of a machine could not begin: nothing moved before t = 0, so that there is no rollout to record."""


class StoppedError(S2RError):
    """The operator of a machine ended the run; what was recorded is kept, and --resume goes on with it."""

    exit_code: ClassVar[ErrorCode] = 130


class UnknownBackendError(UsageError):
    """No installed distribution offers a backend of this name."""

    def __init__(self, name: str, installed: Iterable[str]) -> None:
        installed = list(installed)
        super().__init__(
            f"no backend {name!r}{suggest(name, installed)} installed: {one_of(installed)}. "
            f"A backend is offered by a package through the entry-point group 's2r.backends'."
        )


class MissingPackageError(UsageError):
    """A backend is installed, but a package that it needs is not."""

    def __init__(self, backend: str, package: str) -> None:
        super().__init__(
            f"backend {backend!r} needs the package {package!r}, which is not installed; "
            f"try: pip install 's2r[{backend}]'"
        )
