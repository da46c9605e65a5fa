"""The next test: where two candidates that fit alike would differ most."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import Values
from s2r_spec.diagnose.diagnosis import NextTest
from s2r_spec.diagnose.evidence import FORM
from s2r_spec.diagnose.isolability import ALIKE
from s2r_spec.diagnose.signatures import Signatures
from s2r_spec.diagnose.simulate import Bench, Test

FloatArray = NDArray[np.float64]


NEAR = 0.02
"""Of every parameter's range: a test no further than this from one that was run is not asked for again."""


def next_test(
    bench: Bench,
    signatures: Signatures,
    rivals: Sequence[tuple[str, Values]],
    run: Sequence[Test],
    protocols: bool,
) -> NextTest | None:
    """Return the test at which the likeliest two candidates differ most, simulated with the values fitted.

    Args:
        bench: with the bank's features.
        signatures: for the units of the components.
        rivals: two candidates, name and values.
        run: tests of which there are rollouts: what these could tell is told, and they are not asked for again.
        protocols: also try every parameter of the backend that the spec does not sweep, at its ends.
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
        difference = rows[0] - rows[1]
        form = FORM**2 * max(float((rows[2:] ** 2).sum(axis=1).max()), 1e-12) / len(difference)
        v = signatures.noise + form * np.eye(len(difference))
        apart, *sizes = (max(float(x @ np.linalg.solve(v, x)), 0.0) for x in (difference, *rows[:2]))
        if apart < ALIKE[0] ** 2 * max(sizes):
            continue  # laws a little off would make them the same
        sigma = float(np.sqrt(apart))
        if best is None or sigma > best.sigma:
            best = NextTest({**test, **extra}, words, tuple(name for name, _ in rivals[:2]), sigma)
    return best if best is not None and best.sigma > 1.0 else None


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
    """Return components of each rival and of each less nominal, with one seed; None where a rollout fails."""
    try:
        rows = []
        for effects in ({}, *values):
            backend = bench.with_effects(effects)
            trace = backend.rollout({**bench.matched.to_backend(test), **extra}, 0)
            if trace.failure is not None:
                return None
            rows.append(bench.measure(trace, test))
    except Exception:
        return None
    nominal = rows[0][signatures.kept]
    parts = signatures.components(np.array(rows[1:]), nominal)
    return np.concatenate([parts, parts])
