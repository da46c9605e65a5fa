r"""Foreign text made safe to print: names, units, failure words, exceptions.

A channel called ``"\x1b[2J"`` must not clear the reader's screen. A name with a line break must not begin a new line,
since ``::error::`` at the start of a line is a command to GitHub's runner.

Every escape is also valid in JSON, and none is escaped twice.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

_SHORT = {"\n": "\\n", "\r": "\\r", "\t": "\\t"}
# C0, DEL and C1; marks of writing direction; line and paragraph separator; byte order mark; surrogates.
_UNSEEN = r"\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff"
_CONTROL = re.compile(f"[{_UNSEEN}]")
_CONTROL_OR_BREAK = re.compile(f"[{_UNSEEN}\n]")
_COMMAND = re.compile(r"^(\s*)::")
_POWER = re.compile(r"\^(-?\d+)")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_OLD_COMMAND = re.compile(r"##(?=\[)")


def one_line(text: object) -> str:
    r"""Return a text as one line: control characters and line breaks as ``\u001b`` and ``\n``.

    Commands to a CI runner (``::`` at the start, ``##[``) are escaped, too.
    """
    line = _CONTROL_OR_BREAK.sub(_escape, str(text))
    return _OLD_COMMAND.sub(r"\\u0023#", _COMMAND.sub(r"\1\\u003a:", line))


def lines(text: object) -> str:
    """Return a text of several lines, each made safe by :func:`one_line`."""
    return "\n".join(map(one_line, str(text).split("\n")))


def spell_unit(unit: str) -> str:
    """Return a unit as people write it: ``N*m*s/rad`` as ``N·m·s/rad``, ``m/s^2`` as ``m/s²``."""
    return _POWER.sub(lambda power: power[1].translate(_RAISED), unit).replace("*", "·")


def without_controls(text: str) -> str:
    """Return a text whose control characters are escaped, except line breaks."""
    return _CONTROL.sub(_escape, text)


def html_text(text: object) -> str:
    """Return a text as one line of HTML: markup and control characters are escaped."""
    from html import escape  # with all names of HTML's characters

    return escape(one_line(text))


def html_table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table for a notebook, without style or script; every text is escaped."""
    top = "".join(f"<th>{html_text(word)}</th>" for word in head)
    cells = ("".join(f"<td>{html_text(cell)}</td>" for cell in row) for row in rows)
    body = "".join(f"<tr>{row}</tr>" for row in cells)
    above = f"<thead><tr>{top}</tr></thead>" if head else ""
    return f"<table><caption>{html_text(title)}</caption>{above}<tbody>{body}</tbody></table>"


def _escape(match: re.Match[str]) -> str:
    character = match[0]
    return _SHORT.get(character) or f"\\u{ord(character):04x}"


def count_messages(count: int, name: str, verb: str) -> str:
    """Return the begin of a sentence on messages: "1 message of v has", or "2 messages of v have"."""
    if count != 1:
        return f"{count:,} messages of {name} {verb}"
    return f"1 message of {name} {'has' if verb == 'have' else f'{verb}s'}"
