"""The README's `s2r certify`, run as it stands there; a test holds the README's numbers to what it gave.

::

    python -m benchmarks.certify.readme          # about 2 minutes on 2 cores
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
RESULTS = Path(__file__).parents[1] / "results" / "readme_certify.json"


def main() -> None:
    readme = (ROOT / "README.md").read_text()
    shown = re.search(r"<!-- output of: s2r (certify [^;]*);", readme)
    assert shown is not None
    with tempfile.TemporaryDirectory() as folder:
        words = [*shown[1].split(), "--run", f"{folder}/run", "--json", *sys.argv[1:]]
        done = subprocess.run(
            [sys.executable, "-m", "s2r_spec", *words],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            text=True,
            check=False,
        )
    found = json.loads(done.stdout)
    record = {
        "machine": describe("mujoco", "pin", "piqp", "torch", "gpytorch"),
        "command": f"s2r {shown[1]}",
        "exit_code": done.returncode,
        "result": json.loads(done.stdout.replace(folder, "…")),
    }
    RESULTS.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n")
    print(json.dumps(found, indent=1)[:2000])


if __name__ == "__main__":
    main()
