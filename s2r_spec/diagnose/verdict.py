"""The verdict from probabilities and the held-out gap: which effects are named, not ruled out, or perhaps absent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import BACKGROUND
from s2r_spec.diagnose.catalogue import Catalogue
from s2r_spec.diagnose.diagnosis import RULED_OUT, Diagnosis, Verdict, Which
from s2r_spec.diagnose.evidence import Set
from s2r_spec.diagnose.gap.materiality import Materiality
from s2r_spec.diagnose.how_far import HowFar
from s2r_spec.diagnose.judge import Sets
from s2r_spec.diagnose.remainder import Remainder

FloatArray = NDArray[np.float64]

SURE = 0.9
CLEAR = 0.7
"""Probability from which on a set is named although the gap is not material; :data:`SURE` of each effect does, too."""
RIVAL = 0.2
"""A set this many times as likely as the first is a rival of it."""
RIVALS, AS_LIKELY = 3, 0.5
"""Causes that are told of where none is named: so many at most, and so many times as likely as the first at least."""
IMITATED = 0.1
"""An unknown cause is so much less likely once a patch has closed the held-out gap, or if there is none."""
LITTLE = "a few percent of every effect"
"""Definition: the words for the small effects that every machine has; alone they make no material gap."""


def decided(
    far: HowFar | None,
    unknown: float,
    threshold: float,
    likeliest: float,
    *,
    nothing: bool,
    plain: bool,
    at_end: bool,
    strange: bool,
    matters: bool = False,
) -> tuple[Verdict, float]:
    """Return what is answered of the likeliest set, and how probable a cause outside of the catalogue is in the end.

    Args:
        far: the held-out gap; None where nothing was held out.
        unknown: probability of such a cause by the traces alone.
        threshold: of that, above which it is answered.
        likeliest: probability of the likeliest set, given that the catalogue has the causes.
        nothing: whether that set is empty.
        plain: whether the traces name its effects, although ρ does not need them; see :func:`clear`.
        at_end: whether a named value stands at the end of its range.
        strange: whether something is left of the motion that no effect leaves.
        matters: whether the gap matters at any test; *no material gap* is not answered then.
    """
    alarm = unknown > threshold and not nothing
    if far is None:
        if alarm:
            return Verdict.UNKNOWN, unknown
        return (Verdict.NAMED if not nothing else Verdict.SPREAD if matters else Verdict.NONE), unknown
    # What closes too little to vouch for a name is not named against the odds.
    against = far.unclosed and unknown > (1.0 - unknown) * likeliest
    # As much of a cause as the catalogue has is not enough.
    too_little = far.short and at_end
    stays = far.open or (nothing and far.unexplained) or against or too_little or (far.shows and strange)
    if far.closed or not far.material:
        # Odd traces alone are no unknown cause of a gap that is explained, or that is not there:
        # every machine differs from its simulator in ways that nobody asked about.
        alarm, unknown = False, unknown * IMITATED
        # A gap that a little of everything would make needs no name, unless the traces are clear.
        # Nor is what makes a gap where there is none its cause, however the traces look.
        nothing = nothing or not (far.shows or plain) or far.harmful
    if stays:
        # The patch does not close the gap that it should explain, or something is left that no effect leaves: at
        # least as likely unknown as not.
        return Verdict.UNKNOWN, max(unknown, 0.5 + 0.5 * unknown)
    if alarm:
        return Verdict.UNKNOWN, unknown
    if nothing:
        return (Verdict.SPREAD if far.shows else Verdict.NONE), unknown
    return Verdict.NAMED, unknown


def reason(
    verdict: Verdict,
    which: Which,
    far: HowFar | None,
    named: tuple[str, ...],
    left: Sequence[Remainder] = (),
) -> str:
    """Return the answer in a few sentences: whether the gap is material, the cause, how much of the gap it closes."""
    if verdict in (Verdict.NONE, Verdict.SPREAD):
        return " ".join([_no_cause(verdict, far), *_traces_differ(which, left)])
    ends = [f"{e.effect}.{e.parameter} is at the end of its range." for e in which.estimates if e.at_end]
    if verdict is Verdict.UNKNOWN:
        material = ["The gap is material."] if far is not None and far.material else []
        unexplained = [f"Unexplained: {each}." for each in left[:1] if each.material]
        nearest = f"The nearest is {_listed(named)} ({which.nearest_family})."
        cause = " ".join(["No effect of the catalogue explains the data.", *unexplained, nearest])
        return " ".join([*material, cause, *_closes(far, named), *ends])
    fits, explains = ("fits", "explains") if len(named) == 1 else ("fit", "explain")
    doubt = f"; {' or '.join(which.spare)} may be absent" if which.spare else ""
    if verdict is Verdict.CONFOUNDED:
        cause = f"{_listed(named)} {fits} best{doubt}. The data do not rule out {_others(which, named)}."
    else:
        cause = f"{_listed(named)} {explains} the data best{doubt}."
    if far is None:
        return " ".join([cause, *ends])
    if not far.shows:
        return " ".join([f"The gap in ρ is not material: {LITTLE} would make one as large.", cause, *ends])
    if far.elsewhere:
        material = [_elsewhere(far)]
        closes = _closes(far, named) or ["So its reduction was not measured."]
    else:
        material, closes = ["The gap is material."], _closes(far, named)
    if far.leaves_more:
        closes.append(f"The rest is more than {LITTLE} would leave.")
    return " ".join([*material, cause, *closes, *ends])


def _closes(far: HowFar | None, named: Sequence[str]) -> list[str]:
    """Return how much of the held-out gap the named effects close."""
    if far is None or far.share is None:
        return []
    subject = "it closes" if len(named) == 1 else "they close"
    return [f"Added to the simulator, {subject} {_part(far.share[0])} the held-out gap above scatter."]


def _no_cause(verdict: Verdict, far: HowFar | None) -> str:
    """Return that there is no material gap, or no single cause."""
    if far is None and verdict is Verdict.SPREAD:
        return (
            "The gap is material, but no cause stands out. No rollout was held out to measure its reduction."
        )
    if far is None:
        return f"The traces differ by no more than {LITTLE} would make. No gap was held out to compare."
    if verdict is Verdict.NONE:
        return f"The gap is not material: {LITTLE} would make one as large."
    if far.elsewhere:
        return f"{_elsewhere(far)} No cause stands out."
    part = "the" if far.tuned_share is None else f"{100 * far.tuned_share[0]:.0f} % of the"
    little = f"{LITTLE[0].upper()}{LITTLE[1:]}"
    return f"The gap is material, but no cause stands out. {little} close {part} held-out gap above scatter."


def _elsewhere(far: HowFar) -> str:
    """Return at which tests the gap is material, if it is not on average over the held-out ones."""
    if far.matters:
        return "The gap is material at some tests, but not on average over the held-out tests."
    return "The gap is material, but at no held-out test."


def early_ends(found: Diagnosis, compared: Materiality) -> Diagnosis:
    """Return the diagnosis; not *no material gap* where real and simulated rollouts differ in how many ended early."""
    ended = compared.failures
    if found.verdict is not Verdict.NONE or ended is None or not ended.matters:
        return found
    words = (
        f"The gap is material: {ended.real} of {ended.real_rollouts} real rollouts ended early, and "
        f"{ended.simulated} of {ended.simulated_rollouts} simulated ones. No cause stands out."
    )
    return replace(found, verdict=Verdict.SPREAD, reason=words)


def _traces_differ(which: Which, left: Sequence[Remainder]) -> list[str]:
    """Return by which causes the traces differ although none is named, and what no effect explains."""
    seen = (
        []
        if which.ranked[0][0] == ("none",)
        else [f"The traces do differ, most as with {_likeliest(which)}."]
    )
    return [*seen, *(f"No effect explains {each}." for each in left[:1] if each.material)]


def _listed(names: Sequence[str]) -> str:
    """Return "a, b and c"."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def _likeliest(which: Which) -> str:
    """Return the causes that are nearly as likely as the likeliest one."""
    causes = [(names, p) for names, p in which.ranked if names not in (("none",), ("unknown",))]
    near = [names for names, p in causes[:RIVALS] if p >= AS_LIKELY * causes[0][1]]
    return " or ".join(" and ".join(names) for names in near)


