"""ρ of the same tests with the instruction sets of other processor families.

Run: OMP_NUM_THREADS=1 python -m benchmarks.a1.cpus

PIQP, NumPy and OpenBLAS choose their kernels by the processor they find, and Numba compiles for it. Here
each is made to choose as on an older one, on this machine; MuJoCo and
Pinocchio have one build for all x86-64.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np

from benchmarks.machine import processor

FAMILIES = {
    "this machine": ({}, ()),
    "AVX2 (Haswell)": (
        {"OPENBLAS_CORETYPE": "Haswell", "NUMBA_CPU_NAME": "haswell", "NPY_DISABLE_CPU_FEATURES": "X86_V4"},
        ("piqp.piqp_python_avx512",),
    ),
    "SSE (Nehalem)": (
        {
            "OPENBLAS_CORETYPE": "Nehalem",
            "NUMBA_CPU_NAME": "nehalem",
            "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4",
        },
        ("piqp.piqp_python_avx512", "piqp.piqp_python_avx2"),
    ),
}

CHILD = """
import json, sys
for module in sys.argv[1:]:
    sys.modules[module] = None  # so that importing it fails, as where it cannot run
from benchmarks.a1.trot import rho
from s2r_sim import SimBackend
tests = [(vd, seed) for vd in (-0.2, 0.0, 0.3) for seed in range(5)]
print(json.dumps([rho(SimBackend().rollout({"vd": vd}, seed), vd) for vd, seed in tests]))
"""


def found(variables: dict[str, str], blocked: tuple[str, ...]) -> np.ndarray:
    command = [sys.executable, "-c", CHILD, *blocked]
    done = subprocess.run(command, env=os.environ | variables, capture_output=True, text=True, check=True)
    return np.array(json.loads(done.stdout))


if __name__ == "__main__":
    print(f"{processor()}; largest difference of rho over 15 tests (wanted: below 1e-3)")
    reference = found(*FAMILIES["this machine"])
    met = True
    for family, choice in FAMILIES.items():
        difference = np.abs(found(*choice) - reference)
        print(f"{family:16} {difference.max():.1e}")
        met &= bool(difference.max() < 1e-3)
    print("all met" if met else "NOT all met")
    sys.exit(0 if met else 1)
