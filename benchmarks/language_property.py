"""Random formulas on random traces: the package against its definitions, written as loops.

    python benchmarks/language_property.py [scale]

Draws regular, irregular and continuous cases (tests/robustness/drawing.py),
evaluates each with the package and by definition (tests/robustness/
definitions.py), and writes the greatest difference over every sample to
language_property.txt. ``scale`` shortens the run.
"""

from __future__ import annotations

import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from machine import describe

sys.path.insert(0, str(Path(__file__).parents[1]))
from s2r_spec.errors import TraceError
from tests.robustness.definitions import NoSampleError, by_definition, evaluated, halvings
from tests.robustness.drawing import Case, cases

COUNTS = {"regular": 40_000, "irregular": 40_000, "hold": 16_000, "linear": 5_000}
TOLERANCE = 1e-9


def difference(case: Case) -> tuple[float, int]:
    """Return the greatest difference over the samples of a case, and how many samples there are."""
    try:
        expected = np.array(by_definition(case))
    except NoSampleError:
        try:
            evaluated(case)
        except TraceError:
            return 0.0, 0  # both refuse: a window without a sample
        return np.inf, 0
    found = evaluated(case)
    same = found == expected  # infinities, too
    with np.errstate(invalid="ignore"):
        return float(np.where(same, 0.0, np.abs(found - expected)).max()), found.size


def measure(kind: str, count: int) -> dict[str, object]:
    """Compare ``count`` cases of a kind."""
    worst, pairs, samples, refused, different = 0.0, 0, 0, 0, []

    @seed(0)
    @settings(
        max_examples=count,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=cases(kind).filter(lambda case: kind != "linear" or halvings(case.formula) <= 3))
    def compare(case: Case) -> None:
        nonlocal worst, pairs, samples, refused
        apart, size = difference(case)
        worst, pairs, samples, refused = max(worst, apart), pairs + 1, samples + size, refused + (size == 0)
        if not apart <= TOLERANCE:
            different.append(repr(case))

    start = time.perf_counter()
    compare()
    return {
        "kind": kind,
        "pairs": pairs,
        "samples compared": samples,
        "refused by both": refused,
        "greatest difference": worst,
        f"pairs beyond {TOLERANCE:g}": len(different),
        "examples": different[:3],
        "seconds": round(time.perf_counter() - start),
    }


def main() -> None:
    scale = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
    with ProcessPoolExecutor() as pool:
        results = list(pool.map(measure, COUNTS, [int(scale * count) for count in COUNTS.values()]))
    record = {"machine": describe("numpy", "hypothesis"), "results": results}
    text = json.dumps(record, indent=2, ensure_ascii=False)
    Path(__file__).with_suffix(".txt").write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()
