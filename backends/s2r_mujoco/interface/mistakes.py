"""Which simple mistake turns what the files say into what a log has?

Data: n ticks of a quantity as the files give it, e (n, w), and as it was logged, o (n, w). Unknown: a mistake g of a
family, the simplest first: missing, late by k ticks, a factor, signs, another order of components, axes of the
world, another quantity of the same width, constants. Model: o = g(e), exactly, up to what a log rounds.

Estimator: each form by least squares. The equation holds where the rms error is at most RESOLUTION of the rms of e
about its mean, or what the log rounds to. A mistake is found where with it the equation holds, or where it leaves at
most CLEAR of the error. Of several, the first of the family that leaves no more than CLEAR more than the best.

Units: those of the quantity. Shapes: n ticks, w components.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from s2r_mujoco.arrays import FloatArray

RESOLUTION = 2e-3
"""Tolerance: relative rms error up to which an equation holds: messages round, and 32-bit floats too."""
CLEAR = 0.1
"""Level: part of the error that a mistake may leave."""
LATEST = 10
"""Budget: ticks by which a quantity may be late."""
FACTORS = {
    -1.0: "the sign is wrong",
    180.0 / np.pi: "in degrees instead of radians",
    np.pi / 180.0: "turned into radians twice",
}
"""Definition: factor → what it usually means."""
NEAR = 0.01
"""Tolerance: relative distance of a factor from a usual one, and from 1, where it is no mistake."""
COARSE = 0.01
"""Tolerance: part of its range that the smallest step of a log may be, to be one of rounding."""
FEWEST = 5
"""Budget: ticks from which on a mistake is looked for."""


@dataclass(frozen=True)
class Mistake:
    """A mistake with the (n, w) values that it makes of what the files say.

    Attributes:
        kind: missing, late, factor, signs, order, constant, world or other.
        words: what was found, with its numbers.
        equation: the equation that holds.
        made: (n, w) values; NaN where it says nothing, as before the first late tick.
    """

    kind: str
    words: str
    equation: str
    made: FloatArray


@dataclass(frozen=True)
class Verdict:
    """Whether an equation holds, the mistake that explains it if not, and since which tick it does not hold.

    Attributes:
        holds: whether the logged values are those of the files.
        error, size: rms error of the equation as it is, and rms of the quantity by the files.
        mistake: the simplest mistake; None where none explains the log.
        left: rms error with it.
        since: the first tick that breaks the equation.
    """

    holds: bool
    error: float
    size: float
    mistake: Mistake | None = None
    left: float = np.inf
    since: int = 0


def judged(
    name: str,
    expected: FloatArray,
    logged: FloatArray,
    components: Sequence[str],
    others: Mapping[str, FloatArray] | None = None,
    turn: FloatArray | None = None,
) -> Verdict:
    """Return the verdict on one quantity.

    Args:
        name: of the quantity, in equations.
        expected: (n, w) values by the files.
        logged: (n, w) values of the log.
        components: name of each.
        others: name → (n, w) of further quantities that may stand in its place.
        turn: (n, 3, 3) attitude, whose columns are the axes of the body in the world; of a vector alone.
    """
    scale = max(_rms(expected - expected.mean(axis=0)), _rms(logged - logged.mean(axis=0)))
    most = RESOLUTION * max(scale, 1e-9) + rounding(logged)
    error, size = _rms(logged - expected), _rms(expected)
    if error <= most or len(logged) < FEWEST:
        return Verdict(True, error, size)
    wrong = np.abs(logged - expected).max(axis=1) > 3.0 * most
    since = int(np.argmax(wrong)) if wrong.any() else 0
    rows = slice(since if len(logged) - since >= FEWEST else 0, None)  # before it the equation holds
    others = {key: values[rows] for key, values in (others or {}).items()}
    turn = None if turn is None else turn[rows]
    found = [
        (_rms((logged[rows] - one.made)[np.isfinite(one.made).all(axis=1)]), one)
        for one in _family(name, expected[rows], logged[rows], components, others, turn)
    ]
    best = min((left for left, _ in found), default=np.inf)
    for left, one in found:
        if left <= most or (left <= CLEAR * error and left <= best * (1.0 + CLEAR)):
            return Verdict(False, error, size, one, left, since)
    return Verdict(False, error, size, None, best, since)


def _family(
    name: str,
    e: FloatArray,
    o: FloatArray,
    components: Sequence[str],
    others: Mapping[str, FloatArray],
    turn: FloatArray | None,
) -> Iterator[Mistake]:
    yield Mistake("missing", "is always zero", f"{name} = 0", np.zeros_like(e))
    for ticks in range(1, min(LATEST, len(e) // 2) + 1):
        made = np.full_like(e, np.nan)
        made[ticks:] = e[:-ticks]
        yield Mistake(
            "late", f"is {ticks} tick{'s' * (ticks > 1)} late", f"{name}[k] = files[k − {ticks}]", made
        )
    factor = float((e * o).sum() / max((e * e).sum(), 1e-300))
    if abs(factor - 1.0) > NEAR:
        yield Mistake("factor", _factor_words(factor), f"{name} = {factor:.4g} · files", factor * e)
    yield from _signs(name, e, o, components)
    yield from _order(name, e, o, components)
    if turn is not None:
        for words, made in (
            ("is in axes of the world", np.einsum("nij,nj->ni", turn, e)),
            ("is turned by the inverse of the attitude", np.einsum("nji,nj->ni", turn, e)),
        ):
            yield Mistake("world", words, f"{name} = R files", made)
    for other, values in others.items():
        if values.shape == e.shape:
            yield Mistake("other", f"holds {other}", f"{name} = {other}", values)
    shift = np.median(o - e, axis=0)
    yield Mistake(
        "constant", f"is off by {_numbers(shift)}", f"{name} = files + [{_numbers(shift)}]", e + shift
    )


def _factor_words(factor: float) -> str:
    usual = [words for one, words in FACTORS.items() if abs(factor / one - 1.0) <= NEAR]
    return f"is {factor:.3g} times as large" + (f": {usual[0]}" if usual else "")


def _signs(name: str, e: FloatArray, o: FloatArray, components: Sequence[str]) -> Iterator[Mistake]:
    signs = np.where((e * o).sum(axis=0) < 0.0, -1.0, 1.0)
    if (signs < 0.0).any():
        which = ", ".join(np.array(components)[signs < 0.0].tolist())
        yield Mistake("signs", f"has the wrong sign in {which}", f"{name} = ±files", signs * e)


def _order(name: str, e: FloatArray, o: FloatArray, components: Sequence[str]) -> Iterator[Mistake]:
    """Yield the order of components that leaves the least, and the same with a factor of each."""
    from scipy.optimize import linear_sum_assignment

    if e.shape[1] < 2:
        return
    cost = ((o[:, :, None] - e[:, None, :]) ** 2).mean(axis=0)
    order = linear_sum_assignment(cost)[1]
    if (order != np.arange(order.size)).any():
        pairs = [f"{components[i]} holds {components[k]}" for i, k in enumerate(order.tolist()) if i != k]
        words = f"has another order: {', '.join(pairs[:4])}{' …' if len(pairs) > 4 else ''}"
        yield Mistake("order", words, f"{name}[i] = files[order[i]]", e[:, order])


def _numbers(values: FloatArray) -> str:
    return ", ".join(f"{x:.3g}" for x in values.tolist())


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else np.inf


def rounding(values: FloatArray) -> float:
    """Return what a log rounds to: its smallest step, or that of 32-bit floats."""
    steps = np.diff(np.unique(values))
    single = float(np.finfo(np.float32).eps) * float(np.abs(values).max(initial=0.0))
    step = float(steps.min()) if steps.size else 0.0
    return max(single, step if step <= COARSE * np.ptp(values) else 0.0)
