"""The reason for a verdict in a few sentences: whether the gap is material, the cause, how much it closes."""

from __future__ import annotations

from s2r_spec.attribution.place import Place, ValueRange
from s2r_spec.diagnose.decision import Rule, Verdict
from s2r_spec.diagnose.diagnosis import Diagnosis
from s2r_spec.report.gap_words import join_names

LITTLE = "a few percent of every effect"
"""Definition: the words for the small effects that every machine has; alone they make no material gap."""


def reason(diagnosis: Diagnosis) -> str:
    """Return the reason for the verdict of a diagnosis."""
    material, which = _materiality(diagnosis), diagnosis.which
    match diagnosis.rule:
        case Rule.EFFECT | Rule.OPEN | Rule.RIVALS:
            sentences = [material, f"{_effects(diagnosis, 'explain')} the data best."]
            sentences += _closes(diagnosis) if diagnosis.evidence.shows else []
            if diagnosis.rule is Rule.OPEN:
                others = join_names(diagnosis.evidence.open, "or")
                sentences.append(f"{others} may be there, too; one more experiment would settle it.")
            if diagnosis.rule is Rule.RIVALS:
                others = join_names(diagnosis.evidence.further, "or")
                sentences.append(f"A further cause is there, but the data do not tell which: {others}.")
            sentences += [*_remainder(diagnosis), *_misfit(diagnosis)]
        case Rule.EITHER:
            rivals = join_names([one.effect for one in which.possible], "or")
            cause = f"There is a cause, but the data do not tell which: {rivals}."
            sentences = [material, cause, *_closes(diagnosis)]
        case Rule.SPREAD:
            sentences = [material, "No cause stands out.", *_closes(diagnosis), *_mistake(diagnosis)]
        case Rule.NONE:
            first = which.sets[0][0] if which.sets else ()
            differ = [f"The traces do differ, most as with {join_names(first)}."] if first else []
            sentences = [material, *differ, *_remainder(diagnosis), *_misfit(diagnosis), *_mistake(diagnosis)]
        case Rule.ALIKE:
            cause = f"{_effects(diagnosis, 'explain')} the data, and {_imitation(diagnosis)}"
            sentences = [f"{cause} would do the same: check the recordings first."]
        case Rule.MISTAKE:
            best = f"{_effects(diagnosis, 'fit')} best"
            rival = f"{_imitation(diagnosis)} would do the same and explains more"
            sentences = [f"Of the catalogue, {best}, but {rival}: check the recordings first."]
        case _:
            sentences = [material, "No effect of the catalogue explains the data."]
            sentences += [f"Unexplained: {each}." for each in diagnosis.left[:1] if each.material]
            if which.nearest:
                sentences.append(f"The nearest is {join_names(which.nearest)} ({which.nearest_family}).")
            sentences += [*_closes(diagnosis), *_prediction(diagnosis), *_misfit(diagnosis)]
    return " ".join(sentences)


def _materiality(diagnosis: Diagnosis) -> str:
    """Return whether the gap is material, and where, if not on average over the held-out tests."""
    far, matters = diagnosis.how_far, diagnosis.materiality
    if far is not None and far.material:
        return "The gap is material."
    if not diagnosis.evidence.shows:
        if far is None:
            return "The gap matters at no test." if matters is not None else "The gap was not measured."
        return f"The gap in ρ is not material: {LITTLE} would make one as large."
    ended = None if matters is None or matters.places else matters.failures
    if ended is not None and ended.matters:
        return (
            f"The gap is material: {ended.real} of {ended.real_rollouts} real rollouts ended early, and "
            f"{ended.simulated} of {ended.simulated_rollouts} simulated ones."
        )
    if far is None:
        return "The gap is material. No rollout was held out to measure its reduction."
    return "The gap is material at some tests, but not on average over the held-out tests."


def _effects(diagnosis: Diagnosis, verb: str) -> str:
    """Return the named effects with their verb: "a and b explain"."""
    named = diagnosis.evidence.named
    return f"{join_names(named)} {verb if len(named) > 1 else f'{verb}s'}"


def _closes(diagnosis: Diagnosis) -> list[str]:
    """Return how much of the held-out gap is closed, by the named effects or by all together."""
    far, named = diagnosis.how_far, diagnosis.evidence.named
    ends = [f"{name} is at the end of its range." for name in diagnosis.evidence.at_end]
    if far is not None and named and far.share is not None:
        closes, share = "it closes" if len(named) == 1 else "they close", _part(far.share.estimate)
        more = [f"The rest is more than {LITTLE} would leave."] if far.leaves_more else []
        return [f"Added to the simulator, {closes} {share} the held-out gap above scatter.", *more, *ends]
    if far is not None and not named and far.tuned_share is not None:
        part = _part(far.tuned_share.estimate)
        return [f"Small amounts of all effects close {part} the held-out gap above scatter."]
    return ends


def _part(share: float) -> str:
    """Return how much of a gap is closed, in words."""
    return "none of" if share <= 0.0 else "all of" if share > 1.0 else f"{100 * share:.0f} % of"


def _misfit(diagnosis: Diagnosis) -> list[str]:
    """Return that the traces fit no set of effects, if they do not, and where the misfit is largest."""
    goodness = diagnosis.evidence.goodness
    if goodness is None or not goodness.alarm:
        return []
    worst = goodness.worst
    place = Place(ValueRange(worst.begin, worst.end), worst.part)
    least = f"least of all {worst.quantity} of {worst.experiment} {place}"
    fits = f"No set of effects fits the traces (p = {goodness.p:.2g}), {least}."
    if diagnosis.verdict is Verdict.UNKNOWN:
        return [fits]
    return [fits, "Something differs that this requirement does not need."]


def _prediction(diagnosis: Diagnosis) -> list[str]:
    """Return how much the most probable set leaves, where it is rejected for that."""
    prediction = diagnosis.evidence.prediction
    if prediction is None or not prediction.rejected:
        return []
    part = f"{100.0 * min(prediction.left, 1.0):.0f} %"
    return [f"The best set of effects leaves {part} of the difference in tests that it was not fitted to."]


def _remainder(diagnosis: Diagnosis) -> list[str]:
    """Return the motion that no effect explains, if it is more than what is allowed for."""
    return [f"No effect explains {each}." for each in diagnosis.left[:1] if each.material]


def _mistake(diagnosis: Diagnosis) -> list[str]:
    """Return the mistake of the recordings that would explain a difference without a named cause."""
    if not diagnosis.evidence.rivals:
        return []
    return [f"But {_imitation(diagnosis)} would explain how the recordings differ: check them first."]


def _imitation(diagnosis: Diagnosis) -> str:
    return diagnosis.evidence.rivals[0].imitates
