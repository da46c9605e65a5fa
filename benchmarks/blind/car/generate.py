"""Make a set of blind cases of the car: public logs, and labels apart.

Run: python -m benchmarks.blind.car.generate --cases 200 --out FOLDER [--seed N]

FOLDER/public/<id>/ is a folder of recorded rollouts with its spec, for ``s2r``;
FOLDER/sealed/<id>.json is its label, and FOLDER/sealed/<id>/ further rollouts for
scoring. Without --seed nobody, not even the author of this file, knows the set
before it is opened.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

from benchmarks.blind.car import machine  # noqa: E402
from benchmarks.blind.outsiders.generate import main  # noqa: E402

if __name__ == "__main__":
    main(machine, __doc__)
