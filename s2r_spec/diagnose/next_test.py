"""The next test: where two candidates that fit alike would differ most."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import Values
from s2r_spec.diagnose.diagnosis import NextTest
from s2r_spec.diagnose.evidence import ALLOWED, FORM, GROUND
from s2r_spec.diagnose.isolability import ALIKE
from s2r_spec.diagnose.signatures import Signatures
from s2r_spec.diagnose.simulate import Bench, Test

FloatArray = NDArray[np.float64]


NEAR = 0.02
"""Of every parameter's range: a test no further than this from one that was run is not asked for again."""
SIZES = (0.5, 2.0)
"""A rival may have its effects so much weaker or stronger than they were fitted: for how large they are it is hardly
ever told apart."""


def next_test(
    bench: Bench,
    signatures: Signatures,
    rivals: Sequence[tuple[str, Values]],
    run: Sequence[Test],
    protocols: bool,
    temperature: float = 1.0,
) -> NextTest | None:
    """Return the test at which the likeliest two candidates differ most, simulated with the values fitted.

    They differ there by what neither leaves of the other at any size near its own, in units of what a diagnosis
    believes: scatter, laws that are a little off, a little of everything, and how many numbers count as one.

    Args:
        bench: with the bank's features.
        signatures: for the units of the components.
        rivals: two candidates, name and values.
        run: tests of which there are rollouts: what these could tell is told, and they are not asked for again.
        protocols: also try every parameter of the backend that the spec does not sweep, at its ends.
        temperature: by which log evidence is divided.
    """
    if len(rivals) < 2:
        return None
    tests = list(signatures.bank.tests)
    middle = tests[len(tests) // 2]
    tried: list[tuple[Test, str, Test]] = [(test, "", {}) for test in tests if not _was_run(bench, test, run)]
    if protocols:
        swept = set(bench.spec.params)
        for parameter in bench.backend.parameters:
            if parameter.name in swept:
                continue
            for value in (parameter.low, parameter.high):
                # Not the very end: a robot at the limit of what it can do tells effects apart by falling.
                eased = parameter.default + 0.4 * (value - parameter.default)
                if eased != parameter.default:
                    unit = f" {parameter.unit}" if parameter.unit else ""
                    tried.append(
                        (middle, f"with {parameter.name} = {eased:g}{unit}", {parameter.name: eased})
                    )
    best: NextTest | None = None
    for test, words, extra in tried:
        rows = _rows(bench, signatures, [values for _, values in rivals[:2]], test, extra)
        if rows is None:
            continue
        v = _believed(signatures, rows, tests.index(test))
        apart, whole = _apart(rows, v)
        if apart < ALIKE[0] ** 2 * whole:
            continue  # laws a little off would make them the same
        sigma = float(np.sqrt(apart / temperature))
        if best is None or sigma > best.sigma:
            best = NextTest({**test, **extra}, words, tuple(name for name, _ in rivals[:2]), sigma)
    return best if best is not None and best.sigma > 1.0 else None


def _believed(signatures: Signatures, rows: FloatArray, place: int) -> FloatArray:
    """Return (k, k) covariance of what a rollout may differ by from either rival; ``place`` of the test in the bank."""
    level = float((rows**2).sum(axis=1).max()) / rows.shape[1]
    little = [
        ALLOWED * curve.change[near, place] / curve.coordinates[near]
        for curve in signatures.curves
        if not curve.line.base
        for near in [int(np.abs(np.abs(curve.coordinates) - 1.0).argmin())]
    ]
    u = np.array(little).reshape(-1, rows.shape[1])
    found: FloatArray = signatures.noise + u.T @ u + (GROUND**2 + FORM**2 * level) * np.eye(rows.shape[1])
    return found


def _apart(rows: FloatArray, v: FloatArray) -> tuple[float, float]:
    """Return the square distance of two rivals (2, k), neither of a fixed size, and that of the larger from nothing."""
    seen = np.linalg.solve(v, rows.T)
    (aa, ab), (_, bb) = rows @ seen

    def left(of: float, by: float, both: float) -> float:
        size = float(np.clip(both / max(by, 1e-12), *SIZES))
        return of - 2.0 * size * both + size**2 * by

    return max(min(left(aa, bb, ab), left(bb, aa, ab)), 0.0), max(float(aa), float(bb), 0.0)


def _was_run(bench: Bench, test: Test, run: Sequence[Test]) -> bool:
    space = bench.spec.space
    reach = NEAR * (space.upper - space.lower)
    at = space.vector(test)
    return any(bool(np.all(np.abs(space.vector(other) - at) <= reach)) for other in run)


def _rows(
    bench: Bench,
    signatures: Signatures,
    values: Sequence[Values],
    test: Mapping[str, float],
    extra: Mapping[str, float],
) -> FloatArray | None:
    """Return (rivals, k) components of each less nominal, with one seed; None where a rollout fails."""
    try:
        rows = []
        for effects in ({}, *values):
            backend = bench.with_effects(effects)
            trace = backend.rollout({**bench.matched.to_backend(test), **extra}, 0)
            if trace.failure is not None:
                return None
            rows.append(bench.measure(trace, test, extra))
    except Exception:
        return None
    nominal = rows[0][signatures.kept]
    return signatures.components(np.array(rows[1:]), nominal)
