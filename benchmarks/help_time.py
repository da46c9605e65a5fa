"""Time of ``s2r --help`` over the time of importing typer and rich, in alternating runs.

python benchmarks/help_time.py [RUNS]
"""

from __future__ import annotations

import os
import subprocess
import sys
from statistics import median

IMPORTS = (sys.executable, "-c", "import typer, rich")
HELPS = {
    "s2r --help": (sys.executable, "-m", "s2r_spec", "--help"),
    "s2r check --help": (sys.executable, "-m", "s2r_spec", "check", "--help"),
}


def processor_seconds(command: tuple[str, ...]) -> float:
    """Return the processor time of a process [s]."""
    before = os.times()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 15
    for name, command in HELPS.items():
        pairs = [(processor_seconds(command), processor_seconds(IMPORTS)) for _ in range(runs)]
        ratio = median(one / other for one, other in pairs)
        print(f"{name}: {ratio:.2f} times `import typer, rich` (median of {runs} pairs)")


if __name__ == "__main__":
    main()
