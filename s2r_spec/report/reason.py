"""The reason for a verdict in a few sentences: whether the gap is material, the cause, how much it closes.

A gap is *material* on average over tests, and it *matters* at a test: both are about ρ. Traces *differ*.
"""

from __future__ import annotations

from s2r_spec.diagnose.decision import Rule
from s2r_spec.diagnose.diagnosis import Diagnosis
from s2r_spec.diagnose.gap.shares import Share
from s2r_spec.report.gap_words import gap_and_limit_words, join_names, largest_rest_words

LITTLE = "a few percent of every effect"
"""Definition: the words for the small effects that every machine has; alone they make no material gap."""


_NOTHING = "So no effect was estimated: correct the recordings first."


def reason(diagnosis: Diagnosis) -> str:
    """Return the reason for the verdict of a diagnosis."""
    material, which = _materiality(diagnosis), diagnosis.which
    match diagnosis.rule:
        case Rule.BROKEN:
            sentences = ["The recordings break the law of the controller, which no machine does.", _NOTHING]
        case Rule.EFFECT | Rule.OPEN | Rule.RIVALS | Rule.ALONE:
            sentences = [material, *_loop(diagnosis)]
            if diagnosis.evidence.named:
                sentences.append(f"{_effects(diagnosis, 'explain')} the data best.")
            sentences += _closes(diagnosis) if diagnosis.evidence.shows else []
            if diagnosis.rule is Rule.OPEN:
                others = join_names(diagnosis.evidence.open, "or")
                sentences.append(f"{others} may be there, too; one more experiment would settle it.")
            if diagnosis.rule is Rule.RIVALS:
                others = join_names(diagnosis.evidence.doubtful, "or")
                sentences.append(f"There is probably a further cause: {others}.")
            sentences += _remainder(diagnosis)
        case Rule.EITHER:
            evidence = diagnosis.evidence
            rivals = join_names(evidence.doubtful or evidence.named or evidence.mistakes, "or")
            cause = f"There is probably a cause, but the data do not settle it: {rivals}."
            sentences = [material, cause, *_closes(diagnosis)]
        case Rule.SPREAD:
            sentences = [material, "No cause stands out.", *_closes(diagnosis), *_mistake(diagnosis)]
        case Rule.NONE:
            like = f", most as with {join_names(which.nearest)}" if which.nearest else ""
            differ = [f"The traces do differ{like}."] if which.sets and which.sets[0][0] else []
            sentences = [material, *differ, *_remainder(diagnosis), *_mistake(diagnosis)]
        case Rule.ALIKE:
            cause = f"{_effects(diagnosis, 'explain')} the data, and {_imitation(diagnosis)}"
            sentences = [f"{cause} would do the same: check the recordings first."]
        case Rule.MISTAKE:
            best = f"{_effects(diagnosis, 'fit')} best"
            rival = f"{_imitation(diagnosis)} would do the same and explains more"
            sentences = [f"Of the catalogue, {best}, but {rival}: check the recordings first."]
        case _:
            sentences = [material, *_loop(diagnosis), "No effect of the catalogue explains the data."]
            if diagnosis.evidence.loop is not None and (likely := diagnosis.evidence.loop.possible):
                sentences.append(
                    f"The code around the controller may have a mistake: {join_names(likely, 'or')}."
                )
            sentences += [
                f"Unexplained: {each}." if each.material else f"The {largest_rest_words(each)}."
                for each in diagnosis.left[:1]
            ]
            if which.nearest:
                sentences.append(f"The nearest is {join_names(which.nearest)} ({which.nearest_family}).")
            sentences += [*_closes(diagnosis), *_misfit(diagnosis)]
    return " ".join(sentences)


