"""Mutation testing: are small faults in the code caught by its tests?

    python -m tests.mutation [PART | MODULE …] [--sample N | --all | --again] [--first LINE] [--minutes M] [--jobs N]
        [--write]

Needs the extra ``mutation``. PART is ``certify``, ``robustness`` or ``guard``; MODULE is a file of one. The working
tree is copied, and each mutant meets the tests that run its line, the fastest first. Survivors are printed with what
``judged.toml`` says of them. The exit code is 1 where one is not judged. ``--write`` keeps the results of these
modules beside those of others in benchmarks/results/mutation.txt. ``--table`` prints these alone.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.mutation import results
from tests.mutation.parts import PARTS, Part
from tests.mutation.results import Row

EXAMPLES = 0.05
"""Part of the random examples that a property is tried on (dimensionless, a budget): most faults fail on the first."""
SAMPLE = 25
"""Mutants of a module that are tried where its part does not say that all are (a budget)."""


def copied(folder: Path) -> None:
    """Copy the working tree, without what git ignores."""
    listed = subprocess.run(
        ["git", "ls-files", "-coz", "--exclude-standard"],
        cwd=results.ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    for name in filter(None, listed.stdout.split("\0")):
        if (results.ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(results.ROOT / name, folder / name)
    (folder / "build").mkdir()
    # A mutant of the same length and second as its module must not be taken for it.
    command = [
        sys.executable,
        "-m",
        "compileall",
        "-q",
        "--invalidation-mode",
        "checked-hash",
        "s2r_spec",
        "backends",
    ]
    subprocess.run(command, cwd=folder, check=True)


def tried(
    part: Part, modules: list[str], samples: dict[str, int | None], words: argparse.Namespace
) -> list[Row]:
    """Return the rows of a worker for modules of a part."""
    task = {
        "modules": modules,
        "tests": words.tests or part.tests,
        "early": part.early,
        "again": words.survivors,
        "part": part.modules(results.ROOT),
        "samples": samples,
        "seed": words.seed,
        "first": words.first,
        "most": words.seconds,
        "minutes": words.minutes,
    }
    with tempfile.TemporaryDirectory(prefix="mutation-") as kept:
        folder = Path(kept)
        copied(folder)
        path = os.pathsep.join(
            [str(folder), str(folder / "backends"), *filter(None, [os.environ.get("PYTHONPATH")])]
        )
        own = {
            "PYTHONPATH": path,
            "S2R_EXAMPLES": str(EXAMPLES),
            "OMP_NUM_THREADS": "1",
            "TMPDIR": str(folder / "build"),
        }
        command = [sys.executable, "-m", "tests.mutation.worker"]
        with subprocess.Popen(
            command,
            cwd=folder,
            env=os.environ | own,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as worker:
            assert worker.stdin is not None
            assert worker.stdout is not None
            worker.stdin.write(json.dumps(task))
            worker.stdin.close()
            rows = []
            for line in worker.stdout:
                row = json.loads(line)
                rows.append(row)
                print(f"{time.strftime('%H:%M:%S')} {line.rstrip()}", flush=True)
        if worker.returncode:
            sys.exit(worker.returncode)
    return rows


def sampled(part: Part, module: str, words: argparse.Namespace) -> int | None:
    """Return how many mutants of a module are tried; None for all."""
    if words.all or words.again or (words.sample is None and Path(module).name in part.whole):
        return None
    return SAMPLE if words.sample is None else int(words.sample)


def words_of_the_command() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__.splitlines()[0])
    parser.add_argument("wanted", nargs="*", metavar="PART | MODULE", help="without one, all parts")
    parser.add_argument(
        "--sample", type=int, help=f"mutants of each module ({SAMPLE}, or all where its part says so)"
    )
    parser.add_argument("--all", action="store_true", help="every mutant of every module")
    parser.add_argument("--again", action="store_true", help="only the survivors that are kept")
    parser.add_argument(
        "--first",
        type=int,
        default=1,
        metavar="LINE",
        help="from this line on; adds to what is kept, and counts twice what was tried before",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the random sample and of its order")
    parser.add_argument(
        "--seconds", type=float, default=20.0, help="of CPU, of the tests that a mutant meets at most"
    )
    parser.add_argument("--minutes", type=float, default=1e6, help="after which no further mutant is tried")
    parser.add_argument("--tests", nargs="+", metavar="FILE", help="instead of those of the part")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--write", action="store_true", help="to benchmarks/results, too")
    parser.add_argument("--table", action="store_true", help="try nothing, and print what is kept")
    return parser.parse_args()


def rows_of(words: argparse.Namespace) -> list[Row]:
    """Return the rows of all workers."""
    jobs = []
    for name, part in PARTS.items():
        modules = [
            one for one in part.modules(results.ROOT) if not words.wanted or {name, one} & set(words.wanted)
        ]
        if words.again:
            modules = [one for one in modules if one in {module for module, _, _ in words.survivors}]
        samples = {one: sampled(part, one, words) for one in modules}
        shares = [modules[k :: words.jobs] for k in range(words.jobs)]
        jobs += [(part, share, samples, words) for share in shares if share]
    with ThreadPoolExecutor(words.jobs) as pool:
        return [row for found in pool.map(lambda job: tried(*job), jobs) for row in found]


def about() -> list[str]:
    """Return a line about the machine and the versions."""
    sys.path.append(str(results.ROOT / "benchmarks"))
    from machine import describe

    found = describe("cosmic-ray", "coverage")
    versions = ", ".join(f"{name} {version}" for name, version in found["versions"].items())  # type: ignore[attr-defined]
    return [
        f"{found['processor']}, {found['cores']} cores, Python {found['python']}, {found['date']}, {versions}"
    ]


def main() -> None:
    words, began = words_of_the_command(), time.monotonic()
    kept = results.read() or {"about": [], "modules": {}}
    if words.table:
        print(results.table(kept), end="")
        return
    before = kept["modules"]
    words.survivors = None
    if words.again:
        words.survivors = [
            (module, row["was"], row["now"]) for module, one in before.items() for row in one["survivors"]
        ]
    fresh = results.scores(rows_of(words), before if words.again else None)
    if words.first > 1:
        fresh = {module: results.joined(before.get(module), one) for module, one in fresh.items()}
    kept["modules"] = (before if words.write else {}) | fresh
    if words.write:
        kept["about"] = about()
        results.RESULTS.write_text(json.dumps(kept, indent=1) + "\n")
        results.TABLE.write_text(results.table(kept))
    print(results.table(kept), end="")
    print(f"{time.monotonic() - began:.0f} s")
    sys.exit(1 if results.not_judged(fresh) else 0)


if __name__ == "__main__":
    main()
