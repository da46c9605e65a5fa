"""What does an iteration of the search cost beside SafeOpt's?

The same line of tests, one rollout an iteration, nothing fitted on either side. SafeOpt bounds 501 points
with one width that is given to it; s2r bounds the whole box for four norms, with widths from the data. SafeOpt
needs numpy below 2, and so an interpreter of its own::

    python3 -m venv so && so/bin/pip install 'numpy<2' 'scipy<1.13' GPy safeopt
    OMP_NUM_THREADS=1 python benchmarks/certify_safeopt.py so/bin/python          # about 2 minutes
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
from pathlib import Path

from certify_speed import loops
from machine import describe

RESULTS = Path(__file__).parent / "results" / "certify_safeopt.json"
LOOP = Path(__file__).parent / "safeopt_loop.py"
# The function lies in [-0.1, 0.1]: with the finite threshold every test is safe in the end, and has to be found so.
WORDS = ("-inf:100", "-inf:300", "-0.3:30", "-0.3:60")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("python", help="an interpreter that has SafeOpt")
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [options.python, str(LOOP), *WORDS],
        env=environment | {"OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    theirs = json.loads(done.stdout.splitlines()[-1])
    loops(2)  # imports and first calls
    ours = {count: loops(count)["s2r"] for count in (30, 60, 100, 300)}
    rows = []
    for word, seconds in theirs["seconds"].items():
        threshold, _, count = word.partition(":")
        mine = ours[int(count)]
        rows.append({"threshold": threshold, "iterations": int(count), "s2r": mine, "safeopt": seconds})
        print(
            f"{count:>3} iterations, SafeOpt's threshold {threshold}: s2r {mine:.2f} s, SafeOpt {seconds:.2f} s "
            f"({seconds / mine:.2f} ×)"
        )
    record = {
        "machine": describe("numpy", "torch", "gpytorch"),
        "versions": theirs["versions"],
        "load_average": os.getloadavg()[0],
        "rows": rows,
    }
    options.output.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
