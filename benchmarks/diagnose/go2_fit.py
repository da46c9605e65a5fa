"""What a plain least-squares fit says of the real Go2 in the air: a second opinion on `diagnose/go2.py`.

    python -m benchmarks.diagnose.go2_fit --data ../shared/data/go2_inair          # minutes, once

The simulator's joint angles are fitted to the recorded ones of the seconds that the diagnosis estimates from, first
with dry friction, viscous friction and armature of each kind of joint (hip, thigh, calf), then with the dry friction of
each of the twelve joints by itself, and last with a friction that grows with the joint's position. Nobody asks here
which effects there are: they are given. Printed and written to go2_fit.json are the values, and how much of the gap in
ρ they close in the held-out seconds.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import s2r_spec as s2r
from benchmarks.diagnose.go2 import LOG, SPEC, robot
from benchmarks.machine import describe
from s2r_spec.backend import load_backend
from s2r_spec.diagnose.data.rollouts import recorded_inputs, recorded_rollouts
from s2r_spec.diagnose.data.split import split
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.diagnose.simulator.open_loop import OpenLoop

RESULTS = Path(__file__).parents[1] / "results" / "go2_fit.json"
KINDS, LEGS = ("hip", "thigh", "calf"), ("fl", "fr", "rl", "rr")
EVERY = 4
"""Samples, of which one is fitted."""
LOOKS = 12
"""Steps of the fit, at most."""
FloatArray = NDArray[np.float64]
Values = dict[str, dict[str, float]]
SIZES = {"dry_friction": 0.3, "viscous_friction": 0.2, "armature": 0.02}
"""Where the fit begins, and the units of its steps [N*m, N*m*s/rad, kg*m^2]."""


def values_of(x: FloatArray) -> Values:
    """Return the effects of (9,), (21,) or (24,) numbers: of kinds; the excess of each joint; growth by position."""
    found: Values = {
        name: dict(zip(KINDS, (size * part).tolist(), strict=True))
        for (name, size), part in zip(SIZES.items(), x[:9].reshape(3, 3), strict=True)
    }
    more = [f"{kind}_{leg}" for kind in KINDS for leg in LEGS] + [f"{kind}_by_position" for kind in KINDS]
    found["dry_friction"] |= dict(zip(more, x[9:].tolist(), strict=False))
    return found


def main() -> None:
    """Fit, print, write."""
    from scipy.optimize import least_squares

    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with go2.xml and traj_0.npz")
    data, spec = parser.parse_args().data, s2r.load_spec(SPEC)
    (requirement,) = spec.requirements
    kept: dict[str, Any] = {"machine": describe("mujoco", "scipy")}
    with robot(data) as path:
        real, simulator = load_backend(f"log:{data}?{LOG}"), load_backend(path)
        replayed = OpenLoop.of(simulator, spec, recorded_inputs(spec, requirement, simulator, real))
        bench = Bench.of(spec, requirement, replayed)
        parts = split(recorded_rollouts(bench, real), 0)
        seen, held = parts.train.tests, parts.held_out

        def gap(values: Values) -> float:
            runs = bench.with_effects(values)
            apart = [bench.rho(trace, test) - bench.rho(runs.rollout(test, 0), test) for test, trace in held]
            return float(np.abs(apart).mean())

        def left(x: FloatArray) -> FloatArray:
            runs = bench.with_effects(values_of(x))
            rows = []
            for test, trace in seen:
                played = runs.rollout(test, 0)["q"]
                rows.append((played[: len(trace)] - trace["q"][: len(played)])[::EVERY].ravel())
            return np.concatenate(rows)

        before = gap({})
        kept |= {"held_out": len(held), "gap_before": round(before, 4)}
        begin = np.ones(9)
        for name, more in (("of_kinds", 0), ("of_each_joint", 12), ("by_position", 15)):
            start = np.concatenate([begin, np.full(more, 0.1)])
            low = np.where(np.arange(start.size) < 9, 0.0, -0.79)
            found = least_squares(
                left, start, bounds=(low, np.where(low < 0.0, 0.79, 5.0)), diff_step=0.05, ftol=1e-3, max_nfev=LOOKS,
                x_scale=np.where(low < 0.0, 0.3, 1.0),
            )  # fmt: skip
            values = values_of(found.x)
            kept[name] = {effect: {k: round(v, 4) for k, v in own.items()} for effect, own in values.items()}
            kept[f"{name}_closes"] = round(1.0 - gap(values) / before, 3)
            print(name, kept[f"{name}_closes"], flush=True)
    print(json.dumps(kept, indent=1))
    RESULTS.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
