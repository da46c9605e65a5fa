"""Which joint-level effects the real Go2 in the air shows, and how far its held-out gap shrinks.

    python -m benchmarks.diagnose.go2 --data ../shared/data/go2_inair          # minutes, once

The simulator starts from ideal joints. The recording is cut into 22 rollouts of 1 s; those held out take no part
in the naming. Prints the diagnosis and writes its numbers to go2_diagnose.json, with the values that the recording's
own model file gives for comparison. The recording itself stays out of the repository.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import s2r_spec as s2r
from benchmarks.diagnose.go2_inair import GIVEN, SPEC, Go2InAir, segments
from benchmarks.machine import describe
from s2r_spec.report.diagnosis import text
from s2r_spec.spec import Spec, parse_spec

SECONDS = 1.0
RESULTS = Path(__file__).parents[1] / "results" / "go2_diagnose.json"


def shorter() -> Spec:
    """Return the spec for rollouts of 1 s, half of what it asks for: enough of them that some can be held out."""
    whole = s2r.load_spec(SPEC)
    return parse_spec(
        whole.text.replace("always[0, 2 s]", "always[0, 1 s]").replace("[0, 21.4]", "[0, 22.4]"), whole.name
    )


def main() -> None:
    """Diagnose, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with go2.xml and traj_0.npz")
    given = parser.parse_args()
    spec = shorter()
    found = s2r.diagnose(spec, Go2InAir(given.data), segments(given.data, SECONDS))
    print(text(found, spec))
    answer = found.to_json()
    far = answer["how_far"]
    kept = {
        "machine": describe("mujoco"),
        "verdict": answer["verdict"],
        "answer": answer["which"]["answer"],
        "set": answer["which"]["set"],
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
