"""Standard output and error for any encoding: a character that it lacks is replaced by a readable one.

A verdict must reach every terminal with its exit code. A name from a file or a backend must not command the
terminal, or the CI runner that reads the lines.
"""

from __future__ import annotations

import codecs
import json
import os
import re
import sys
import unicodedata
from typing import IO, TYPE_CHECKING, Any

from s2r_spec.base.printable import one_line, without_controls

if TYPE_CHECKING:
    from rich.console import Console

    from s2r_spec.base.verdict import Verdict

ERRORS = "s2r.readable"
"""Name of the error handler that replaces characters that an encoding lacks."""
READABLE = {
    "α": "alpha", "β": "beta", "γ": "gamma", "δ": "delta", "ε": "epsilon", "ζ": "zeta", "η": "eta", "θ": "theta",
    "κ": "kappa", "λ": "lambda", "μ": "mu", "ν": "nu", "ξ": "xi", "π": "pi", "ρ": "rho", "σ": "sigma", "τ": "tau",
    "φ": "phi", "χ": "chi", "ψ": "psi", "ω": "omega", "Γ": "Gamma", "Δ": "Delta", "Θ": "Theta", "Λ": "Lambda",
    "Σ": "Sigma", "Φ": "Phi", "Ψ": "Psi", "Ω": "Omega", "µ": "u", "°": "deg", "≥": ">=", "≤": "<=", "≠": "!=",
    "≈": "~", "±": "+-", "−": "-", "·": "*", "×": "x", "÷": "/", "∞": "inf", "√": "sqrt", "∈": "in", "→": "->",
    "←": "<-", "–": "-", "—": "-", "‘": "'", "’": "'", "“": "'", "”": "'", "…": "...", "½": "1/2", "✓": "ok",
    "✗": "x", "✅": "ok", "❌": "x", "│": "|", "─": "-", "━": "-", "╸": "-", "╺": "-", "•": "*",
}  # fmt: skip
"""Readable replacement of a character. No quotation mark and no backslash: in JSON they would change the text."""
_CORNERS = re.compile("[\u2500-\u257f]")
_COMMAND = re.compile(r"(?m)^([ \t]*)::")
_COLOUR = re.compile(r"(\x1b\[[\d;]*m)")


def prepare() -> None:
    """Make standard output and error accept every text."""
    codecs.register_error(ERRORS, _in_other_letters)
    sys.stdout, sys.stderr = _prepare(sys.stdout), _prepare(sys.stderr)


def console(*, stderr: bool = False) -> Console:
    """Return standard output, whose lines are not broken, or standard error, where live views fit the screen.

    Control characters of the strings that it prints are escaped.
    """
    from rich.console import Console

    class SafeConsole(Console):
        def print(self, *objects: Any, **how: Any) -> None:
            safe = (without_controls(one) if isinstance(one, str) else one for one in objects)
            super().print(*safe, **how)

    return SafeConsole(stderr=stderr, highlight=False, soft_wrap=not stderr)


def say(line: object, *, error: bool = False) -> None:
    """Print one line to standard output or error, safe for any names in it."""
    print(one_line(line), file=sys.stderr if error else sys.stdout)


def print_verdict(lines: str, verdict: Verdict) -> None:
    """Print a result of one requirement; on a terminal its verdict has the verdict's colour."""
    if isinstance(sys.stdout, _Guarded):
        print(lines)
        return
    from rich.text import Text

    from s2r_spec.report.text import STYLES

    text = Text(lines)
    text.highlight_words([f" {verdict.value}:"], style=STYLES[verdict.tone])
    console().print(text)


def print_heading(name: str, more: str = "") -> None:
    """Print a name, bold on a terminal, and more after it."""
    if isinstance(sys.stdout, _Guarded):
        print(name + more)
        return
    from rich.text import Text

    console().print(Text(name, style="bold").append(more, style="not bold"))


def print_commands(text: str) -> None:
    """Print lines that are commands to a CI runner."""
    print(text, file=getattr(sys.stdout, "unguarded", sys.stdout))


def print_json(text: str) -> None:
    r"""Print JSON in any encoding: a character that it lacks is written as ``\u03c1``."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    try:
        text.encode(encoding)
    except (UnicodeEncodeError, LookupError):
        text = re.sub(r"[^\x00-\x7f]", lambda character: json.dumps(character[0])[1:-1], text)
    print(text)


class _Guarded:
    """A stream that is not a terminal: it escapes control characters and the commands of a CI runner.

    Attributes:
        unguarded: the stream itself.
    """

    def __init__(self, stream: IO[str], colours: bool) -> None:
        self.unguarded, self._colours = stream, colours

    def write(self, text: str) -> int:
        """Write a text with its control characters escaped."""
        parts = _COLOUR.split(text) if self._colours else [text]
        # Every second part is a colour code of s2r's own help, which a CI runner can show.
        safe = "".join(part if i % 2 else without_controls(part) for i, part in enumerate(parts))
        self.unguarded.write(_COMMAND.sub(r"\1\\u003a:", safe))
        return len(text)

    def writelines(self, texts: Any) -> None:
        """Write each of several texts."""
        for text in texts:
            self.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.unguarded, name)


def _prepare(stream: Any) -> Any:
    if stream is None or isinstance(stream, _Guarded):
        return stream
    if hasattr(stream, "reconfigure"):
        stream.reconfigure(errors=ERRORS)
    # With forced colours the live view is shown, too: its control characters are s2r's own.
    if stream.isatty() or os.environ.get("FORCE_COLOR") or os.environ.get("TTY_COMPATIBLE") == "1":
        return stream
    return _Guarded(stream, bool(os.environ.get("GITHUB_ACTIONS") or os.environ.get("PY_COLORS")))


def _in_other_letters(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_letter, error.object[error.start : error.end])), error.end


def _letter(character: str) -> str:
    if character in READABLE:
        return READABLE[character]
    if _CORNERS.match(character):
        return "+"
    plain = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    if plain or unicodedata.combining(character):
        return plain.replace('"', "'").replace("\\", "/")
    return "?"
