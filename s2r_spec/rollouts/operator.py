"""The person at the terminal: what is said to them, and what they type.

The dialogue is on the terminal that the process belongs to (``/dev/tty``), else on standard input and error where
input is one. So it goes on where standard output is a pipe or has the one object of ``--json``. Nothing is taken for
consent that was not meant as one: letters typed ahead of a question are dropped, Enter alone answers only a question
that offers it, and where there is no terminal every question is refused at once.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import BinaryIO

from s2r_spec.errors import StoppedError, UsageError
from s2r_spec.printable import lines, one_line

STOP = "q"
"""Definition: what ends the run at every question."""
TERMINAL = "/dev/tty"
_AT_MOST = 4096
"""Bytes that a line of a terminal has at most (definition: of Linux, N_TTY_BUF_SIZE)."""


class Terminal:
    """An operator (:class:`s2r_spec.backend.Operator`) at the terminal of this process; opened when first needed."""

    def __init__(self) -> None:
        self._streams: tuple[BinaryIO, BinaryIO] | None = None

    @property
    def there(self) -> bool:
        """Whether there is a terminal."""
        return self._opened() is not None

    def say(self, text: str) -> None:
        """Show a text; without a terminal it goes to standard error."""
        streams = self._opened()
        if streams is None:
            print(lines(text), file=sys.stderr, flush=True)
        else:
            self._show(streams[1], lines(text) + "\n")

    def type_word(self, question: str, word: str) -> None:
        """Return when exactly ``word`` was typed.

        Raises:
            StoppedError: ``q``, the end of input, or Ctrl-C.
            UsageError: there is no terminal.
        """
        self._shown(question)
        while (typed := self._line(f"Type {word} to go on, {STOP} to stop: ")) != word:
            self.say(f"That was {one_line(typed)!r}, so nothing was done." if typed else "Nothing was done.")

    def choose(self, question: str, answers: Mapping[str, str]) -> str:
        """Return the key that was typed, of key → what it means; "" among the keys is Enter alone.

        Raises:
            StoppedError: ``q``, the end of input, or Ctrl-C.
            UsageError: there is no terminal.
        """
        self._shown(question)
        offered = {**answers, STOP: answers.get(STOP, "stop; --resume goes on later")}
        for key, meaning in offered.items():
            self.say(f"  {key or 'Enter':6} {meaning}")
        while (typed := self._line("> ")) not in answers:
            self.say(f"Type one of these: {', '.join(key or 'Enter' for key in offered)}.")
        return typed

    def line(self, question: str) -> str:
        """Return the line that was typed, without spaces around it.

        Raises:
            StoppedError: ``q``, the end of input, or Ctrl-C.
            UsageError: there is no terminal.
        """
        refuse_nobody(self)
        return self._line(question)

    def _shown(self, question: str) -> None:
        """Show a question.

        Raises:
            UsageError: there is no terminal.
        """
        refuse_nobody(self)
        self.say(question)

    def _line(self, prompt: str) -> str:
        """Return the next line that is typed after the prompt is shown.

        Raises:
            StoppedError: it is ``q``, or there is none.
        """
        streams = self._opened()
        assert streams is not None
        source, shown = streams
        try:
            _drop_typed(source)
            self._show(shown, prompt)
            typed = source.readline(_AT_MOST)
        except KeyboardInterrupt:
            self.say("")
            raise StoppedError("the operator stopped the run with Ctrl-C") from None
        except OSError:  # the terminal went away
            typed = b""
        if not typed:
            raise StoppedError("the operator's input ended, so the run was stopped")
        answer = typed.decode(errors="replace").strip()
        if answer == STOP:
            raise StoppedError("the operator stopped the run")
        return answer

    def _opened(self) -> tuple[BinaryIO, BinaryIO] | None:
        """Return where lines come from and where texts go; None if no terminal is there."""
        if self._streams is None:
            with suppress(OSError):
                terminal = os.open(TERMINAL, os.O_RDWR | getattr(os, "O_NOCTTY", 0))
                self._streams = io.FileIO(terminal, "rb"), io.FileIO(os.dup(terminal), "wb")
        if self._streams is None:
            with suppress(OSError, ValueError, AttributeError):
                if os.isatty(sys.stdin.fileno()):
                    said, shown = os.dup(sys.stdin.fileno()), os.dup(sys.stderr.fileno())
                    self._streams = io.FileIO(said, "rb"), io.FileIO(shown, "wb")
        return self._streams

    def _show(self, where: BinaryIO, text: str) -> None:
        encoding = getattr(sys.stderr, "encoding", None) or "utf-8"
        instead = getattr(sys.stderr, "errors", None) or "replace"
        with suppress(OSError):  # it went away: reading will say so
            where.write(text.encode(encoding, instead))


def refuse_nobody(operator: object) -> None:
    """Say that a question needs a person at a terminal.

    Raises:
        UsageError: the operator is a :class:`Terminal`, and there is none.
    """
    if not getattr(operator, "there", True):
        raise UsageError(
            "this machine needs its operator at a terminal, and there is none: run s2r in a terminal, without nohup "
            "and outside of a scheduler"
        )


def _drop_typed(source: BinaryIO) -> None:
    """Drop what was typed before a question was shown: it was no answer to it."""
    with suppress(ImportError, OSError, ValueError):
        import termios

        with suppress(termios.error):
            termios.tcflush(source.fileno(), termios.TCIFLUSH)
