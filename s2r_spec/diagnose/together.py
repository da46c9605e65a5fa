"""The likeliest sets of effects, each fitted by the simulator itself with a little of everything else beside it.

The linear evidence is exact at one point, that of the joint fit. A set that lies far from it
is judged by what the simulator does there; and what the best of them leaves says which effect is missing.
Where rollouts are dear and the bank stands for the simulator, only the few sets that a look could make the likeliest
are simulated: a bank errs most where several effects are large.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.evidence import Set, explained, log_evidence
from s2r_spec.diagnose.joint import Joint
from s2r_spec.diagnose.judge import Sets, temperature
from s2r_spec.diagnose.prepare import State, by_equations

FloatArray = NDArray[np.float64]

LIKELIEST = 5
"""Sets that are simulated at first; of a dear simulator :data:`FEW`."""
FEW = 3
MOST = 13
"""Sets that are simulated at all, while none of more effects than are searched is the likeliest."""
BEFORE_GROWTH = 9
"""Of these, at most, before sets grow: on, while one that was not simulated is the likeliest."""
SEARCHED = 3
"""Effects in the largest sets that are searched without being asked for: of more only those are weighed that differ by
one effect from the likeliest."""
LARGEST = 6
"""Effects in a set."""
HEARD = (2.0, 3.0)
"""A look lowers a set's log probability by no more than the first, for a fit may stop in a wrong valley, and raises
it by no more than the second."""


@dataclass(frozen=True)
class Together:
    """Sets, weighed again.

    Attributes:
        sets: all of them.
        logs: log evidence of each, up to one constant.
        fits: of those that were simulated.
        temperature: by which log evidence is divided.
    """

    sets: Sets
    logs: FloatArray
    fits: dict[Set, Joint]
    temperature: float


def together(state: State, progress: Callable[[int, int], None]) -> Together:
    """Simulate the likeliest sets, and put what they cost in the place of what the linear evidence made of them."""
    fits: dict[Set, Joint] = {}
    grown: dict[Set, None] = {}
    told: dict[Set, float] = {}
    found = Together(state.sets, state.found.logs, fits, state.temperature)

    def look(members: Set, most: int = MOST) -> Together:
        fits[members] = state.beside(members)
        progress(len(fits), most)
        return _weighed(state, fits, grown, told)

    first = FEW if state.simulator.dear else LIKELIEST
    while len(fits) < (FEW if state.by_bank else BEFORE_GROWTH):
        ranked = found.sets.ranked()
        next_best = [(members, p) for members, p in ranked if members not in fits]
        if not next_best or (ranked[0][0] in fits and len(fits) >= first):
            break
        if state.by_bank and next_best[0][1] < ranked[0][1] * np.exp(-HEARD[1]):
            break  # no look would make it the likeliest
        found = look(next_best[0][0])
    while not state.by_bank:
        best = min(fits, key=lambda s: fits[s].cost)
        wider = [tuple(sorted((*best, k))) for k in state.missing(fits[best].rest, best)]
        further = [s for s in wider if s not in fits] if len(best) < SEARCHED else []
        if not further or len(fits) + len(further) > MOST:
            break
        for members in further:
            found = look(members)
    while True:
        # An effect is named beside others only if without it, too, it was the simulator that was asked.
        named = found.sets.ranked()[0][0]
        fewer = [tuple(k for k in named if k != left) for left in named] if len(named) > 1 else []
        looked = () if state.by_bank else (named, *fewer)
        untried = [members for members in looked if members not in fits]
        # For each size that was not searched one set, and it without each of its effects.
        most = MOST + sum(range(SEARCHED + 2, len(named) + 2))
        if untried and len(fits) < most:
            found = look(untried[0], most)
            continue
        # Of four effects at their usual sizes the fourth is more than a little beside three, and not everything else.
        near = dict.fromkeys(_next_to(named, len(state.judge.effects)))
        if len(named) < SEARCHED or near.keys() <= grown.keys():
            break
        grown.update(near)
        found = _weighed(state, fits, grown, told)
    return found


def _next_to(members: Set, effects: int) -> list[Set]:
    """Return the sets with one effect more, of so many, and with another one if sets of this size were not searched."""
    others = [k for k in range(effects) if k not in members]
    wider = [(*members, k) for k in others] if len(members) < LARGEST else []
    swapped = [(*(m for m in members if m != left), k) for left in members for k in others]
    return [tuple(sorted(s)) for s in wider + (swapped if len(members) > SEARCHED else [])]


def _weighed(state: State, fits: dict[Set, Joint], grown: Iterable[Set], told: dict[Set, float]) -> Together:
    """Return all sets, and those that have ``grown``; those that were simulated by what they cost.

    What the equations say of a set is kept in ``told``: of one of many parameters that takes a while.
    """
    misfit = min(fit.misfit for fit in (state.fitted, *fits.values()))
    warmth = temperature(state.count, misfit, state.judge.weights)
    known = set(state.found.members)
    members = (*state.found.members, *dict.fromkeys(s for s in (*fits, *grown) if s not in known))
    more = log_evidence(state.data, members[len(state.found.members) :])
    logs = np.concatenate([state.found.logs, more])
    # Half of this was taken for what a set leaves of the data, in units of the joint fit's own misfit, and for what
    # its coordinates cost.
    size, scale = state.view.data.size, state.data.scale
    cost = {s: fit.misfit * size / scale + (fit.cost - fit.misfit * size) for s, fit in fits.items()}
    logs = corrected(members, logs, cost, {s: explained(state.data, s) for s in fits}, warmth)
    evidence = replace(state.found, members=members, logs=logs)
    heard = None
    if state.heard is not None:
        new = [s for s in members if s not in told]
        told.update(zip(new, _by_equations(state, new), strict=True))
        heard = np.array([told[s] for s in members])
    sets = state.judge.sets(evidence, state.memberships, warmth, state.unknown, heard)
    return Together(sets, logs, fits, warmth)


def corrected(
    members: Sequence[Set],
    logs: FloatArray,
    cost: Mapping[Set, float],
    expected: Mapping[Set, float],
    warmth: float,
) -> FloatArray:
    """Return (sets,) log evidence: of sets that were simulated by what they cost, of others as these erred.

    With one effect more a set costs no more than without: a fit that did stopped in a wrong valley. And it gains no
    more by that effect than the simulator found, whatever the linear model makes of it. What was not simulated is taken
    to err as all did in the median, or as those that have one effect more or less, if these cost more than that.

    Args:
        members: the sets.
        logs: (sets,) log evidence by the linear model.
        cost: of those that were simulated.
        expected: the same by the linear model.
        warmth: by what log evidence is divided before it is believed.
    """
    if not cost:
        return logs
    place = {s: n for n, s in enumerate(members)}
    least = {s: min(cost[some] for some in cost if set(some) <= set(s)) for s in cost}
    moved = {s: -0.5 * (least[s] - expected[s]) for s in cost}
    usual = float(np.median(list(moved.values())))
    found: dict[Set, float] = {}
    for s in sorted(cost, key=len):
        far = float(np.clip(moved[s] - usual, -HEARD[0] * warmth, HEARD[1] * warmth))
        fewer = [some for some in found if set(some) < set(s)]
        found[s] = min(
            [float(logs[place[s]]) + far, *(found[some] + 0.5 * (least[some] - least[s]) for some in fewer)]
        )
    erred = {s: found[s] - float(logs[place[s]]) for s in found}

    def error(s: Set) -> float:
        near = [erred[some] for some in erred if len(set(some) ^ set(s)) == 1]
        # That another costs little is its own merit.
        return erred[s] if s in erred else min(float(np.median(near or [0.0])), 0.0)

    after: FloatArray = logs + np.array([error(s) for s in members])
    return after


def _by_equations(state: State, members: list[Set]) -> list[float]:
    """Return what the equations of motion say of these sets; they are asked."""
    found = by_equations(state.heard, state.judge.effects, members) if members else None
    return [] if found is None else found.tolist()
