"""The diagnosis of the tutorial on the gap and its cause, which takes too long for a test of every day.

    python -m benchmarks.diagnose.gap_and_cause [--write]      # a minute or two of one core

Runs the `s2r diagnose` of docs/tutorials/gap-and-cause.md on the page's own specification and prints what it says.
With ``--write`` this goes to results/gap_and_cause.json, to which a test holds the page.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.machine import describe

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorials" / "gap-and-cause.md"
RESULTS = ROOT / "benchmarks" / "results" / "gap_and_cause.json"


def main() -> None:
    """Run the page's diagnosis in an empty folder."""
    page = PAGE.read_text(encoding="utf-8").replace(" \\\n    ", " ")  # a command in one line
    (command,) = re.findall(r"^s2r (diagnose .*)$", page, re.M)
    with tempfile.TemporaryDirectory() as folder:
        for name, text in re.findall(r"<!-- file: (\S+) -->\n```\w*\n(.*?)```", page, re.S):
            Path(folder, name).write_text(text, encoding="utf-8")
        words = [sys.executable, "-m", "s2r_spec", *command.split()]
        done = subprocess.run(words, cwd=folder, stdout=subprocess.PIPE, text=True, check=True)
        print(done.stdout)
        (patch,) = Path(folder).glob("*.json")
        record = {
            "machine": describe("scipy"),
            "command": f"s2r {command}",
            "output": done.stdout.splitlines(),
            "patch": json.loads(patch.read_text()),
        }
    if "--write" in sys.argv[1:]:
        RESULTS.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
