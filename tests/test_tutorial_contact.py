"""The tutorial on first contact does what it says: a person at a terminal types what the page shows."""

import os
import re
import subprocess
import sys
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from s2r_a1 import status
from s2r_a1.guard import __main__ as guard
from tests import terminals
from tests.a1.robots import in_a_process
from tests.forked import started
from tests.terminals import person

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "tutorials" / "first-contact.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"<!-- ([^>]*?) -->\n```\w+\n(.*?)```", re.S)
NUMBER = re.compile(r"\d+(?:\.\d+)?")
PROMPT = re.compile(r"^(.* to stop:|.* lay it down:|>)(?: (.*))?$")
SECONDS = 300.0
"""How long a step may take: no more than a safety net, for the machine may be busy."""


class Session:
    """A program at a terminal, and the person there, who follows the page."""

    def __init__(self, someone, ended):
        self._someone, self._ended = someone, ended
        self._expected, self._shown, self._asked = [], "", False

    def follow(self, text):
        """Type what a block of the page shows behind each prompt; a prompt with nothing behind it waits."""
        for line in text.splitlines():
            found = PROMPT.match(line)
            if not found:
                self._expected.append(line)
                continue
            if not self._asked:
                self._shown += self._someone.reads(f"{found[1]} ")
            self._asked = not found[2]
            if found[2]:
                self._someone.types("\n" if found[2] == "(Enter)" else f"{found[2]}\n")

    def close(self):
        """Wait for the program's end; see that it showed every line that the page shows, and return its status."""
        done = self._ended()
        printed = (self._shown + self._someone.rest() + done.stdout + done.stderr).splitlines()
        for line in self._expected:
            assert line == "…" or any(alike(line, other) for other in printed), (line, printed)
        return done.returncode


@contextmanager
def at_a_terminal(command, folder):
    """Start a command of the page at a terminal of its own, as the page's reader does."""
    program, *words = command.split()
    with person() as someone:
        if program == "s2r":
            with started(words, folder, terminal=someone.name) as running:
                yield Session(someone, lambda: running.finish(SECONDS))
            return
        terminal = os.open(someone.name, os.O_RDWR)
        both = dict.fromkeys(("stdin", "stdout", "stderr"), terminal)
        process = subprocess.Popen([sys.executable, *words], cwd=folder, start_new_session=True, **both)
        os.close(terminal)

        def ended():
            return subprocess.CompletedProcess(words, process.wait(SECONDS), "", "")

        try:
            yield Session(someone, ended)
        finally:
            process.kill()
            process.wait()


def words(text):
    """Return the lines of a text without their numbers: times and counts are the machine's."""
    return [NUMBER.sub("#", line) for line in text.splitlines() if line != "…"]


def places(text):
    """Return the lines of a view of a robot without the values of its numbers, in columns."""
    return re.sub(
        r"[+-]?\d+(?:\.\d+)?", lambda found: "#" * len(found[0]), text.replace("!", " ")
    ).splitlines()


def alike(shown, printed):
    """Whether two lines have the same words, and nearly the same numbers: when a person types, the noise differs."""
    numbers = [[float(number) for number in NUMBER.findall(line)] for line in (shown, printed)]
    return words(shown) == words(printed) and numbers[0] == pytest.approx(numbers[1], rel=0.1, abs=0.02)


@pytest.fixture
def page(tmp_path, monkeypatch):
    """The page, whose commands speak with a twin of this test; the folder of the test is the reader's."""
    monkeypatch.setenv("S2R_A1_RUN", str(tmp_path / "guards"))
    monkeypatch.setattr(terminals, "PATIENCE", SECONDS)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "specs").symlink_to(ROOT / "specs")
    with in_a_process("--place", "nominal") as port:
        yield PAGE.replace("host=127.0.0.1", f"host=127.0.0.1,port={port}").replace(":8007", f":{port}")


def follow(page, folder, capsys):
    """Do what a page shows at terminals; return exit statuses of its dialogues, and the commands beside them."""
    statuses, outputs = [], []
    with ExitStack() as programs:
        session = None
        for about, text in BLOCK.findall(page):
            kind, _, what = about.partition(": ")
            if kind == "file":
                Path(what).write_text(text, encoding="utf-8")
            elif kind == "dialogue":
                statuses += [session.close()] if session else []
                session = programs.enter_context(at_a_terminal(what, folder))
                session.follow(text)
            elif kind == "dialogue goes on":
                session.follow(text)
            elif kind == "output of":
                assert guard.main(what.removeprefix("python -m s2r_a1.guard ").split()) == 0
                outputs.append(what)
                printed = words(capsys.readouterr().out)
                assert [line for line in words(text) if line not in printed] == [], printed
            elif kind == "view of":
                assert status.main([*what.removeprefix("python -m s2r_a1.status").split(), "--once"]) == 0
                assert places(capsys.readouterr().out) == places(text)
                outputs.append(what)
        statuses.append(session.close())
    return statuses, outputs


def test_a_person_stands_the_robot_up_and_damps_it_as_the_page_shows(page, tmp_path, capsys):
    before_the_walk, walk = page.split("## 6. ")
    statuses, outputs = follow(before_the_walk, tmp_path, capsys)
    assert (statuses, len(outputs)) == ([0], 5)
    assert "<!-- dialogue: s2r check " in walk
    assert guard.main(["stop"]) == 0


def test_enter_lays_the_robot_down(page, tmp_path, capsys):
    first = page.split("## 3. ")[0]
    stand = "arm\nThe robot stands. Press Enter to lay it down: (Enter)\nThe robot is lying down."
    answered = re.sub(r"(Type arm to go on, q to stop:)\n```", rf"\1 {stand}\n```", first)
    assert follow(answered, tmp_path, capsys) == ([0], [])
    assert guard.main(["status"]) == 0
    assert capsys.readouterr().out.startswith("RESTING")
    assert guard.main(["stop"]) == 0


@pytest.mark.slow
def test_a_person_does_what_the_page_shows(page, tmp_path, capsys):
    statuses, outputs = follow(page, tmp_path, capsys)
    code, shown = re.search(
        r"<!-- printed below -->\n```python\n(.*?)```\n\n```text\n(.*?)```", page, re.S
    ).groups()
    exec(code, {})
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) == len(shown.splitlines())
    assert all(alike(*lines) for lines in zip(shown.splitlines(), printed, strict=True)), printed
    assert guard.main(["stop"]) == 0
    assert statuses == [0, 130]
    assert len(outputs) == 5
