"""How often is a gap called material where there is none, and how large must a gap be to be found?

Random rollouts at 20 tests, six of them simulated at each. Lengths are in standard deviations of a simulated ρ at a
typical test; standard deviations of single tests differ by a factor of e^0.5. With ``--a1``, a twin of the A1 in other
code (benchmarks/blind/a1) walks as it should, and with motors of 0.78 of their strength. ::

    OMP_NUM_THREADS=1 python -m benchmarks.diagnose.materiality          # about two minutes on one core
    OMP_NUM_THREADS=1 python -m benchmarks.diagnose.materiality --a1     # about three minutes
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.machine import describe
from s2r_spec import load_backend, load_spec
from s2r_spec.diagnose.gap import SHOTS
from s2r_spec.diagnose.gap.materiality import Materiality, RolloutsAtTest, materiality

ROOT = Path(__file__).parents[2]
RESULTS = Path(__file__).parents[1] / "results" / "materiality.json"
FloatArray = NDArray[np.float64]

TESTS, UNEVEN, SEEDS = 20, 0.5, 400
SINGLE = (1,) * TESTS
DESIGNS = {"one real rollout a test": SINGLE, "a third three times": (3,) * 7 + (1,) * 13}
SCATTER: Mapping[str, Callable[[Generator, int], FloatArray]] = {
    "normal": lambda rng, size: rng.normal(size=size),
    "least of a window (Gumbel)": lambda rng, size: (
        (np.euler_gamma - rng.gumbel(size=size)) * np.sqrt(6) / np.pi
    ),
    "one-sided (exponential)": lambda rng, size: 1.0 - rng.exponential(size=size),
    "heavy tails (t, 5)": lambda rng, size: rng.standard_t(5, size=size) * np.sqrt(3 / 5),
}
RATIOS = (1.0, 1.5, 2.0)
"""Standard deviation of the machine's ρ, in standard deviations of the simulator's."""
GAPS = (4.0, 6.0, 8.0, 10.0, 12.0, 16.0)
"""Gaps at one of the tests, with a margin of 20."""
STRENGTH = 0.78
"""Part of their torque that the motors of the A1 have."""


def drawn(
    rng: Generator, of: str, real: tuple[int, ...], ratio: float, margin: float, gap: float
) -> Materiality:
    """Return the answer for one machine whose gap is at the last test alone."""
    scatter, size = SCATTER[of], np.exp(UNEVEN * rng.normal(size=TESTS))
    size[-1] = 1.0
    return materiality(
        [
            RolloutsAtTest(
                {"test": float(t)},
                margin - gap * (t == TESTS - 1) + ratio * size[t] * scatter(rng, real[t]),
                margin + size[t] * scatter(rng, 2 * SHOTS),
            )
            for t in range(TESTS)
        ]
    )


def rate(of: str, real: tuple[int, ...], ratio: float, margin: float, gap: float) -> float:
    """Return the part of random machines whose gap is called material."""
    answers = (drawn(np.random.default_rng([7, seed]), of, real, ratio, margin, gap) for seed in range(SEEDS))
    return sum(answer.matters for answer in answers) / SEEDS


def false_alarms() -> dict[str, dict[str, dict[str, float]]]:
    """Return the rate for machines without a gap at a margin of 0, by design, scatter and ratio of scatters."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    print(f"no gap, margin 0: called material, of {SEEDS}")
    for design, real in DESIGNS.items():
        for of in SCATTER:
            own = {f"{ratio:g}": rate(of, real, ratio, 0.0, 0.0) for ratio in RATIOS}
            found.setdefault(design, {})[of] = own
            words = ", ".join(f"{100 * one:.1f} % (scatter × {ratio})" for ratio, one in own.items())
            print(f"  {design}, {of}: {words}", flush=True)
    return found


def power() -> dict[str, float]:
    """Return the rate for machines with a gap at one test."""
    found = {f"{gap:g}": rate("normal", SINGLE, 1.0, 20.0, gap) for gap in GAPS}
    words = ", ".join(f"{gap}: {100 * one:.0f} %" for gap, one in found.items())
    print(f"a gap at one of {TESTS} tests, one real rollout each, margin 20: {words}", flush=True)
    return found


def a1() -> dict[str, object]:
    """Return the answers for a twin of the A1 in other code, and its scatter compared with the simulator's."""
    from benchmarks.blind.a1.cases import Runner, stratified, twin_of
    from benchmarks.blind.a1.effects import KNOWN

    spec, sim = load_spec(ROOT / "specs" / "a1_velocity.stl"), load_backend("sim")
    commands = [round(vd, 4) for vd in stratified(np.random.default_rng(0), TESTS)]

    def rho(trace: object, vd: float) -> float:
        return float(spec.robustness(trace, {"vd": vd})["walking"])  # type: ignore[arg-type]

    simulated = [
        np.array([rho(sim.rollout({"vd": vd}, 1000 * n + k), vd) for k in range(2 * SHOTS)])
        for n, vd in enumerate(commands)
    ]
    weak = KNOWN["motor_strength"]
    found: dict[str, object] = {}
    for name, kinds, sizes in (
        ("as it should", [], {}),
        ("weak motors", [weak], {weak.name: 1.0 - STRENGTH}),
    ):
        runner = Runner(twin_of(kinds, sizes, 5, background=0.0)[0])
        real = [rho(runner.run(vd, np.random.default_rng([7, n])), vd) for n, vd in enumerate(commands)]
        tests = [
            RolloutsAtTest({"vd": vd}, np.array([own]), other)
            for vd, own, other in zip(commands, real, simulated, strict=True)
        ]
        answer = materiality(tests, "m/s")
        changes = sum(at.changes_sign for at in answer.places)
        negative = sum(own < 0.0 for own in real)
        print(
            f"twin of the A1 in other code, {name}: real ρ < 0 at {negative} of {TESTS} tests; the gap matters at "
            f"{len(answer.places)}, the sign changes at {changes}",
            flush=True,
        )
        found[name] = {
            "rho": real,
            "places": len(answer.places),
            "changes_sign": changes,
            "negative": negative,
        }
    runner = Runner(twin_of([], {}, 5, background=0.0)[0])
    at = range(0, TESTS, 3)
    own = [
        np.var(
            [rho(runner.run(commands[n], np.random.default_rng([9, n, k])), commands[n]) for k in range(5)],
            ddof=1,
        )
        for n in at
    ]
    ratio = float(np.sqrt(np.mean(own) / np.mean([simulated[n].var(ddof=1) for n in at])))
    print(f"its scatter is {ratio:.2f} times the simulator's")
    return found | {"commands": commands, "simulated": [one.tolist() for one in simulated], "ratio": ratio}


def main() -> None:
    """Run what was asked for, and keep it beside what was run before."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--a1", action="store_true", help="compare a twin of the A1 in other code instead")
    record = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    if parser.parse_args().a1:
        record["a1"] = a1()
    else:
        record |= {"seeds": SEEDS, "false_alarms": false_alarms(), "power": power()}
    record["machine"] = describe("numpy", "scipy")
    RESULTS.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
