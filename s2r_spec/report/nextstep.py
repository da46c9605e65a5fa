"""What to do after a diagnosis, in one sentence."""

from __future__ import annotations

from s2r_spec.diagnose.diagnosis import Diagnosis, NextTest, Verdict
from s2r_spec.documentation import page
from s2r_spec.report.checked import test_words
from s2r_spec.spec import Spec

LATE = 0.95
"""Part of a rollout after which a window ends with it."""


def next_step(found: Diagnosis, spec: Spec) -> str:
    """Return the sentence."""
    if found.misread:
        what = " and ".join(found.misread)
        return (
            f"First see to {what} in the recordings, as the notes say, and diagnose again. Until then do not rely "
            f"on the causes."
        )
    which = found.which
    test = "" if which.next_test is None else test_in_words(which.next_test, spec)
    match found.verdict:
        case Verdict.NONE:
            strange = [str(each) for each in found.left[:1] if each.material]
            if strange:
                return (
                    f"For this requirement the simulator may stay as it is. If the motion itself matters, look for "
                    f"the cause of {strange[0]}; the catalogue lacks it ({page('how-to/effects')})."
                )
            return (
                "Leave the simulator as it is for this requirement, and diagnose again when the machine or the "
                "requirement has changed."
            )
        case Verdict.SPREAD:
            use = (
                "Use the simulator with small amounts of all effects (s2r diagnose … --apply FILE --tuned, then "
                "--sim patched:FILE). Bound the remaining gap with s2r gap on fresh rollouts"
            )
            return f"{use}; to see whether one cause stands out, {test}." if test else f"{use}."
        case Verdict.NAMED | Verdict.CONFOUNDED if found.by_falls:
            return (
                "Add the named cause to the simulator (s2r diagnose … --apply FILE, then --sim patched:FILE). Then run "
                "the machine at tests next to those where it falls: the first fall shows the size of the cause."
            )
        case Verdict.NAMED if found.how_far is not None and not found.how_far.shows:
            return (
                "For this requirement the simulator may stay as it is. If the motion itself matters, add the named "
                "cause (s2r diagnose … --apply FILE, then --sim patched:FILE)."
            )
        case Verdict.NAMED:
            what, tuned = ("what is named", "")
            if found.how_far is not None and found.how_far.better_tuned:
                what, tuned = ("what is named, with a little of everything else,", " --tuned")
            use = (
                f"Add {what} to the simulator (s2r diagnose … --apply FILE{tuned}, then --sim patched:FILE), and "
                f"bound the gap that is left with s2r gap on fresh rollouts"
            )
            use += _wider(found)
            return f"{use}; to be surer of the name, {test}." if test else f"{use}."
        case Verdict.CONFOUNDED:
            if test:
                return f"To tell them apart, {test}."
            return (
                f"Measure one of {', '.join(which.confounded)} on the machine by itself: no test was found in this "
                f"test space that distinguishes them."
            )
        case Verdict.UNKNOWN:
            return (
                f"Look for a cause that the catalogue lacks{_place(found)}, and write it as an effect "
                f"({page('how-to/effects')})"
                f"{_wider(found)}."
            )


def test_in_words(test: NextTest, spec: Spec) -> str:
    """Return what to run: "run vd = 0.3 m/s, hold, which tells a from b by 4.0 σ a rollout"."""
    # What the protocol changes stands in its own words.
    own = {name: value for name, value in test.params.items() if name in spec.space.names}
    where = test_words(own, spec.space.units)
    how = f" {test.protocol}" if test.protocol else ""
    many = f"{test.sigma:.1f} σ a rollout"
    return f"run {where or 'the test again'}{how}, which tells {' from '.join(test.separates)} by {many}"


def _wider(found: Diagnosis) -> str:
    """Return what to do about values at the end of their ranges."""
    ends = [f"{e.effect}.{e.parameter}" for e in found.which.estimates if e.at_end]
    return (
        f"; or widen the range of {' and '.join(ends)}, if the machine could have more of it" if ends else ""
    )


def _place(found: Diagnosis) -> str:
    """Return where to look: what no effect leaves of the motion, or the part that shifts most, or when."""
    if found.left and found.left[0].material:
        return f" and that leaves {found.left[0]}"
    where = found.where
    if where is None:
        return ""
    if where.body is not None and (most := where.body.most) is not None:
        part, shift = most
        return f" at the {part.name} ({shift.channel}, {shift.begin:.2f} to {shift.end:.2f} s)"
    window = where.window
    if window is None:
        return f" before the end: {where.pair.reason}" if where.pair.reason else ""
    times = where.pair.times
    if window["end"] - times[0] > LATE * (times[-1] - times[0]):
        return ""  # that it acts before the end says nothing
    # ρ is made where a requirement is nearest to its limit, and a loop carries what happened before.
    return f" that acts before {window['end']:.2f} s, for most of the gap is made from {window['begin']:.2f} s on"
