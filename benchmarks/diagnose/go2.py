"""Which joint-level effects the real Go2 in the air shows, and how far its held-out gap shrinks.

    python -m benchmarks.diagnose.go2 --data ../shared/data/go2_inair          # minutes, once

The recording (iit-DLSLab/sim2real-robot-identification, BSD-3) is 23.5 s of commanded and measured joint angles at
200 Hz; its MuJoCo model comes with it. ``go2.toml`` beside this file says the rest: ideal joints, and the motor law
torque = 20 N*m/rad (target - q) - 1.5 N*m*s/rad dq of the authors' configuration. No code is of this robot. The
recording is cut into 23 tests of 1 s; those held out take no part in the estimate. Printed is the diagnosis. Its
numbers are written to go2_diagnose.json, with the values that the recording's own model file gives for comparison.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import process_time

import s2r_spec as s2r
from benchmarks.machine import describe
from s2r_spec.report.diagnosis import text

HERE = Path(__file__).parent
SPEC = HERE / "go2.stl"
RESULTS = HERE.parent / "results" / "go2_diagnose.json"
LOG = "every=1&map=t=time&map=q=dof_pos&map=target=des_dof_pos"
"""How the recording is read: seconds, one after the other, and its names of the channels."""
GIVEN = {"armature": 0.01, "viscous_friction": 0.6, "dry_friction": 0.2}
"""Joint figures in the recording's model file, the same for all joints [kg*m^2, N*m*s/rad, N*m]."""


@contextmanager
def robot(data: Path) -> Iterator[str]:
    """Yield the path of the robot file, beside a copy of the model."""
    with tempfile.TemporaryDirectory() as folder:
        for path in (data / "go2.xml", HERE / "go2.toml"):
            shutil.copy(path, folder)
        yield str(Path(folder) / "go2.toml")


def main() -> None:
    """Diagnose, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with go2.xml and traj_0.npz")
    data, spec = parser.parse_args().data, s2r.load_spec(SPEC)
    begin = process_time()
    with robot(data) as path:
        found = s2r.diagnose(spec, path, f"log:{data}?{LOG}", open_loop=True, passive=True)
    print(text(found, spec))
    answer = found.to_json()
    far = answer["how_far"]
    kept = {
        "machine": describe("mujoco"),
        "cpu [s]": round(process_time() - begin),
        "verdict": answer["verdict"],
        "answer": answer["which"]["answer"],
        "status": answer["which"]["status"],
        "posterior": {k: round(p, 4) for k, p in answer["which"]["posterior"].items() if p >= 0.02},
        "pairs": answer["which"]["pairs"][:3],
        "parameters": answer["which"]["parameters"],
        "given_by_its_model_file": GIVEN,
        "how_far": {
            key: far[key] for key in ("rollouts", "before", "after", "tuned", "floor", "share", "tuned_share")
        },
    }
    RESULTS.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
