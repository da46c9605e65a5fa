"""What `s2r diagnose` says of the recordings of the real EMPS axis; a test holds the documentation to it.

    python -m benchmarks.diagnose.emps --data ../shared/data/emps       # minutes, once

The file with friction against the simulator without any; then the file with labelled pulses against the simulator
with the friction that the machine's authors document. Prints both diagnoses and, as a check that no probability
went into, what the known control law leaves of the recorded voltage before and after what is named is added to it;
keeps all numbers in emps_diagnose.json. The recordings stay out of the repository.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

import s2r_spec as s2r
from benchmarks.diagnose.emps_recordings import DOCUMENTED, FILES, SPEC, segments
from benchmarks.machine import describe
from s2r_emps import EmpsBackend
from s2r_spec.effects import Values
from s2r_spec.report.diagnosis import text

RESULTS = Path(__file__).parents[1] / "results" / "emps_diagnose.json"


def main() -> None:
    """Diagnose, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with DATA_EMPS.mat")
    given = parser.parse_args()
    spec = s2r.load_spec(SPEC)
    ideal = f"emps:reference={given.data / FILES['friction']}"
    rubbed = ",".join(
        (ideal, *(f"{e}.{name}={value}" for e, p in DOCUMENTED.items() for name, value in p.items()))
    )
    kept: dict[str, object] = {"machine": describe("scipy"), "documented": DOCUMENTED}
    for name, simulator in (("friction", ideal), ("pulses", rubbed)):
        rollouts = segments(given.data / FILES[name])
        found = s2r.diagnose(spec, simulator, rollouts)
        print(f"{name}\n{text(found, spec)}")
        voltage = unexplained(simulator, rollouts, {}), unexplained(simulator, rollouts, found.patch)
        print(
            f"the control law leaves {voltage[0]:.4f} V of the recorded voltage, {voltage[1]:.4f} V as named\n"
        )
        answer = found.to_json()
        kept[name] = {
            "verdict": answer["verdict"],
            **{key: answer["which"][key] for key in ("answer", "set", "status", "parameters")},
            "pairs": answer["which"]["pairs"][:3],
            **{key: answer["how_far"][key] for key in ("before", "after", "tuned", "share", "tuned_share")},
            "control law leaves": [round(each, 4) for each in voltage],
            "text": text(found, spec),
        }
    RESULTS.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n")


def unexplained(simulator: str, rollouts: list[tuple[dict[str, float], s2r.Trace]], patch: Values) -> float:
    """Return the root mean square of the recorded voltage less the control law's, with these effects [V]."""
    machine = EmpsBackend(simulator.removeprefix("emps:")).with_effects(patch)
    rest = [machine.residuals(trace, test)["controller"] for test, trace in rollouts]
    return float(np.sqrt(np.mean(np.concatenate(rest) ** 2)))


if __name__ == "__main__":
    main()