def _others(which: Which, named: tuple[str, ...]) -> str:
    """Return what is not ruled out, in the place of what is named or beside it alone."""
    place, it = ("instead of it", "it") if len(named) == 1 else ("instead of one of them", "them")
    instead = [name for name in which.confounded if name in which.instead]
    beside = [name for name in which.confounded if name not in (*named, *instead)]
    words = [f"{_either(instead)} {place} or beside {it}"] if instead else []
    return ", nor ".join([*words, *([f"{_either(beside)} beside {it}"] if beside else [])])


def _either(names: Sequence[str]) -> str:
    """Return "a, b or c"."""
    return " or ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def _part(share: float) -> str:
    """Return how much of a gap a patch closes, in words."""
    return "none of" if share <= 0.0 else "all of" if share > 1.0 else f"{100 * share:.0f} % of"


def clear(sets: Sets, members: tuple[int, ...], probability: float) -> bool:
    """Return whether the traces name these effects, although ρ does not need them; there may be more beside them."""
    return bool(probability >= CLEAR or certain(sets, members) == members != ())


def certain(sets: Sets, members: Set) -> Set:
    """Return those of these effects that the traces are sure of, whatever is beside them."""
    among = {
        effect: sum(p for s, p in zip(sets.members, sets.probability, strict=True) if effect in s)
        for effect in members
    }
    return tuple(effect for effect in members if among[effect] >= SURE)


