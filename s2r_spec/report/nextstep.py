"""The next step after a diagnosis, in one or two sentences."""

from __future__ import annotations

from s2r_spec.diagnose.diagnosis import Diagnosis, NextTest, Verdict
from s2r_spec.documentation import page
from s2r_spec.report.checked import test_words
from s2r_spec.report.gap_words import place_words
from s2r_spec.spec import Spec


def next_step(found: Diagnosis, spec: Spec) -> str:
    """Return the next step for the user."""
    if found.misread:
        what = " and ".join(found.misread)
        return (
            f"First check {what} in the recordings (see the notes), and diagnose again. Until then do not trust any "
            f"cause."
        )
    which = found.which
    test = "" if which.next_test is None else test_in_words(which.next_test, spec)
    match found.verdict:
        case Verdict.NONE:
            unexplained = [str(each) for each in found.left[:1] if each.material]
            if unexplained:
                return (
                    f"For this requirement, leave the simulator as it is. If the motion itself matters, look for "
                    f"the cause of {unexplained[0]}; the catalogue lacks it ({page('how-to/effects')})."
                )
            return (
                "Leave the simulator as it is for this requirement. Diagnose again after the machine or the "
                "requirement has changed."
            )
        case Verdict.SPREAD:
            use = (
                "Use the simulator with small amounts of all effects (s2r diagnose … --apply FILE --tuned, then "
                "--sim patched:FILE). Bound the remaining gap with s2r gap on fresh rollouts"
            )
            return f"{use}. To see whether one cause stands out, {test}." if test else f"{use}."
        case Verdict.NAMED | Verdict.CONFOUNDED if found.by_falls:
            return (
                "Add the named cause to the simulator (s2r diagnose … --apply FILE, then --sim patched:FILE). Then run "
                "the machine at tests next to those where it falls: the first fall shows the size of the cause."
            )
        case Verdict.NAMED if found.how_far is not None and not found.how_far.shows:
            return (
                "For this requirement, leave the simulator as it is. If the motion itself matters, add the named "
                "cause (s2r diagnose … --apply FILE, then --sim patched:FILE)."
            )
        case Verdict.NAMED:
            cause, tuned = "the named cause", ""
            if found.how_far is not None and found.how_far.better_tuned:
                cause, tuned = "the named cause and small amounts of all other effects", " --tuned"
            use = (
                f"Add {cause} to the simulator (s2r diagnose … --apply FILE{tuned}, then --sim patched:FILE). "
                f"Bound the remaining gap with s2r gap on fresh rollouts.{_wider(found)}"
            )
            return f"{use} To confirm the cause, {test}." if test else use
        case Verdict.CONFOUNDED:
            if test:
                return f"To separate them, {test}."
            return (
                f"Measure one of {', '.join(which.confounded)} directly on the machine: no test in this test space "
                f"separates them."
            )
        case Verdict.UNKNOWN:
            return (
                f"Look for a cause outside the catalogue{place_words(found.left, found.where)}. Write it as an effect "
                f"({page('how-to/effects')}).{_wider(found)}"
            )


def test_in_words(test: NextTest, spec: Spec) -> str:
    """Return the test to run: "run vd = 0.3 m/s, hold, which separates a and b by 4.0 σ per rollout"."""
    # The protocol names its own parameters.
    own = {name: value for name, value in test.params.items() if name in spec.space.names}
    where = test_words(own, spec.space.units)
    how = f" {test.protocol}" if test.protocol else ""
    separates = f"separates {' and '.join(test.separates)} by {test.sigma:.1f} σ per rollout"
    return f"run {where or 'the test again'}{how}, which {separates}"


def _wider(found: Diagnosis) -> str:
    """Return the advice on values at the end of their ranges; "" if there are none."""
    ends = [f"{e.effect}.{e.parameter}" for e in found.which.estimates if e.at_end]
    return (
        f" Or widen the range of {' and '.join(ends)}, if the machine can have larger values." if ends else ""
    )
