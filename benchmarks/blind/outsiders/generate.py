"""Make a set of blind cases of a machine with code of its own: public logs, and labels apart.

Run: python -m benchmarks.blind.outsiders.generate car --cases 200 --out FOLDER [--seed N]

What is in FOLDER, and what a seed gives away, is said in benchmarks/blind/README.md.
"""

from __future__ import annotations

import argparse
import sys
from importlib import import_module

from benchmarks.blind.emps.generate import asked, kinds_of, write_case
from benchmarks.blind.outsiders.cases import Machine, make_case

MACHINES = ("arm", "quad", "car", "segway", "turtlebot")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("machine", choices=MACHINES)
    arguments, rng = asked(parser)
    machine: Machine = import_module(f"benchmarks.blind.{arguments.machine}.machine")
    kinds = kinds_of(rng, arguments.cases)
    for number, kind in enumerate(kinds):
        case = make_case(machine, rng, kind, arguments.held_out)
        write_case(case, rng.bytes(6).hex(), arguments.out, machine.SPEC)
        print(f"{number + 1} of {len(kinds)} cases", file=sys.stderr)


if __name__ == "__main__":
    main()