def _materiality(diagnosis: Diagnosis) -> str:
    """Return whether the gap is material, and where, if not on average over the held-out tests."""
    far, matters = diagnosis.how_far, diagnosis.materiality
    if far is not None and far.material:
        mean, most = gap_and_limit_words(far)
        own = f"On average over the held-out tests, the gap of {mean} is material"
        return f"{own}: scatter and {LITTLE} make at most {most}."
    if not diagnosis.evidence.shows:
        if far is None:
            return "The gap matters at no test." if matters is not None else "The gap was not measured."
        return f"The gap in ρ is not material: {LITTLE} would make one as large."
    ended = None if matters is None or matters.places else matters.failures
    if ended is not None and ended.matters:
        return (
            f"The gap matters: {ended.real} of {ended.real_rollouts} real rollouts ended early, and "
            f"{ended.simulated} of {ended.simulated_rollouts} simulated ones."
        )
    if far is None:
        return "The gap matters at some tests. No rollout was held out to measure its reduction."
    if far.elsewhere:
        return "The gap is material on average over the other tests, but not over the held-out tests."
    return "The gap matters at some tests, but on average over the held-out tests it is not material."


def _effects(diagnosis: Diagnosis, verb: str) -> str:
    """Return the named effects with their verb: "a and b explain"."""
    named = diagnosis.evidence.named
    return f"{join_names(named)} {verb if len(named) > 1 else f'{verb}s'}"


def _closes(diagnosis: Diagnosis) -> list[str]:
    """Return how much of the gap is closed where it shows, by the named effects or by all together."""
    far, named = diagnosis.how_far, (*diagnosis.evidence.mistakes, *diagnosis.evidence.named)
    ends = [f"{name} is at the end of its range." for name in diagnosis.evidence.at_end]
    if far is None:
        return ends
    patched, tuned = far.shares
    if far.material:
        where = "the held-out gap above scatter"
    else:
        where = f"the gap above scatter at the {'other tests' if far.elsewhere else 'tests where it matters'}"
    if named and patched is not None:
        more = (
            [f"The rest is more than {LITTLE} would leave."]
            if far.leaves_more and patched.estimate > 0.0
            else []
        )
        what = _part("it" if len(named) == 1 else "they", len(named) == 1, patched, where)
        return [f"Added to the simulator, {what}", *more, *ends]
    if not named and tuned is not None:
        return [_part("Small amounts of all effects", False, tuned, where)]
    return ends


def _part(what: str, one: bool, share: Share, of: str) -> str:
    """Return how much of a gap the effects close, of which there is one or several, in a sentence."""
    if share.high < 0.0:
        return f"{what} surely make{'s' if one else ''} {of} larger."
    if share.estimate <= 0.0:
        return f"{what} {'does' if one else 'do'} not make {of} smaller."
    part = "all of" if share.estimate > 1.0 else f"{100 * share.estimate:.0f} % of"
    return f"{what} close{'s' if one else ''} {part} {of}."


def _misfit(diagnosis: Diagnosis) -> list[str]:
    """Return how much the most probable set leaves, where it is rejected for that."""
    misfit = diagnosis.evidence.misfit
    if misfit is None or not misfit.rejected:
        return []
    part = f"{100.0 * min(misfit.left, 1.0):.0f} %"
    return [f"The best set of effects leaves {part} of how the traces differ."]


def _remainder(diagnosis: Diagnosis) -> list[str]:
    """Return the motion that no effect explains, if it is more than what is allowed for."""
    return [f"No effect explains {each}." for each in diagnosis.left[:1] if each.material]


def _loop(diagnosis: Diagnosis) -> list[str]:
    """Return the mistakes of the machine's loop, and what shows them."""
    loop = diagnosis.evidence.loop
    if loop is None or not loop.names:
        return []
    return [f"The code around the controller has a mistake: {join_names(loop.names)}.", loop.words]


def _mistake(diagnosis: Diagnosis) -> list[str]:
    """Return the mistake of the recordings that would explain a difference without a named cause."""
    if not diagnosis.evidence.rivals:
        return []
    return [f"But {_imitation(diagnosis)} would explain how the recordings differ: check them first."]


def _imitation(diagnosis: Diagnosis) -> str:
    return diagnosis.evidence.rivals[0].imitates
