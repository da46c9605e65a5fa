"""A cause that falls alone show: a machine that always falls where its simulator does not, and is else as simulated."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import BACKGROUND
from s2r_spec.diagnose.diagnosis import Diagnosis, Verdict
from s2r_spec.diagnose.estimate import Estimate
from s2r_spec.diagnose.evidence import LARGE
from s2r_spec.diagnose.falls import Culprit, Falls
from s2r_spec.diagnose.how_far import HowFar
from s2r_spec.diagnose.joint import misfit
from s2r_spec.diagnose.prepare import State
from s2r_spec.diagnose.verdict import RIVAL

FloatArray = NDArray[np.float64]

MORE = 9
"""Sizes at which the other rollouts are asked, from the least that makes the simulator fall to the end of its range."""
LITTLE = 3.0
"""Times what every effect does unasked: where less of one ends the simulator early, the nominal machine is near it."""
LACKED = 0.2
"""Probability that what the catalogue lacks makes the machine fall."""
ACCIDENT = 0.02
"""Probability that a machine falls each time at a test, and nothing is wrong with it."""
ASSUMPTION = (
    f"the falls have a cause outside the catalogue with probability {LACKED:g}, and are accidents with "
    f"{ACCIDENT:g}. These two are assumed, not measured. The size of the cause also uses which held-out rollouts fell"
)


@dataclass(frozen=True)
class Accused:
    """An effect, judged by falls and by the rollouts without one.

    Attributes:
        culprit: see there.
        weight: how much of what the effect may be before the data are seen makes the simulator fall, and shows in no
            other rollout.
        estimate: its parameter; the interval has no end but that of the range where the other rollouts set none.
    """

    culprit: Culprit
    weight: float
    estimate: Estimate

    @property
    def patch(self) -> dict[str, dict[str, float]]:
        """Return it as what is added to the simulator."""
        return {self.estimate.effect: {self.estimate.parameter: self.estimate.value}}


def judged(state: State, culprits: Sequence[Culprit]) -> list[Accused]:
    """Return the culprits that the other rollouts allow to be there, likeliest first.

    Args:
        state: of the rollouts that did not fall.
        culprits: of those that did.
    """
    view, catalogue = state.view, state.view.surrogate.catalogue
    names = [curve.line.name for curve in state.signatures.curves]

    def cost(at: FloatArray) -> float:
        rest = view.data - state.simulator.change(at)
        return misfit(rest, view.variance, view.nuisances) * view.data.size

    least = min(cost(state.fitted.at), state.fitted.cost)
    found = []
    for culprit in culprits:
        if culprit.line.name not in names:
            continue
        line = names.index(culprit.line.name)
        end = float((catalogue.upper if culprit.coordinate > 0 else catalogue.lower)[line])
        sizes = np.linspace(culprit.coordinate, end, MORE)
        logs = []
        for size in sizes:
            at = state.fitted.at.copy()
            at[line] = size
            logs.append(-0.5 * max(cost(at) - least, 0.0) / state.temperature - 0.5 * (size / LARGE) ** 2)
        density = np.exp(logs) / (math.sqrt(2.0 * math.pi) * LARGE)
        steps = 0.5 * (density[1:] + density[:-1]) * abs(sizes[1] - sizes[0])
        weight = float(np.sum(steps))
        below = np.concatenate([[0.0], np.cumsum(steps)]) / max(weight, 1e-300)
        value, low, high = (culprit.line.value(float(np.interp(q, below, sizes))) for q in (0.5, 0.05, 0.95))
        estimate = Estimate(
            culprit.line.effect,
            culprit.line.parameter,
            value,
            min(low, high),
            max(low, high),
            culprit.line.unit,
        )
        found.append(Accused(culprit, weight, estimate))
    most = max((each.weight for each in found), default=0.0)
    likely = [each for each in found if each.weight >= RIVAL * most > 0.0]
    best: dict[str, Accused] = {}
    for each in sorted(likely, key=lambda each: -each.weight):
        best.setdefault(each.culprit.line.effect, each)
    return list(best.values())


Measured = Callable[[Mapping[str, Mapping[str, float]]], HowFar | None]
"""From effects and values to how far the gap shrinks with them."""


def named_by_falls(
    found: Diagnosis, state: State, why: Falls | None, measured: Measured | None = None
) -> Diagnosis:
    """Return the diagnosis with what makes the machine fall named, if something alone would.

    Args:
        found: of the rollouts that did not fall, which name nothing.
        state: of these.
        why: what ends the simulator early where the machine falls.
        measured: where falls are a part of the gap: only what closes it is named. None where they were left out, and
            no other gap is material.
    """
    if why is None or why.nominal or not why.culprits:
        return found
    if abs(why.culprits[0].coordinate) < LITTLE * BACKGROUND:
        return found
    accused = judged(state, why.culprits)
    if not accused:
        return found
    far = found.how_far
    shrinks = (
        "No rollouts were held out, so the reduction of the gap was not measured."
        if far is None
        else "The other rollouts show no material gap, so the reduction of the gap was not measured."
    )
    if measured is not None:
        closing = [(each, measured(each.patch)) for each in accused]
        accused = [each for each, after in closing if after is not None and after.material and after.gone]
        if not accused:
            return found
        far = next(after for each, after in closing if each is accused[0])
        assert far is not None
        assert far.share is not None
        shrinks = (
            f"Added to the simulator, it closes {100 * min(far.share[0], 1.0):.0f} % of the held-out gap."
        )
    return _named(found, accused, far, shrinks)


def _named(found: Diagnosis, accused: Sequence[Accused], far: HowFar | None, shrinks: str) -> Diagnosis:
    """Return the diagnosis with the first of these named, and the others not told from it."""
    total = sum(each.weight for each in accused)
    share = 1.0 - LACKED - ACCIDENT
    singles = dict.fromkeys(found.which.singles, 0.0)
    singles |= {each.culprit.line.effect: share * each.weight / total for each in accused}
    names = tuple(each.culprit.line.effect for each in accused)
    first = accused[0]
    others = f" or {' or '.join(names[1:])}" if names[1:] else ""
    which = replace(
        found.which,
        none=ACCIDENT,
        unknown=LACKED,
        singles=singles,
        several=dict.fromkeys(found.which.several, 0.0),
        answer=names[:1],
        confounded=names,
        estimates=(first.estimate,),
        next_test=None,
        spare=(),
    )
    return replace(
        found,
        verdict=Verdict.CONFOUNDED if others else Verdict.NAMED,
        reason=f"The machine falls and the simulator does not. Alone, {first.culprit}{others} makes the simulator fall "
        f"at the same tests. The other rollouts allow no other such effect. {shrinks}",
        which=which,
        how_far=far,
        patch=first.patch,
        tuned={**found.tuned, **first.patch},
        assumptions=(*found.assumptions, ASSUMPTION),
        by_falls=True,
    )
