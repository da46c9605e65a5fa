"""Make a set of blind cases of a machine that someone outside wrote: public logs, and labels apart.

Run: python -m benchmarks.blind.outsiders.generate car --cases 200 --out FOLDER [--seed N]

FOLDER/public/<id>/ is a folder of recorded rollouts with its spec, for ``s2r``;
FOLDER/sealed/<id>.json is its label, and FOLDER/sealed/<id>/ further rollouts for
scoring. Without --seed nobody, not even the author of this file, knows the set
before it is opened.
"""

from __future__ import annotations

import argparse
import secrets
import sys
from importlib import import_module
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[3]
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

from benchmarks.blind.emps.generate import kinds_of, write_case  # noqa: E402
from benchmarks.blind.outsiders.cases import Machine, make_case  # noqa: E402

MACHINES = ("arm", "quad", "car", "segway")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("machine", choices=MACHINES)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, help="for a set that can be made again; without it, a fresh one")
    parser.add_argument("--held-out", type=int, default=20, help="further rollouts a case, for scoring")
    asked = parser.parse_args()
    if asked.out.exists() and any(asked.out.iterdir()):
        parser.error(f"{asked.out} is not empty; a set goes into a folder of its own")
    machine: Machine = import_module(f"benchmarks.blind.{asked.machine}.machine")
    rng = np.random.default_rng(secrets.randbits(128) if asked.seed is None else asked.seed)
    kinds = kinds_of(rng, asked.cases)
    for number, kind in enumerate(kinds):
        case = make_case(machine, rng, kind, asked.held_out)
        write_case(case, rng.bytes(6).hex(), asked.out, machine.SPEC)
        print(f"{number + 1} of {len(kinds)} cases", file=sys.stderr)


if __name__ == "__main__":
    main()
