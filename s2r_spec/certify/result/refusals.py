"""What a refused certificate lacks: the smallest B or R with which the same rollouts give an interval.

The event of probability 1 − δ does not depend on B, so that the interval of a larger B holds for whoever can justify
that B. It does depend on R: the interval of a larger R would hold only if that R had been declared before the data.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from s2r_spec.base.verdict import Verdict
from s2r_spec.certify.bound.certificate import Certificate, Label
from s2r_spec.certify.bound.rounding import at_most, interval_text
from s2r_spec.certify.search.search import Search
from s2r_spec.runs.stop_rule import EPSILON

Tests = Iterable[tuple[Mapping[str, float], Sequence[float]]]
"""(test, outcomes) of each query."""


def with_remedy(certificate: Certificate, search: Search, tests: Tests, judged: bool = True) -> Certificate:
    """Return a certificate whose reason names the B or R that would have passed, and the interval with it.

    The search maximises the negative of the quantity that people see; the sentence is about that quantity.

    Args:
        certificate: that of the search; it stays refused.
        search: the search, with all outcomes.
        tests: the outcomes that the search counts, for the interval of a larger R.
        judged: whether the sign of the interval is a verdict.
    """
    if certificate.label not in (Label.REFUSED, Label.ONE_SIDED):
        return certificate
    words = _of_proxy(search, tests, judged) or _of_norm(certificate, judged)
    return replace(certificate, reason=f"{certificate.reason}; {words}") if words else certificate


def _of_norm(certificate: Certificate, judged: bool) -> str:
    declared = certificate.ladder[0]
    if 2 * certificate.B_low <= declared.B and declared.lower <= declared.upper:
        return ""
    least = f"B must be at least {at_most(2 * certificate.B_low)}"
    for rung in certificate.ladder[1:]:
        if 2 * certificate.B_low <= rung.B and rung.lower <= rung.upper:
            words = _interval(rung.lower, rung.upper, judged)
            return f"{least}, and if you can justify B = {rung.B:g}, the interval is {words}"
    return least


def _of_proxy(search: Search, tests: Tests, judged: bool) -> str:
    R = search.least_proxy
    if R <= search.R:
        return ""
    R = float(at_most(R))
    words = f"R = {R:g} is the smallest R that they do not refute"
    again = Search.of(replace(search.settings, R=R, budget=None, stop=EPSILON))
    again.observe(tests, final=True)
    found = again.certificate()
    if not found.label.bounds:
        return words
    return f"{words}; declared beforehand, it would give {_interval(found.lower, found.upper, judged)}"


def _interval(lower: float, upper: float, judged: bool) -> str:
    """Return the interval of the quantity whose negative is in [lower, upper], and the verdict from its sign."""
    words = interval_text(-upper, -lower)
    if not judged:
        return words
    verdict = Verdict.HOLDS if upper <= 0 else Verdict.VIOLATED if lower > 0 else Verdict.UNKNOWN
    return f"{words}: {verdict.value}"
