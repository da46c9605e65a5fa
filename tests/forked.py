"""The command line in a process of its own, forked from one that has imported what all commands import.

A fresh interpreter would import numerical libraries for longer than most commands run. What is killed, piped or timed
by a test still begins as a user's would; see ``CommandLine.command``.

A forked command runs its rollouts in a thread, unless it is given ``--workers``: a worker process takes longer to start
than most tests take. Then the repeat that a run makes in a new process has none, either; the tests that call a run make
it in a fork. It does not wait for the disk, for no test pulls the plug.
"""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing.process import BaseProcess
from pathlib import Path
from pkgutil import resolve_name

from s2r_spec.runs import repeatability
from s2r_spec.runs.task import Task, run_task
from s2r_spec.trace import Trace

FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(["tests.warm"])
LONGEST = 600.0
"""Seconds that a command may take: no more than a safety net, for the machine may be busy."""


def run(words: Sequence[str], folder: Path | None = None, said: str = "") -> subprocess.CompletedProcess[str]:
    """Run ``s2r`` with these words in a folder, with this process's environment and import path.

    ``said`` is its standard input.
    """
    with started(words, folder, said) as command:
        return command.finish()


class Afresh:
    """Stands in for ``repeatability.run_afresh``: a fork is as new a process as an interpreter, and starts sooner."""

    def __call__(self, task: Task) -> tuple[Trace, float]:
        with ProcessPoolExecutor(1, FORKS, _surround, (dict(os.environ), os.getcwd())) as pool:
            return pool.submit(run_task, task).result()

    def __reduce__(self) -> tuple[Callable[..., object], tuple[object, ...]]:
        return resolve_name, ("s2r_spec.runs.repeatability:run_afresh",)  # a worker has nothing to fork from


@dataclass(frozen=True)
class Command:
    """``s2r`` that runs, for what is sent a signal meanwhile."""

    words: Sequence[str]
    process: BaseProcess
    out: Path
    err: Path

    def finish(self, seconds: float = LONGEST) -> subprocess.CompletedProcess[str]:
        """Wait for its end, and return what it said."""
        self.process.join(seconds)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
            raise TimeoutError(
                f"s2r {' '.join(self.words)} took more than {seconds:g} s: {self.err.read_text()}"
            )
        return subprocess.CompletedProcess(
            ["s2r", *self.words], self.process.exitcode or 0, self.out.read_text(), self.err.read_text()
        )


@contextmanager
def started(
    words: Sequence[str], folder: Path | None = None, said: str = "", terminal: str | None = None
) -> Iterator[Command]:
    """Start ``s2r`` as :func:`run` does, and go on beside it.

    ``terminal`` names the one that it belongs to; without it it belongs to none, whoever started the tests.
    """
    with tempfile.TemporaryDirectory() as kept:
        files = [Path(kept, name) for name in ("in", "out", "err")]
        files[0].write_text(said)
        arguments = (tuple(words), folder or Path.cwd(), dict(os.environ), sys.path, files, terminal)
        process = FORKS.Process(target=_command, args=arguments)
        process.start()
        try:
            yield Command(words, process, *files[1:])
        finally:
            process.kill()
            process.join()


def _surround(environment: dict[str, str], folder: str) -> None:
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)


def _command(
    words: Sequence[str],
    folder: Path,
    environment: dict[str, str],
    path: list[str],
    files: list[Path],
    terminal: str | None,
) -> None:
    os.setsid()
    if terminal is not None:  # the first that the leader of a session opens is its own
        os.close(os.open(terminal, os.O_RDWR))
    for descriptor, file in enumerate(files):
        os.dup2(os.open(file, os.O_RDWR | os.O_CREAT), descriptor)
    sys.stdin = os.fdopen(0, closefd=False)
    _surround(environment, str(folder))
    sys.path[:] = path
    sys.argv = ["s2r", *words]
    os.sched_getaffinity = lambda _: {0}  # type: ignore[assignment]
    os.fsync = lambda _: None
    from s2r_spec.cli import main
    from s2r_spec.workers import pools

    if "--workers" not in words:
        pools.process_pool = lambda workers: partial(ThreadPoolExecutor, 1)
        repeatability.run_afresh = run_task

    main()
