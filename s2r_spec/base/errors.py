"""The errors that s2r raises on purpose; all derive from :class:`S2RError`.

A message states the problem, the valid values and the remedy. The command line prints ``str(error)`` after
``error:`` and exits with ``exit_code``.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from s2r_spec.base import distribution
from s2r_spec.base.printable import one_line

if TYPE_CHECKING:
    from importlib.metadata import Distribution

MOST_NAMES = 60
"""Budget: names that an error lists."""
LONGEST_NAME = 100
"""Budget: letters of a name that an error shows or compares; the time of a comparison grows with their square."""

ErrorCode = Literal[2, 4, 130]
"""Exit code of an error: 2 usage or specification, 4 backend or internal, 130 the operator stopped the run."""


def one_of(names: Iterable[str]) -> str:
    """Return the valid names for an error, sorted: ``a, b, c``, or ``(none)``."""
    ordered = sorted(names)
    shown = ", ".join(shortened(name) for name in ordered[:MOST_NAMES]) or "(none)"
    return f"{shown} and {len(ordered) - MOST_NAMES} more" if len(ordered) > MOST_NAMES else shown


def shortened(text: str) -> str:
    """Return a text, or the beginning of a long one."""
    return text if len(text) <= LONGEST_NAME else f"{text[:LONGEST_NAME]}…"


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Return ``"; did you mean 'vx'?"`` when one of ``names`` is close, else an empty string."""
    candidates = [one for one in names if len(one) <= LONGEST_NAME][:10_000]
    close = difflib.get_close_matches(name[:LONGEST_NAME], candidates, n=1)
    return f"; did you mean {close[0]!r}?" if close else ""


def suggest(name: str, names: Iterable[str]) -> str:
    """Return :func:`did_you_mean`, or else ``";"``, to stand between a wrong name and the list of valid ones."""
    return did_you_mean(name, names) or ";"


class S2RError(Exception):
    """Base class of s2r's errors; the message is one line, whatever names and causes it quotes."""

    exit_code: ClassVar[ErrorCode] = 4

    def __str__(self) -> str:
        return one_line(super().__str__().strip())

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by message and attributes: a worker process may raise an error with a constructor of its own."""
        return _unpickle, (type(self), self.args, vars(self))


def _unpickle(kind: type[S2RError], args: tuple[Any, ...], attributes: dict[str, Any]) -> S2RError:
    error = kind.__new__(kind, *args)
    vars(error).update(attributes)
    return error


class UsageError(S2RError):
    """An input of the user is invalid: a spec, a trace, a name, a setting."""

    exit_code: ClassVar[ErrorCode] = 2


class TraceError(UsageError):
    """A trace breaks the contract of :class:`s2r_spec.trace.Trace`, or does not fit the spec."""


class NoTimesError(TraceError):
    """A log has no column with the name of the times, or several that may hold them.

    Args:
        sentence: what is wrong.
        likely: the column that may hold them, as ``--map t=`` takes it.
        candidates: all that may, if they are several.
    """

    def __init__(self, sentence: str, likely: str, candidates: tuple[str, ...] = ()) -> None:
        super().__init__(sentence)
        self.likely = likely
        self.candidates = candidates


class TraceNote(UserWarning):
    """Warning of a file reader about a change that matters to the user, such as a truncated row left out."""


class SamplingError(TraceError):
    """A time window of the spec is shorter than the time between two samples of a trace."""


class UndecidedError(TraceError):
    """A trace does not decide a requirement: a signal that it depends on was silent, or was sent with two values."""


class BackendError(S2RError):
    """A backend failed while it ran, or broke its declared contract."""


class NotBegunError(BackendError):
    """A rollout of a machine could not begin: nothing moved, so there is no rollout to record."""


class StoppedError(S2RError):
    """The operator of a machine ended the run; the recorded rollouts are kept, and --resume continues with them."""

    exit_code: ClassVar[ErrorCode] = 130


class UnknownBackendError(UsageError):
    """No installed distribution offers a backend of this name."""

    def __init__(self, name: str, installed: Iterable[str]) -> None:
        installed = list(installed)
        super().__init__(
            f"no backend {name!r}{suggest(name, installed)} installed: {one_of(installed)}. "
            f"A package offers a backend through the entry-point group 's2r.backends', and a file is PATH.py:NAME."
        )


class MissingPackageError(UsageError):
    """A backend is installed, but a package that it needs is not."""

    def __init__(self, backend: str, package: str) -> None:
        super().__init__(
            not_installed(f"backend {backend!r} needs", package, distribution.find_provider(backend))
        )


def require(need: str, *modules: str) -> None:
    """Check that modules, packages without dots, are installed; ``need`` is who needs them, such as ``plots need``.

    Raises:
        UsageError: one of them is not installed; the message has the command that installs them all.
    """
    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        raise UsageError(
            _install_sentence(need, missing, distribution.install_command(modules, distribution.find_own()))
        )


def not_installed(need: str, module: str, owner: Distribution | None) -> str:
    """Return the message about a missing module; ``need`` is who needs it (``plots need``), ``owner`` has the code."""
    return _install_sentence(need, [module], distribution.install_command([module], owner))


def _install_sentence(need: str, modules: Iterable[str], command: str) -> str:
    names = [distribution.package(module) for module in modules]
    missing = (
        f"the package {names[0]!r}, which is" if len(names) == 1 else f"{' and '.join(names)}, which are"
    )
    return f"{need} {missing} not installed; try: {command}"
