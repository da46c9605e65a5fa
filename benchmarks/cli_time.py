"""What a person waits for: the CPU time of five commands, now and at an earlier commit.

    python -m benchmarks.cli_time [--before COMMIT]

Every command is a new process on one thread, with compiled modules on disk. Its time is the user's and the system's
together, the median of 5, with both commits in turn. Writes results/cli_time.json.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from benchmarks.a1.gaps import step_of_the_a1
from benchmarks.machine import describe

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results" / "cli_time.json"
BEFORE = "b9118f66"
CALLS, ROLLOUTS = 5, 40


def run(tree: Path, *words: str) -> float:
    """Run a command of a source tree; return its CPU time [s]."""
    surroundings = os.environ | {
        "PYTHONPATH": f"{tree}{os.pathsep}{tree / 'backends'}",
        "OMP_NUM_THREADS": "1",
    }
    surroundings.pop("PYTHONDONTWRITEBYTECODE", None)
    start = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "s2r_spec", *words], cwd=tree, env=surroundings, capture_output=True, text=True
    )
    end = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, 1, 3):
        raise RuntimeError(f"{words} in {tree}: {done.stderr}")
    return end.ru_utime + end.ru_stime - start.ru_utime - start.ru_stime


def measure(trees: dict[str, Path], folder: Path) -> list[dict[str, object]]:
    """Return a row for each command: its time in each tree [s], and the ratio."""
    spec, checked = "specs/a1_velocity.stl", folder / "run"
    for tree in trees.values():  # the first rollout of a tree compiles
        run(tree, "check", spec, "--backend", "sim", "--budget", "8", "--run", str(folder / tree.name))
    run(trees["before"], "check", spec, "--backend", "sim", "--budget", str(ROLLOUTS), "--run", str(checked))
    commands = {
        "monitor of one trace": ["monitor", spec, "specs/traces/a1_velocity_fails.csv"],
        "log of a bag": ["log", "specs/traces/drive.mcap"],
        "plan": ["plan", spec],
        "replay of one rollout": ["replay", f"{checked}/walking#0.0"],
        f"report of {ROLLOUTS} rollouts": ["report", str(checked), "--output", str(folder / "page.html")],
    }
    rows = []
    for name, words in commands.items():
        times: dict[str, list[float]] = {side: [] for side in trees}
        for call in range(CALLS + 1):
            for side, tree in trees.items():
                seconds = run(tree, *words)
                if call:  # the first one writes compiled modules
                    times[side].append(seconds)
        before, now = (round(median(times[side]), 3) for side in ("before", "now"))
        rows.append({"command": name, "s before": before, "s now": now, "ratio": round(before / now, 2)})
        print(rows[-1])
    return rows


def main() -> None:
    """Print one row a command, and write all of them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--before", default=BEFORE)
    before = parser.parse_args().before
    with TemporaryDirectory() as kept:
        tree = Path(kept, "before")
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(tree), before], check=True)
        try:
            rows = measure({"before": tree, "now": ROOT}, Path(kept))
        finally:
            subprocess.run([*git, "remove", "--force", str(tree)], check=True)
    record = {
        "machine": describe("numpy", "typer", "lark", "pint", "matplotlib"),
        "commit before": before,
        "a MuJoCo step of the A1 [us]": round(step_of_the_a1(), 1),
        "rows": rows,
    }
    RESULTS.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
