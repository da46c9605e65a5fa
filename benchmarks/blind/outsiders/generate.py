"""The command that makes a set of a machine that someone outside wrote."""

from __future__ import annotations

import argparse
import secrets
import sys
from pathlib import Path

import numpy as np

from benchmarks.blind.emps.generate import kinds_of, write_case
from benchmarks.blind.outsiders.cases import Machine, make_case


def main(machine: Machine, words: str) -> None:
    """Read the command line and make the set; ``words`` say what it is."""
    parser = argparse.ArgumentParser(description=words.splitlines()[0])
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, help="for a set that can be made again; without it, a fresh one")
    parser.add_argument("--held-out", type=int, default=20, help="further rollouts a case, for scoring")
    asked = parser.parse_args()
    if asked.out.exists() and any(asked.out.iterdir()):
        parser.error(f"{asked.out} is not empty; a set goes into a folder of its own")
    rng = np.random.default_rng(secrets.randbits(128) if asked.seed is None else asked.seed)
    kinds = kinds_of(rng, asked.cases)
    for number, kind in enumerate(kinds):
        case = make_case(machine, rng, kind, asked.held_out)
        write_case(case, rng.bytes(6).hex(), asked.out, machine.SPEC)
        print(f"{number + 1} of {len(kinds)} cases", file=sys.stderr)
