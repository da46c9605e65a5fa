"""Are small faults in a module caught by its tests? Cosmic Ray makes the faults and runs the tests.

    python -m tests.mutation MODULE … [--tests FILE …] [--sample N] [--seed S]

Needs the extra ``mutation``. Faults go into a copy of the working tree, one at a time. By default the tests are those
of the module's room that import it; one fault takes their time. Survivors are printed with what ``judged.toml`` says of
them, and the exit code is 1 where one is not judged.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cosmic_ray.commands import execute, init
from cosmic_ray.config import ConfigDict
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import TestOutcome, WorkerOutcome, WorkResult

ROOT = Path(__file__).parents[2]
JUDGED = Path(__file__).with_name("judged.toml")
OPERATORS = re.compile(
    r"ReplaceBinaryOperator_(Add_Sub|Sub_Add|Mul_Div|Div_Mul|FloorDiv_Mul|Mod_Mul|Pow_Mul|BitAnd_BitOr|BitOr_BitAnd"
    r"|LShift_RShift|RShift_LShift)|ReplaceComparisonOperator_(Lt_LtE|Lt_GtE|LtE_Lt|LtE_Gt|Gt_GtE|Gt_LtE|GtE_Gt|GtE_Lt"
    r"|Eq_NotEq|NotEq_Eq|Is_IsNot|IsNot_Is)|ReplaceUnaryOperator_Delete_\w+|ReplaceTrueWithFalse|ReplaceFalseWithTrue"
    r"|ReplaceAndWithOr|ReplaceOrWithAnd|AddNot|ReplaceBreakWithContinue|ReplaceContinueWithBreak|NumberReplacer"
    r"|ExceptionReplacer|ZeroIterationForLoop"
)
"""Definition: faults that a person could make. Cosmic Ray's others replace an operator by one that fails at once."""
EXAMPLES = "0.05"
"""Budget: the part of the random examples that a property is tried on."""
PATIENCE = 10.0
"""Budget [s]: a mutant hangs if it takes four times the tests' own time and this."""


def importing(module: str) -> list[str]:
    """Return the tests that import a module, a path relative to the repository, in the folder of its room."""
    parts = module.removeprefix("backends/").removesuffix(".py").split("/")
    room = parts[1] if parts[0] == "s2r_spec" else parts[0].removeprefix("s2r_")
    package, name = ".".join(parts[:-1]), parts[-1]
    imports = re.compile(rf"\b{re.escape(package)}\.{name}\b|from {re.escape(package)} import .*\b{name}\b")
    tests = sorted((ROOT / "tests" / room).rglob("test_*.py"))
    found = [str(path.relative_to(ROOT)) for path in tests if imports.search(path.read_text())]
    return found or sys.exit(f"no test in tests/{room} imports {module}; name them with --tests")


def spared(code: str) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Yield where no test should catch a fault: text, annotations, decorators, and what only the type checker reads."""
    for node in ast.walk(ast.parse(code)):
        found: list[Any] = []
        match node:
            case ast.JoinedStr():
                found = [node]
            case ast.arg(annotation=ast.expr() as annotation) | ast.AnnAssign(annotation=annotation):
                found = [annotation]
            case ast.Call(func=ast.Name(id="zip"), keywords=[keyword]):
                found = [keyword.value]
            case ast.If(test=ast.Name(id="TYPE_CHECKING")):
                found = [node]
            case ast.FunctionDef():
                found = [*node.decorator_list, *filter(None, [node.returns])]
            case ast.ClassDef():
                found = node.decorator_list
        yield from (((one.lineno, one.col_offset), (one.end_lineno, one.end_col_offset)) for one in found)


def chosen(session: WorkDB, code: str, sample: int | None, seed: int) -> int:
    """Skip the mutants that are not tried; return how many remain."""
    never = list(spared(code))
    kept, skipped = [], []
    for item in session.pending_work_items:
        [one] = item.mutations
        place = any(first <= one.start_pos < last for first, last in never)
        (skipped if place or not OPERATORS.fullmatch(one.operator_name.split("/")[-1]) else kept).append(item)
    random.Random(seed).shuffle(kept)
    count = len(kept) if sample is None else min(sample, len(kept))
    for item in skipped + kept[count:]:
        session.set_result(item.job_id, WorkResult(worker_outcome=WorkerOutcome.SKIPPED))
    return count


def survivors(module: str, tests: list[str], sample: int | None, seed: int) -> list[tuple[str, str, str]]:
    """Try mutants in the working folder; return module, line and changed line of those that the tests let pass."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
    began = time.monotonic()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    patience = 4 * (time.monotonic() - began) + PATIENCE
    given = {"test-command": shlex.join(command), "timeout": patience, "distributor": {"name": "local"}}
    with use_db("session.sqlite", WorkDB.Mode.create) as session:
        init([Path(module)], session, {})
        tried = chosen(session, Path(module).read_text(), sample, seed)
        print(f"{module}: {tried} mutants, {patience:.0f} s each at most, by {' '.join(tests)}", flush=True)
        execute(session, ConfigDict(given))
        left = [found.diff for _, found in session.results if found.test_outcome == TestOutcome.SURVIVED]
    Path("session.sqlite").unlink()
    print(f"{module}: {tried - len(left)} killed, {len(left)} survived", flush=True)
    return sorted((module, *changed(diff)) for diff in left)


def changed(diff: str) -> tuple[str, str]:
    """Return the first line that a fault changes, without and with it."""
    lines = [line for line in diff.splitlines() if line[:3] not in ("---", "+++")]
    was, now = (next((x[1:].strip() for x in lines if x.startswith(sign)), "") for sign in "-+")
    return was, now


def main() -> None:
    """Try the modules that are named, and print the survivors."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="+", metavar="MODULE", help="a file, relative to the repository")
    parser.add_argument("--tests", nargs="+", metavar="FILE", help="instead of those that import the module")
    parser.add_argument("--sample", type=int, help="mutants of each module; without it, all")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    words = parser.parse_args()
    judged = tomllib.loads(JUDGED.read_text())["judged"]
    reasons = {(one["module"], one["was"], one["now"]): one["because"] for one in judged}
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(".*", "__pycache__"), dirs_exist_ok=True)
        os.chdir(folder)
        path = filter(None, [folder, f"{folder}/backends", os.environ.get("PYTHONPATH")])
        os.environ |= {"PYTHONPATH": os.pathsep.join(path), "S2R_EXAMPLES": EXAMPLES, "OMP_NUM_THREADS": "1"}
        left = [
            row
            for one in words.modules
            for row in survivors(one, words.tests or importing(one), words.sample, words.seed)
        ]
        os.chdir(ROOT)
    for module, was, now in left:
        print(f"\n{module}\n  - {was}\n  + {now}\n  {reasons.get((module, was, now), 'NOT JUDGED')}")
    sys.exit(any(row not in reasons for row in left))


if __name__ == "__main__":
    main()
