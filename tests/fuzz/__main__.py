"""Damaged specifications, traces, folders of logs and runs: an answer or one clean sentence, and never exit 4.

    python -m tests.fuzz --inputs 1000 --seed 0

Every input is a number: the same seed and number make the same files and the same command, which runs in a process
of its own, forked from one that has the libraries. What must come of it: exit code 0, 1, 2 or 3; no traceback;
no sign that commands a terminal; one JSON object if JSON was asked for; less than 5 s of processor time, and
less than 1 GB more than the libraries take. Of two ways of writing one trace the verdicts must be the same.

``--only N`` makes input N again and keeps its folder.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tests.fuzz.inputs import KINDS, Input, prepare

SECONDS = 5.0
"""Processor time of a command [s]: a level, as long as a user waits; twice as much hides slow parsers."""
MEMORY = 10**9
"""Resident bytes beyond those of the process that it is forked from: a level; twice as much hides readers that
load what they refuse."""
PATIENCE = 60.0
"""Wall time after which a command is ended [s]: it waits for something that never comes."""
LIBRARIES = (
    "tests.warm", "pydantic", "matplotlib.pyplot", "matplotlib.backends.backend_agg", "pyarrow.parquet", "numpy.random",
    "s2r_spec.lang.lints", "s2r_spec.lang.printing", "s2r_spec.lang.latex",
    "s2r_spec.certify.result.failure_probability",
    "s2r_spec.certify.gap", "s2r_spec.cli.terminal.progress", "s2r_spec.spec.plot", "s2r_spec.runs.replay",
)  # fmt: skip
"""What commands import: once, so that no fork does."""
COMMANDS_TERMINAL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")


@dataclass(frozen=True)
class Outcome:
    """What came of a command.

    Attributes:
        code: its exit code; minus the signal that ended it.
        out: its standard output.
        err: its standard error.
        seconds: of processor time.
        memory: resident bytes beyond those that it was forked with.
    """

    code: int
    out: str
    err: str
    seconds: float
    memory: int


def execute(words: Sequence[str], folder: Path) -> Outcome:
    """Run ``s2r`` with these words in a folder, in a fork of this process."""
    base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with tempfile.TemporaryDirectory() as kept:
        files = [Path(kept, name) for name in ("out", "err")]
        child = os.fork()
        if not child:
            _command(words, folder, files)
        usage, status = _waited(child)
        out, err = (path.read_text(errors="replace") if path.exists() else "" for path in files)
    code = os.waitstatus_to_exitcode(status)
    return Outcome(code, out, err, usage.ru_utime + usage.ru_stime, max(0, usage.ru_maxrss - base) * 1024)


def _command(words: Sequence[str], folder: Path, files: Sequence[Path]) -> None:
    code: object = 70
    try:
        os.setsid()
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        for descriptor, file in enumerate(files, start=1):
            os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT), descriptor)
        os.chdir(folder)
        sys.stdin, sys.stdout, sys.stderr = (
            open(number, mode, encoding="utf-8", closefd=False)  # noqa: SIM115  (for the process's life)
            for number, mode in ((0, "r"), (1, "w"), (2, "w"))
        )
        sys.argv = ["s2r", *words]
        from s2r_spec.cli import main

        main()
        code = 0
    except SystemExit as end:
        code = end.code
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(code if isinstance(code, int) else 0 if code is None else 70)


def _waited(child: int) -> tuple[resource.struct_rusage, int]:
    end = time.monotonic() + PATIENCE
    pause = 0.002
    while True:
        found, status, usage = os.wait4(child, os.WNOHANG)
        if found:
            return usage, status
        if time.monotonic() > end:
            os.killpg(child, signal.SIGKILL)
            _, status, usage = os.wait4(child, 0)
            return usage, status
        time.sleep(pause)
        pause = min(0.05, 1.5 * pause)


def wrong(asked: Input, outcome: Outcome) -> str:
    """Return what is wrong with an outcome, "" if nothing is."""
    if outcome.code == -signal.SIGKILL:
        return f"no end within {PATIENCE:g} s"
    if "Traceback (most recent call last)" in outcome.err:
        return "a traceback: " + outcome.err.strip().splitlines()[-2 if outcome.code == 4 else -1][:200]
    if asked.words[0] == "replay" and outcome.code == 4 and "the record says" in outcome.out:
        return ""  # an answer: the rollout that was run again has another ρ than the damaged record
    if outcome.code not in (0, 1, 2, 3):
        return f"exit {outcome.code}: {outcome.err.strip()[-200:]}"
    if found := COMMANDS_TERMINAL.search(outcome.out + outcome.err):
        return f"the sign {found[0]!r} in what is printed"
    if outcome.code == 2 and not outcome.err.strip():
        return "exit 2 without a sentence"
    if "--json" in asked.words and "--online" not in asked.words:
        try:
            json.loads(outcome.out, parse_constant=_not_json)
        except ValueError as error:
            return f"standard output is not one JSON object: {error}"
    if outcome.seconds > SECONDS:
        return f"{outcome.seconds:.1f} s of processor time"
    if outcome.memory > MEMORY:
        return f"{outcome.memory / 1e9:.1f} GB"
    return ""


def _not_json(name: str) -> None:
    raise ValueError(f"{name} in JSON")


def verdicts(outcome: Outcome) -> object:
    """Return what two ways of writing one trace have in common."""
    try:
        (result,) = json.loads(outcome.out)["results"]
    except (ValueError, KeyError, TypeError):
        return f"exit {outcome.code}: {outcome.err.strip()[-200:]}"
    return [(found["requirement"], found["verdict"], found["rho"]) for found in result["requirements"]]


def apart(make: Callable[[], Any]) -> Any:
    """Return what a function returns in a fork of this process: Arrow's threads must not be in those forked later."""
    with tempfile.TemporaryDirectory() as kept:
        answer, child = Path(kept, "answer"), os.fork()
        if not child:
            try:
                answer.write_text(json.dumps(make()))
            except BaseException:
                traceback.print_exc()
                os._exit(1)
            os._exit(0)
        if os.waitpid(child, 0)[1]:
            raise RuntimeError("an input could not be made: see the traceback above")
        return json.loads(answer.read_text())


