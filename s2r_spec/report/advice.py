"""The next step after a diagnosis, in one or two sentences."""

from __future__ import annotations

from s2r_spec.base.documentation import page
from s2r_spec.diagnose.decision import Rule
from s2r_spec.diagnose.diagnosis import Diagnosis
from s2r_spec.diagnose.experiment_design.identifiability import Candidate, Separation
from s2r_spec.report.check import test_words
from s2r_spec.report.gap_words import join_names, place_words
from s2r_spec.spec import Spec


def next_step(diagnosis: Diagnosis, spec: Spec) -> str:
    """Return the next step for the user."""
    if diagnosis.misread:
        what = " and ".join(diagnosis.misread)
        return (
            f"First check {what} in the recordings (see the notes), and diagnose again. Until then do not trust any "
            f"cause."
        )
    test = ""
    if (following := diagnosis.which.next_test) is not None:
        sets = " from ".join(join_names(names) or "nothing" for names in following.separates)
        experiment = experiment_words(following.candidate, spec)
        test = f"run {experiment}, which separates {sets} by {following.sigma:.1f} σ per run"
    match diagnosis.rule:
        case Rule.NONE:
            return _leave(diagnosis)
        case Rule.SPREAD:
            return (
                f"{_spread(diagnosis)} To see whether one cause stands out, {test}."
                if test
                else _spread(diagnosis)
            )
        case Rule.EFFECT | Rule.ALONE if diagnosis.evidence.mistakes:
            wrong = join_names(diagnosis.evidence.mistakes)
            return f"Correct the code around the controller: {wrong}. Then record again."
        case Rule.EFFECT:
            return _add(diagnosis)
        case Rule.OPEN | Rule.EITHER | Rule.RIVALS:
            if test:
                return f"To settle what is open, {test}."
            rivals = join_names([one.effect for one in diagnosis.which.possible], "or")
            missing = [one.best(allowed=False) for one in diagnosis.evidence.separations]
            words = {experiment_words(one.candidate, spec) for one in missing if one is not None}
            allow = f"Allow {join_names(sorted(words), 'or')}, or measure" if words else "Measure"
            return f"{allow} {rivals} directly on the machine: no allowed experiment separates them."
        case _:
            return (
                f"Look for a cause outside the catalogue{place_words(diagnosis.left, diagnosis.where)}. Write it as an "
                f"effect ({page('how-to/effects')}).{_wider(diagnosis)}"
            )


def _spread(diagnosis: Diagnosis) -> str:
    """Return that small amounts of all effects are to be added, if they surely close some of the gap."""
    far = diagnosis.how_far
    share = None if far is None else far.shares[1]
    if share is None or share.low <= 0.0:
        return (
            "Leave the simulator as it is: nothing shows that small amounts of all effects close the gap. Bound it "
            "with s2r gap on fresh rollouts."
        )
    return (
        "Use the simulator with small amounts of all effects (s2r diagnose … --apply FILE --tuned, then --sim "
        "patched:FILE). Bound the remaining gap with s2r gap on fresh rollouts."
    )


def _leave(diagnosis: Diagnosis) -> str:
    """Return that the simulator may stay, and what to look for if the motion matters."""
    unexplained = [str(each) for each in diagnosis.left[:1] if each.material]
    if unexplained:
        return (
            f"For this requirement, leave the simulator as it is. If the motion itself matters, look for the cause of "
            f"{unexplained[0]}; the catalogue lacks it ({page('how-to/effects')})."
        )
    return (
        "Leave the simulator as it is for this requirement. Diagnose again after the machine or the requirement has "
        "changed."
    )


def _add(diagnosis: Diagnosis) -> str:
    """Return that the named cause is to be added to the simulator."""
    if not diagnosis.evidence.shows:
        return (
            "For this requirement, leave the simulator as it is. If the motion itself matters, add the named cause "
            "(s2r diagnose … --apply FILE, then --sim patched:FILE)."
        )
    cause, tuned = "the named cause", ""
    if diagnosis.how_far is not None and diagnosis.how_far.better_tuned:
        cause, tuned = "the named cause and small amounts of all other effects", " --tuned"
    return (
        f"Add {cause} to the simulator (s2r diagnose … --apply FILE{tuned}, then --sim patched:FILE). "
        f"Bound the remaining gap with s2r gap on fresh rollouts.{_wider(diagnosis)}"
    )


def experiment_words(one: Candidate, spec: Spec) -> str:
    """Return an experiment with the units of the specification: "air_sine amplitude = 0.2", "vd = 0.3 m/s"."""
    shown = one.shown
    params = test_words(dict(shown.params), {} if shown.protocol else spec.space.units)
    return " ".join(filter(None, (shown.protocol, params))) or "the test"


def settled_words(one: Separation | None, spec: Spec) -> str:
    """Return which experiment settles a possible effect, or which one would if it were allowed."""
    if one is None:
        return ""
    rivals = join_names([name for name in one.excluded if name not in one.included], "or")
    tells = f"tell it from {rivals}" if rivals else "settle it"
    allowed, other = one.best(allowed=True), one.best(allowed=False)
    if allowed is not None:
        return f"{experiment_words(allowed.candidate, spec)} would {tells} ({allowed.sigma:.1f} σ per run)"
    if other is None:
        return f"no experiment would {tells}"
    words = f"{experiment_words(other.candidate, spec)}, which is not allowed, would ({other.sigma:.1f} σ per run)"
    return f"no allowed experiment would {tells}; {words}"


def _wider(diagnosis: Diagnosis) -> str:
    """Return the advice on values at the end of their ranges; "" if there are none."""
    ends = join_names(diagnosis.evidence.at_end)
    return f" Or widen the range of {ends}, if the machine can have larger values." if ends else ""
