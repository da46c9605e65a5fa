"""The four twins of the A1, each diagnosed from 30 rollouts as the README says; tests hold README and docs to this.

    python -m benchmarks.diagnose.twins [PLACE ...]      # minutes each, and the catalogue once

A twin is the simulator with effects that its traces do not name; what it has is looked up when the answer is on disk.
Prints and keeps, in results/twins_diagnose.json, what is named with which values, how much of the held-out gap that
closes, the text as the command prints it, and the processor's time with all workers.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.machine import describe

ROOT = Path(__file__).parents[2]
RESULTS = Path(__file__).parents[1] / "results" / "twins_diagnose.json"
COMMAND = "diagnose specs/a1_velocity.stl --sim sim --real twin:{} --budget 30"


def seconds() -> float:
    """Return the processor's time of all children that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def diagnosed(place: str) -> dict[str, object]:
    """Run the command, and only then look at what the twin has."""
    words = COMMAND.format(place).split()
    before = seconds()
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, "-m", "s2r_spec", *words, "--run", f"{folder}/run", "--quiet"],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            text=True,
            check=False,
        )
        answer = json.loads(Path(folder, "run", "diagnosis.json").read_text())
    from s2r_sim.twins import PLACES

    which, far = answer["which"], answer["how_far"]
    return {
        "command": "s2r " + " ".join(words),
        "exit_code": done.returncode,
        "cpu_seconds": round(seconds() - before),
        "has": {effect: dict(values) for effect, values in PLACES[place].items()},
        "verdict": answer["verdict"],
        "answer": which["answer"],
        "set": which["set"],
        "status": which["status"],
        "parameters": which["parameters"],
        "share": far["share"],
        "tuned_share": far["tuned_share"],
        "spec_hash": answer["spec_hash"],
        "model_hash": answer["model_hash"],
        "text": done.stdout,
    }


def main() -> None:
    """Diagnose the places that are asked for, or all, and keep them beside those that are there."""
    places = sys.argv[1:] or ["lab", "grass", "sand", "ramp"]
    kept = json.loads(RESULTS.read_text()) if RESULTS.exists() else {"twins": {}}
    for place in places:
        one = diagnosed(place)
        kept["twins"][place] = one
        kept["machine"] = describe("mujoco", "pin", "piqp")
        RESULTS.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n")
        print(f"twin:{place} has {one['has']}, {one['cpu_seconds']} s of processor time\n{one['text']}")


if __name__ == "__main__":
    main()