def likeliest(seen: Sequence[tuple[Set, float]], told: Sequence[tuple[Set, float]]) -> Set:
    """Return the set to name, of both rankings: the likeliest with an effect, by the evidence.

    Two effects of a kind that fit best together may be one of them, whose law lies between: where a part of the set is
    likelier than the whole once that is reckoned with, the part is named, and the rest is not ruled out.

    Args:
        seen: sets and their probabilities by the evidence, the likeliest first.
        told: the same, shared among effects of a kind.
    """
    named = next(members for members, _ in seen if members)
    return next(members for members, _ in told if members and set(members) <= set(named))


def large(catalogue: Catalogue, named: Set, at: FloatArray) -> Set:
    """Return the effects that are there, of (K,) coordinates, by more than of any machine; all, if none is.

    Sets are weighed before their values are put right: what turns out next to nothing then is no cause beside others.
    """
    lines = ~catalogue.based
    sizes = {k: np.abs(at[lines & (catalogue.owner == k)]).max(initial=0.0) for k in named}
    return tuple(k for k in named if sizes[k] >= BACKGROUND) or named


def confounded(
    isolable: Any, named: tuple[str, ...], by_size: Mapping[int, Mapping[tuple[str, ...], float]]
) -> tuple[str, ...]:
    """Return the named effects and whatever could be in the place of one of them, or beside them.

    That is what these data leave nearly as likely, and what no data at these tests could tell from one of them
    unless they all but rule it out.
    """
    out = list(named)
    top = _first(named, by_size)
    for names, probability in by_size[len(named)].items():
        if probability < RULED_OUT * top or names == named:
            continue
        extra = [n for n in names if n not in named]
        lost = [n for n in named if n not in names]
        near = probability >= RIVAL * top or extra[0] in isolable.confounded(lost[0])
        if len(extra) == 1 and near and extra[0] not in out:
            out.append(extra[0])
    for names, probability in by_size.get(len(named) + 1, {}).items():
        if probability >= RIVAL * top and set(named) < set(names):
            out += [n for n in names if n not in out]
    return tuple(out)


def spare(named: tuple[str, ...], by_size: Mapping[int, Mapping[tuple[str, ...], float]]) -> tuple[str, ...]:
    """Return those of several named effects without which the others are nearly as likely."""
    without = {name: tuple(n for n in named if n != name) for name in named if len(named) > 1}
    top = _first(named, by_size)
    return tuple(
        name for name, others in without.items() if by_size[len(others)].get(others, 0.0) >= RIVAL * top
    )


def _first(named: tuple[str, ...], by_size: Mapping[int, Mapping[tuple[str, ...], float]]) -> float:
    """Return how likely what is named is.

    Of a set with an effect of next to nothing, which was left out of what is named, the rest is as likely as that.
    """
    return max(p for sets in by_size.values() for names, p in sets.items() if set(named) <= set(names))
