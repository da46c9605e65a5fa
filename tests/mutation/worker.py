"""Tries mutants of modules in a copy of the repository, each in a process forked from one that has the libraries.

    python -m tests.mutation.worker   (in the copy; a JSON object of :class:`Task` comes by standard input)

It prints a line of JSON for each mutant. It is started by ``python -m tests.mutation``.
"""

from __future__ import annotations

import gc
import importlib
import json
import math
import os
import random
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path

import hypothesis
import lark  # noqa: F401
import numba  # noqa: F401
import numpy.ma  # noqa: F401
import pint  # noqa: F401
import pytest
import scipy.linalg
import scipy.optimize
import scipy.stats  # noqa: F401

from tests.mutation import mutants as made
from tests.mutation.reach import Reach, read, record

OPTIONS = (
    *("-q", "-x", "-p", "no:cacheprovider", "--no-header", "--basetemp=build/tmp"),
    *("-m", "not slow and not dev"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # Hypothesis was imported before pytest began
)
QUICK = 3.0
"""CPU seconds of the tests that a mutant meets first, the fastest of those that reach it."""
PATIENCE = 10.0
"""CPU seconds beside four times what the tests take without a fault, before a mutant counts as one that hangs."""
LONGEST = 1800.0
"""Seconds by the clock after which it counts as one in any case."""
MEMORY = 8 << 30
"""Bytes of address space beside what the libraries have: a mutant that asks for more fails."""

PASSED, FAILED, UNKNOWN_TEST, NO_TEST = 0, 1, 4, 5
"""Exit codes of pytest."""
HANGS = -1


def forked(act: Callable[[], int], seconds: float, log: Path) -> int:
    """Return what an act returns in a child process; :data:`HANGS` where it takes longer than so many seconds."""
    pid = os.fork()
    if not pid:
        try:
            os.setsid()
            out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(out, 1)
            os.dup2(out, 2)
            os._exit(act())
        except BaseException:
            traceback.print_exc()
            sys.stderr.flush()
            os._exit(3)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            _kill(pid)
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    _kill(pid)
    os.waitpid(pid, 0)
    return HANGS


def _kill(group: int) -> None:
    with suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)


def tested(names: Sequence[str], seconds: float, log: Path) -> int:
    """Return the exit code of pytest for these tests, with so many CPU seconds for them."""

    def act() -> int:
        sys.dont_write_bytecode = True
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(seconds), math.ceil(seconds)))
        return int(pytest.main([*OPTIONS, *names]))

    code = forked(act, LONGEST, log)
    if code == -signal.SIGKILL:
        return HANGS
    if code in (UNKNOWN_TEST, NO_TEST):  # the fault is in what names the cases
        files = sorted({name.split("::")[0] for name in names})
        code = forked(lambda: int(pytest.main([*OPTIONS, *files])), LONGEST, log)
    return code


def tried(module: str, mutant: str, names: Sequence[str], reach: Reach, most: float, log: Path) -> str:
    """Return how a mutant of a module ended: ``killed``, ``hangs``, ``survived`` or ``unreached``.

    Args:
        module: path of the module.
        mutant: its text with a fault.
        names: the tests that run the line of the fault, the fastest first.
        reach: how long they take.
        most: CPU seconds of the tests that it meets at most.
        log: where their output goes.
    """
    if not names:
        return "unreached"
    path = Path(module)
    code = path.read_text()
    path.write_text(mutant)
    try:
        quick, rest, total = [names[0]], [], reach.seconds[names[0]]
        for name in names[1:]:
            total += reach.seconds[name]
            if total <= most:
                (quick if total <= QUICK else rest).append(name)
        for batch in (quick, rest):
            if batch:
                usual = sum(reach.seconds[name] for name in batch)
                result = tested(batch, PATIENCE + 4 * usual, log)
                if result != PASSED:
                    return "hangs" if result == HANGS else "killed"
        return "survived"
    finally:
        path.write_text(code)


def prepare(early: Sequence[str], part: set[str]) -> None:
    """Import what no mutant changes, and the plugins of pytest, once for all children."""
    for name in early:
        importlib.import_module(name)
    if imported := part & sys.modules.keys():
        sys.exit(f"{', '.join(sorted(imported))} would not be imported again after a fault")
    Path("build/test_none.py").touch()
    with redirect_stdout(StringIO()):
        pytest.main(["-q", "--noconftest", "-p", "no:cacheprovider", "-c", os.devnull, "build/test_none.py"])


def main() -> None:
    task = json.load(sys.stdin)
    most: float = task["most"]
    end = time.monotonic() + 60.0 * task["minutes"]
    root, log, kept = Path.cwd(), Path("build/log").absolute(), Path("build/reach.json").absolute()
    log.parent.mkdir(exist_ok=True)
    prepare(
        task["early"], {module.removeprefix("backends/")[:-3].replace("/", ".") for module in task["part"]}
    )
    # A fault that is found need not be made smaller, and a machine that is busy is no fault.
    hypothesis.settings.register_profile(
        "mutation",
        derandomize=True,
        deadline=None,
        phases=[hypothesis.Phase.explicit, hypothesis.Phase.generate],
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    hypothesis.settings.load_profile("mutation")
    gc.collect()
    gc.freeze()

    def base() -> int:
        options = [option for option in OPTIONS if option != "-x"]
        record(root, task["modules"], [*options, *task["tests"]], kept)
        return 0

    began = time.monotonic()
    if forked(base, 3600.0, log) or not kept.exists():
        sys.exit(f"the tests do not run without a fault:\n{log.read_text()[-2000:]}")
    reach = read(kept)
    said = {
        "tests": len(reach.seconds),
        "not used": reach.failed,
        "seconds": round(time.monotonic() - began, 1),
    }
    print(json.dumps(said), flush=True)
    code = {module: Path(module).read_text() for module in task["modules"]}
    drawn: list[tuple[str, made.Site]] = []
    for module, text in code.items():
        every = made.sites(text)
        broken = f"{text}\nraise RuntimeError('a module that cannot be imported')\n"
        if tried(module, broken, reach.anywhere(), reach, most, log) == "survived":
            sys.exit(f"the tests do not run the copy of {module}")
        print(json.dumps({"module": module, "mutants": len(every)}), flush=True)
        count = task["samples"][module]
        later = [site for site in every if site.line >= task["first"]]
        drawn += [(module, site) for site in made.sample(later, count, f"{task['seed']} {Path(module).name}")]
    random.Random(task["seed"]).shuffle(drawn)  # so that a run that is cut short is a random sample, too
    again = None if task["again"] is None else {tuple(one) for one in task["again"]}
    for module, site in drawn:
        began = time.monotonic()
        line = code[module].splitlines()[site.line - 1].strip()
        if again is not None and (module, line) not in {one[:2] for one in again}:
            continue
        mutant = made.mutant(code[module], site)
        if mutant is None or (again is not None and (module, mutant.was, mutant.now) not in again):
            continue
        names = reach.tests(module, code[module], mutant.line)
        row = {
            "module": module, "line": mutant.line, "operator": mutant.operator, "was": mutant.was,
            "now": mutant.now, "result": tried(module, mutant.code, names, reach, most, log), "reached": len(names),
            "seconds": round(time.monotonic() - began, 1),
        }  # fmt: skip
        print(json.dumps(row), flush=True)
        if time.monotonic() > end:
            break


if __name__ == "__main__":
    main()
