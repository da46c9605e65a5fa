"""The command that makes a set of a machine that someone outside wrote, and how its cases are written."""

from __future__ import annotations

import argparse
import csv
import json
import secrets
import shutil
import sys
from pathlib import Path

import numpy as np

from benchmarks.blind.arm.cases import Case, Machine, Rollouts, make_case
from benchmarks.blind.emps.generate import kinds_of
from s2r_spec import logs
from s2r_spec.spec import load_spec


def write_folder(rollouts: Rollouts, spec: Path, folder: Path) -> None:
    """Write rollouts as ``log:FOLDER`` reads them."""
    folder.mkdir(parents=True)
    units = load_spec(spec).space.units
    with (folder / "rollouts.csv").open("w", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["id", *(f"{name} [{unit}]" for name, unit in units.items())])
        for k, (test, trace) in enumerate(rollouts):
            logs.write(trace, folder / f"run-{k:02d}.npz")
            table.writerow([f"run-{k:02d}", *(test[name] for name in units)])


def write_case(case: Case, spec: Path, name: str, out: Path) -> None:
    """Write what is public and what is not."""
    write_folder(case.rollouts, spec, out / "public" / name)
    shutil.copy(spec, out / "public" / name / "spec.stl")
    if case.held_out:
        write_folder(case.held_out, spec, out / "sealed" / name)
    (out / "sealed").mkdir(exist_ok=True)
    (out / "sealed" / f"{name}.json").write_text(json.dumps({"id": name, **case.label}, indent=1) + "\n")


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
        write_case(case, machine.SPEC, rng.bytes(6).hex(), asked.out)
        print(f"{number + 1} of {len(kinds)} cases", file=sys.stderr)
