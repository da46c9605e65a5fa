"""The dialogue with the operator at the terminal.

It uses the terminal of the process (``/dev/tty``), or else standard input and error if input is a terminal. So it
works while standard output is a pipe or carries the one object of ``--json``. No input counts as consent by accident:
characters typed before a question are dropped, and Enter alone answers only a question that offers it. Without a
terminal every question is refused at once.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import BinaryIO

from s2r_spec.base.errors import StoppedError, UsageError
from s2r_spec.base.printable import lines, one_line

STOP = "q"
"""Definition: the answer that ends the run at every question."""
TERMINAL = "/dev/tty"
_LONGEST = 4096
"""Definition: bytes of the longest line of a Linux terminal, N_TTY_BUF_SIZE."""


class Terminal:
    """The operator (:class:`s2r_spec.backend.Operator`) at this process's terminal, which is opened at first use.

    Every question raises a StoppedError after ``q``, the end of input, or Ctrl-C; and a UsageError without a terminal.
    """

    def __init__(self) -> None:
        self._streams: tuple[BinaryIO, BinaryIO] | None = None

    @property
    def there(self) -> bool:
        """Whether there is a terminal."""
        return self._opened() is not None

    def say(self, text: str) -> None:
        """Show a text; without a terminal, on standard error."""
        streams = self._opened()
        if streams is None:
            print(lines(text), file=sys.stderr, flush=True)
        else:
            self._show(streams[1], lines(text) + "\n")

    def type_word(self, question: str, word: str) -> None:
        """Wait until the operator types exactly ``word``."""
        require_terminal(self)
        self.say(question)
        while (typed := self._line(f"Type {word} to go on, {STOP} to stop: ")) != word:
            self.say(f"You typed {one_line(typed)!r}, so s2r did nothing." if typed else "s2r did nothing.")

    def choose(self, question: str, answers: Mapping[str, str]) -> str:
        """Return the key that the operator types, one of key → meaning; the key "" is Enter alone."""
        require_terminal(self)
        self.say(question)
        offered = {**answers, STOP: answers.get(STOP, "stop; --resume goes on later")}
        for key, meaning in offered.items():
            self.say(f"  {key or 'Enter':6} {meaning}")
        while (typed := self._line("> ")) not in answers:
            self.say(f"Type one of these: {', '.join(key or 'Enter' for key in offered)}.")
        return typed

    def line(self, question: str) -> str:
        """Return the line that the operator types, without spaces around it."""
        require_terminal(self)
        return self._line(question)

    def _line(self, prompt: str) -> str:
        streams = self._opened()
        assert streams is not None
        source, shown = streams
        try:
            _drop_typed(source)
            self._show(shown, prompt)
            typed = source.readline(_LONGEST)
        except KeyboardInterrupt:
            self.say("")
            raise StoppedError("the operator stopped the run with Ctrl-C") from None
        except OSError:  # the terminal was closed
            typed = b""
        if not typed:
            raise StoppedError("the operator's input ended, so the run was stopped")
        answer = typed.decode(errors="replace").strip()
        if answer == STOP:
            raise StoppedError("the operator stopped the run")
        return answer

    def _opened(self) -> tuple[BinaryIO, BinaryIO] | None:
        """Return the streams for input and output; None without a terminal."""
        if self._streams is None:
            with suppress(OSError):
                terminal = os.open(TERMINAL, os.O_RDWR | getattr(os, "O_NOCTTY", 0))
                self._streams = io.FileIO(terminal, "rb"), io.FileIO(os.dup(terminal), "wb")
        if self._streams is None:
            with suppress(OSError, ValueError, AttributeError):
                if os.isatty(sys.stdin.fileno()):
                    source, shown = os.dup(sys.stdin.fileno()), os.dup(sys.stderr.fileno())
                    self._streams = io.FileIO(source, "rb"), io.FileIO(shown, "wb")
        return self._streams

    def _show(self, where: BinaryIO, text: str) -> None:
        encoding = getattr(sys.stderr, "encoding", None) or "utf-8"
        instead = getattr(sys.stderr, "errors", None) or "replace"
        with suppress(OSError):  # the terminal was closed; the next read raises the error
            where.write(text.encode(encoding, instead))


def require_terminal(operator: object) -> None:
    """Refuse to ask a :class:`Terminal` of a process without a terminal, with a UsageError."""
    if not getattr(operator, "there", True):
        raise UsageError(
            "the operator of this machine must answer at a terminal, but this process has no terminal: run s2r in a "
            "terminal, without nohup or scheduler"
        )


def _drop_typed(source: BinaryIO) -> None:
    """Drop the characters typed before a question: they cannot answer it."""
    with suppress(ImportError, OSError, ValueError):
        import termios

        with suppress(termios.error):
            termios.tcflush(source.fileno(), termios.TCIFLUSH)
