"""What a finding does to the verdict: no cause is named that the mistake explains as well."""

from __future__ import annotations

from dataclasses import replace

from s2r_spec.diagnose.diagnosis import Diagnosis, Verdict


def doubted(found: Diagnosis) -> Diagnosis:
    """Return the diagnosis with no cause named that a mistake of the recordings explains as well.

    Where the catalogue explains the recordings as well as the mistake does, the cause stays, and is not sure. Where
    it does not, no cause is left. What is said of the gap alone is said of the recordings as they are.
    """
    rivals = [each for each in found.findings if each.imitates]
    if not rivals or found.verdict is Verdict.UNKNOWN:
        return found
    names, what = " and ".join(found.which.answer), rivals[0].imitates
    if found.verdict in (Verdict.NONE, Verdict.SPREAD):
        gap = found.reason.partition(". ")[0].rstrip(".")
        reason = f"{gap}. But {what} would explain how the recordings differ: check them first."
        return replace(found, reason=reason)
    if all(each.same for each in rivals):
        reason = f"{names} explains the data, and {what} would do the same: check the recordings first."
        return replace(found, verdict=Verdict.CONFOUNDED, reason=reason)
    reason = (
        f"Of the catalogue, {names} fits best, but {what} would do the same and explains more: check the recordings "
        f"first."
    )
    which = replace(found.which, answer=(), confounded=(), spare=(), next_test=None)
    return replace(found, verdict=Verdict.UNKNOWN, reason=reason, which=which, patch={})
