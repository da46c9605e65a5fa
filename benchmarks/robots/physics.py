"""Go1 twins with one effect each: does the catalogue of a robot file name it?

Run: OMP_NUM_THREADS=1 python -m benchmarks.robots.physics [--cases 24] [--folder FOLDER] [--write]

A machine is a Go1 of code of its own (:mod:`.go1`): 10 runs of 5 s at forward commands over the test space, logged as a
robot logs, without the observations, actions and targets. Its robot file has ten lines, and no catalogue of its own.
Sizes are drawn between a half and one and a half of typical. Every fourth machine is healthy: it has small amounts of
all effects alone. Answers are kept in the folder, so a second call resumes.
Scores: :mod:`benchmarks.blind.scoring`.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.scoring import Axes, Scored, acting_axes, scores
from benchmarks.robots.go1 import KINDS, Machine
from benchmarks.robots.machines import LOGS, without
from benchmarks.robots.public import GO1
from s2r_spec.backend import load_backend
from s2r_spec.diagnose import diagnose
from s2r_spec.diagnose.simulator.axes import EffectAxis
from s2r_spec.spec import load_spec

RESULT = Path(__file__).parents[1] / "results" / "go1_physics.json"
SPEC = """\
signal vx {m/s}
param  vd {m/s} in [0.2, 0.8]
const  tol = 0.15 {m/s}
require walking: always[2 s, 4 s] (abs(vx - vd) <= tol)
"""
COMMANDS = np.linspace(0.22, 0.78, 10).round(4).tolist()
"""Definition: forward commands of the runs [m/s], the same for every machine, so that all share one library."""
CAUSES = (
    "dry_friction", "viscous_friction", "armature", "motor_strength", "payload", "com_offset", "slope",
    "ground_friction", "action_delay", "encoder_offset", "imu_tilt", "gyro_bias",
)  # fmt: skip
"""Definition: effects of the catalogue that the generator has a law of its own for."""
HEALTHY = 4
"""Definition: every so many machines one is healthy."""


def physics_of(number: int, axes: Axes) -> dict[str, dict[str, float]]:
    """Return effect → parameter → value of a machine: one effect, or none."""
    if number % HEALTHY == HEALTHY - 1:
        return {}
    rng = np.random.default_rng([65, number])
    effect = CAUSES[(number - number // HEALTHY) % len(CAUSES)]
    size = float(np.exp(rng.uniform(np.log(0.5), np.log(1.5))))
    own = axes[effect]
    if {axis.parameter for axis in own} == {*KINDS}:  # friction and motors: of all joints
        return {effect: {axis.parameter: _value(axis, size, rng) for axis in own}}
    axis = own[int(rng.integers(len(own)))]
    return {effect: {axis.parameter: _value(axis, size, rng)}}


def _value(axis: EffectAxis, size: float, rng: np.random.Generator) -> float:
    low, high = axis.ends
    side = -1.0 if high <= 0.0 or (low < 0.0 and axis.effect != "payload" and rng.uniform() < 0.5) else 1.0
    if axis.effect in ("motor_strength", "ground_friction"):
        side = -1.0
    return float(f"{axis.value(side * size):.4g}")


def label_of(physics: Mapping[str, Mapping[str, float]], axes: Axes) -> dict[str, Any]:
    """Return the label of a machine; small amounts are below 0.06 of typical, and count as none."""
    nominal = {
        effect: {axis.parameter: axis.nominal for axis in own} | dict(physics.get(effect, {}))
        for effect, own in axes.items()
    }
    return {
        "kind": "single" if physics else "null",
        "effects": {effect: nominal[effect] for effect in physics},
        "background": nominal,
    }


def main() -> None:
    """Diagnose every machine, and print the scores."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=24)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "s2r-go1")
    parser.add_argument("--write", action="store_true", help=f"keep scores and cases in {RESULT.name}")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    (given.folder / "go1.toml").write_text(GO1)
    (given.folder / "walk.stl").write_text(SPEC)
    robot = load_backend(str(given.folder / "go1.toml"))
    axes, cases = acting_axes(robot, load_spec(given.folder / "walk.stl").space), []
    for number in range(given.cases):
        physics, path = physics_of(number, axes), given.folder / f"{number:02d}.json"
        if not path.exists():
            machine, began = Machine(1000 + number, physics), time.process_time()
            runs = [({"vd": vd}, without(machine.drive(vd), LOGS["tau"])) for vd in COMMANDS]
            made = time.process_time() - began
            found = diagnose(
                given.folder / "walk.stl",
                robot,
                runs,
                cache=given.folder / "cache",
                where=False,
                passive=True,
            ).to_json()
            seconds = time.process_time() - began - made
            path.write_text(json.dumps({**found, "seconds": seconds}, default=float))
        one = Scored(f"{number:02d}", label_of(physics, axes), json.loads(path.read_text()), axes)
        cases.append(one)
        print(one.name, json.dumps(physics), json.dumps(one.to_json()), flush=True)
    result = {"scores": scores(cases), "cases": {one.name: one.to_json() for one in cases}}
    print(json.dumps(result["scores"], indent=1))
    if given.write:
        RESULT.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
