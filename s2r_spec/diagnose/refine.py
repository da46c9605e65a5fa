"""Large effects do not add up: simulate the likeliest sets together, and go on from what is left.

The bank knows each effect alone. Where several are large, what they do together
is another thing, and the remainder is blamed on a third. So the best set is
simulated as a whole; its values, and perhaps one more effect, are fitted to what
that leaves; and so on, as long as it helps. A Gauss–Newton step whose model is
the bank and whose residual is the simulator.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import Values
from s2r_spec.diagnose.estimate import Fit, fit, signature
from s2r_spec.diagnose.evidence import Design
from s2r_spec.diagnose.isolability import FORM
from s2r_spec.diagnose.simulate import Bench, Job, run_job

FloatArray = NDArray[np.float64]

ROUNDS = 4
MOST = 3
"""Effects in a set."""
TRIED = 3
"""Further effects that are tried in a round."""
BETTER = 0.9
"""New values must leave less than this part of the misfit."""
WORTH = 0.6
"""One more effect must leave less than this part of the misfit: a law that is not ours is no second cause."""


@dataclass(frozen=True)
class Refined:
    """A set of effects that was simulated together.

    Attributes:
        members: places of the effects.
        fitted: values and intervals.
        misfit: what it leaves of the data, squared, in units of scatter, background, numerics and form error.
    """

    members: tuple[int, ...]
    fitted: Fit
    misfit: float


def refine(
    bench: Bench,
    design: Design,
    z: FloatArray,
    sets: Sequence[tuple[int, ...]],
    temperature: float,
    progress: Callable[[int, int], None] | None = None,
) -> list[Refined]:
    """Return the sets given, simulated, and what came of the best of them; best first."""
    root = 1.0 / np.sqrt(design.spectrum + FORM**2 * float(z @ z) / len(z))
    known: dict[str, FloatArray] = {}

    def simulated(values: Values) -> FloatArray:
        text = repr(sorted((name, sorted(of.items())) for name, of in values.items()))
        if text not in known:
            known[text] = _simulate(bench, design, values)
        return known[text]

    def judged(members: tuple[int, ...], fitted: Fit) -> Refined:
        rest = (z - simulated(fitted.values)) * root
        return Refined(members, fitted, float(rest @ rest) / len(rest))

    found = [judged(members, fit(design, z, members, temperature)) for members in sets]
    best = min(found, key=lambda one: one.misfit)
    for number in range(ROUNDS):
        if progress is not None:
            progress(number, ROUNDS)
        # What the bank would have to give, were it to agree with the simulator here.
        wanted = z - simulated(best.fitted.values) + signature(design, best.fitted)
        again = judged(best.members, fit(design, wanted, best.members, temperature))
        found.append(again)
        if again.misfit < BETTER * best.misfit:
            best = again
            continue
        wider = [
            judged(members, fit(design, wanted, members, temperature))
            for members in _wider(design, wanted, best)
        ]
        found += wider
        widest = min(wider, key=lambda one: one.misfit, default=best)
        if widest.misfit >= WORTH * best.misfit:
            break
        best = widest
    kept: dict[tuple[int, ...], Refined] = {}
    for one in sorted(found, key=lambda one: one.misfit):
        kept.setdefault(one.members, one)
    return [best, *(one for members, one in kept.items() if members != best.members)]


def _wider(design: Design, wanted: FloatArray, best: Refined) -> list[tuple[int, ...]]:
    """Return the set with one more effect: those that explain most of what is left."""
    if len(best.members) >= MOST:
        return []
    c = design.candidates
    root = 1.0 / np.sqrt(design.spectrum + FORM**2 * float(wanted @ wanted) / len(wanted))
    rest = (wanted - signature(design, best.fitted)) * root
    mu = c.mu * root
    gain = np.maximum.reduceat(mu @ rest - 0.5 * np.einsum("ij,ij->i", mu, mu), c.starts)
    gain[list(best.members)] = -np.inf
    order = [int(k) for k in np.argsort(-gain)[:TRIED] if gain[k] > 0]
    return [tuple(sorted((*best.members, k))) for k in order]


def _simulate(bench: Bench, design: Design, values: Values) -> FloatArray:
    """Return (D,) of the patched simulator at the bank's tests, with the random numbers of the nominal one."""
    signatures = design.signatures
    bank = signatures.bank
    rows = run_job(bench, Job(values, tuple((test, 0) for test in bank.tests)))
    difference = (rows - bank.nominal[:, 0])[:, signatures.kept] / signatures.scale
    return design.data(design.layout.through @ (np.nan_to_num(difference) @ signatures.axes.T))
