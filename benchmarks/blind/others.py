"""Score the diagnosis on machines of other authors: folders of logs, with their truth in ``truth.json``.

    python -m benchmarks.blind.others FOLDER [--machines t05 e03] [--cache FOLDER]

Truth is by size, as in :mod:`.scoring`. An author has names of his own for the numbers of a machine.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.blind.development import ROOT, axes
from benchmarks.blind.scoring import MUST, Axes, Scored, scores
from s2r_spec.diagnose import diagnose

SPECS = {"emps": "emps_tracking", "turtlebot": "turtlebot"}
"""Definition: backend → specification of its machines."""
NUMBERS = {
    "emps": {
        "viscous": "viscous", "coulomb": "dry", "offset": "offset", "cable": "cable", "mass": "mass",
        "motor_gain": "gain", "quadratic_drag": "drag", "delay": "delay", "current_lag": "lag",
        "force_ripple": "ripple", "encoder_ripple": "enc_ripple",
    },
    "turtlebot": {
        "position_bias": "left", "heading_bias": "angle", "latency": "latency", "speed_limit": "limit",
        "motor_lag": "lag", "wheel_radius": "radius", "uneven_wheels": "uneven", "axle_length": "axle",
        "turning_slip": "slip",
    },
}  # fmt: skip
"""Definition: backend → effect → the author's name of its first parameter."""
LOADED = 95.1089
"""Definition: mass of the axis [kg] in the author's numbers, which the catalogue counts from."""


def label(machine: Mapping[str, Any]) -> dict[str, Any]:
    """Return the label of a machine: every effect of the catalogue with its value, and the kind of the case."""
    backend, values = machine["backend"], machine["values"]
    effects = {}
    for effect, number in NUMBERS[backend].items():
        value = float(values[number]) - (LOADED if (backend, effect) == ("emps", "mass") else 0.0)
        effects[effect] = {axes_of(backend)[effect][0].parameter: value}
    unknown = "NOT in" in machine["truth"]
    large = [e for e, own in effects.items() if abs(axes_of(backend)[e][0].coordinate(*own.values())) >= MUST]
    kind = "unknown" if unknown else ("null", "single", "pair", "triple")[min(len(large), 3)]
    return {"kind": kind, "effects": {e: effects[e] for e in large}, "background": effects}


def axes_of(backend: str) -> Axes:
    """Return effect → axes of the parameters that act alone."""
    return axes("axis" if backend == "emps" else backend)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--machines", nargs="*")
    parser.add_argument("--cache", type=Path)
    given = parser.parse_args()
    truths = json.loads((given.folder / "truth.json").read_text())
    cases = []
    for name, machine in truths.items():
        backend = machine["backend"]
        if backend not in SPECS or name not in (given.machines or truths):
            continue
        began = time.process_time()
        spec = ROOT / "specs" / f"{SPECS[backend]}.stl"
        answer = diagnose(
            spec, backend, f"log:{given.folder / name}", cache=given.cache, where=False
        ).to_json()
        answer["seconds"] = time.process_time() - began
        cases.append(Scored(name, label(machine), answer, axes_of(backend)))
        print(name, machine["truth"], json.dumps(cases[-1].to_json()), file=sys.stderr, flush=True)
    print(json.dumps(scores(cases), indent=1))


if __name__ == "__main__":
    main()
