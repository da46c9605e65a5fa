"""What a plain least-squares fit says of the real Go2 in the air: a second opinion on `diagnose/go2.py`.

    python -m benchmarks.diagnose.go2_fit --data ../shared/data/go2_inair          # minutes, once

The simulator's joint angles are fitted to the recorded ones of the seconds that the diagnosis estimates from, first
with dry friction, viscous friction and armature of each kind of joint (hip, thigh, calf), then with friction of each
of the twelve joints by itself, and armature of each kind. Nobody asks here which effects there are: they are given.
Printed and written to go2_fit.json are the values, and how much of the gap in ρ they close in the held-out seconds.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.diagnose.go2 import SECONDS, shorter
from benchmarks.diagnose.go2_inair import JOINTS, Go2InAir, Joints, segments
from benchmarks.machine import describe
from s2r_spec.diagnose.data.rollouts import RealRollouts
from s2r_spec.diagnose.data.split import split
from s2r_spec.trace import Trace

RESULTS = Path(__file__).parents[1] / "results" / "go2_fit.json"
EVERY = 4
"""Samples, of which one is fitted."""
LOOKS = 20
"""Steps of the fit, at most."""
FloatArray = NDArray[np.float64]
Rollouts = list[tuple[dict[str, float], Trace]]


class Fitted(Go2InAir):
    """The same robot with joints as a fit has them."""

    joints: Joints

    def _joints(self) -> Joints:
        return self.joints


def robot(data: Path, joints: Joints) -> Go2InAir:
    """Return it."""
    made = Fitted(data, SECONDS)
    object.__setattr__(made, "joints", joints)
    return made


def of_kinds(x: FloatArray) -> Joints:
    """Return joints with (9,) dry friction [N*m], viscous friction [N*m*s/rad] and armature [kg*m^2] of each kind."""
    dry, viscous, armature = (tuple(map(float, np.tile(part, 4))) for part in x.reshape(3, 3))
    return Joints(friction=dry, damping=viscous, armature=armature)


def of_joints(x: FloatArray) -> Joints:
    """Return joints with (27,) dry and viscous friction of each, and armature of each kind."""
    dry, viscous, armature = (tuple(map(float, part)) for part in (x[:12], x[12:24], np.tile(x[24:], 4)))
    return Joints(friction=dry, damping=viscous, armature=armature)


def main() -> None:
    """Fit, print, write."""
    from scipy.optimize import least_squares

    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with go2.xml and traj_0.npz")
    data = parser.parse_args().data
    spec = shorter()
    (requirement,) = spec.requirements
    parts = split(RealRollouts(tuple(segments(data, SECONDS))), 0)
    seen, held = parts.train.tests, parts.held_out

    def gap(joints: Joints) -> float:
        model = robot(data, joints)
        apart = [
            spec.robustness(trace, test)[requirement]
            - spec.robustness(model.rollout(test, 0), test)[requirement]
            for test, trace in held
        ]
        return float(np.abs(apart).mean())

    def fitted(make: Any, begin: list[float]) -> tuple[FloatArray, bool]:
        def left(x: FloatArray) -> FloatArray:
            model = robot(data, make(x))
            rows = [(model.rollout(test, 0)["q"] - trace["q"])[::EVERY].ravel() for test, trace in seen]
            return np.concatenate(rows)

        found = least_squares(left, begin, bounds=(0.0, 3.0), diff_step=0.05, ftol=1e-3, max_nfev=LOOKS)
        return np.asarray(found.x, dtype=np.float64), bool(found.status > 0)

    before = gap(Joints())
    kinds, kinds_done = fitted(of_kinds, [0.2] * 3 + [0.2] * 3 + [0.02] * 3)
    each, each_done = fitted(of_joints, [0.3] * 12 + [0.2] * 12 + [0.02] * 3)
    names = ("dry_friction [N*m]", "viscous_friction [N*m*s/rad]", "armature [kg*m^2]")
    kept = {
        "machine": describe("mujoco", "scipy"),
        "held_out": len(held),
        "gap_before": round(before, 4),
        "of_kinds": {
            name: dict(zip(("hip", "thigh", "calf"), np.round(part, 4).tolist(), strict=True))
            for name, part in zip(names, kinds.reshape(3, 3), strict=True)
        },
        "of_kinds_converged": kinds_done,
        "of_kinds_closes": round(1.0 - gap(of_kinds(kinds)) / before, 3),
        "of_each_joint": {
            name: dict(zip(JOINTS, np.round(part, 3).tolist(), strict=True))
            for name, part in zip(names, each[:24].reshape(2, 12), strict=False)
        },
        "of_each_joint_converged": each_done,
        "of_each_joint_closes": round(1.0 - gap(of_joints(each)) / before, 3),
    }
    print(json.dumps(kept, indent=1))
    RESULTS.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