def tried(number: int, seed: int, ready: Path, folder: Path, kinds: Sequence[str]) -> tuple[Input, str]:
    """Make input ``number`` in a folder and run it; return it and what is wrong, "" if nothing is."""
    kind = kinds[number % len(kinds)]
    made = apart(lambda: asdict(KINDS[kind](ready, folder, random.Random(f"{seed}.{number}"))))
    asked = Input(made["kind"], tuple(made["words"]), made["what"], tuple(made["same_as"]))
    outcome = execute(asked.words, folder)
    found = wrong(asked, outcome)
    if asked.same_as and not found:
        plain = execute(asked.same_as, folder)
        if verdicts(plain) != verdicts(outcome):
            found = f"{verdicts(outcome)} where {' '.join(asked.same_as[-1:])} gives {verdicts(plain)}"
    return asked, found


def fuzz(inputs: Sequence[int], seed: int, kinds: Sequence[str] = tuple(KINDS)) -> dict[str, object]:
    """Run inputs; return their counts and every failure with the words that make it again."""
    for library in LIBRARIES:
        importlib.import_module(library)
    counts, failures = Counter[str](), []
    with tempfile.TemporaryDirectory() as kept:
        ready = Path(kept, "ready")
        ready.mkdir()
        apart(lambda: prepare(ready))
        for number in inputs:
            folder = Path(kept, str(number))
            folder.mkdir()
            asked, found = tried(number, seed, ready, folder, kinds)
            counts[asked.kind] += 1
            if found:
                command = "s2r " + " ".join(asked.words)
                failures.append(
                    {
                        "input": number,
                        "kind": asked.kind,
                        "what": asked.what,
                        "command": command,
                        "wrong": found,
                    }
                )
            shutil.rmtree(folder)
    return {"seed": seed, "inputs": dict(counts), "failures": failures}


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--inputs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", choices=tuple(KINDS), default=tuple(KINDS))
    parser.add_argument("--only", type=int, help="make this input again, and keep its folder")
    words = parser.parse_args()
    if words.only is not None:
        kept = Path(tempfile.mkdtemp(prefix=f"s2r-fuzz-{words.seed}-{words.only}-"))
        (kept / "ready").mkdir()
        (kept / "input").mkdir()
        apart(lambda: prepare(kept / "ready"))
        asked, found = tried(words.only, words.seed, kept / "ready", kept / "input", words.kinds)
        print(f"{kept / 'input'}\n{asked.what}\ns2r {' '.join(asked.words)}\n{found or 'nothing is wrong'}")
        return
    print(json.dumps(fuzz(range(words.inputs), words.seed, words.kinds), indent=1, ensure_ascii=False))


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))
    main()
