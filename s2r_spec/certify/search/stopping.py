"""When a search ends, and the label of its certificate at any time.

The band of :mod:`s2r_spec.certify.bound.confidence` holds at all times at once, with probability ≥ 1 − δ. So a search
may end at any time, for any reason that depends on its outcomes. Under every rule (``settings.stop``) it also ends when
no test can be added, and when the outcomes refute B or R. Before a verdict ends it, the test of R has 20 degrees of
freedom, because an error of R makes intervals narrow and would otherwise go unseen.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.bound.modes import PAPER
from s2r_spec.certify.bound.rounding import at_least
from s2r_spec.certify.bound.sample_complexity import sequential_lower_bound
from s2r_spec.certify.search.acquisition import batch_size, coverage_tests, repeats
from s2r_spec.certify.search.state import SearchState
from s2r_spec.runs.stop_rule import BUDGET


def label(state: SearchState) -> tuple[Label, str]:
    """Return the label, and the reason in one sentence if the certificate is refused or model-based, else ""."""
    refusal, _ = _first_refusal(state)
    if refusal:
        return Label.REFUSED, refusal
    if not is_settled(state):
        return Label.RUNNING, ""
    if state.settings.fitted:
        return Label.MODEL_BASED, f"{', '.join(state.settings.fitted)} fitted on the certificate's own data"
    if state.confidence.width <= state.settings.epsilon:
        return Label.CERTIFIED, ""
    # The verdict is known, R was tested, and no test on a long axis is missing.
    return (Label.DECIDED if state.decided and not coverage_tests(state) else Label.BUDGET), ""


def is_settled(state: SearchState) -> bool:
    """Return whether the search needs no further test, unless the certificate is refused before."""
    if state.final or state.confidence.smallest_norm > state.settings.B:
        return True
    lacking = sum(replicates for _, replicates in coverage_tests(state))
    size = lacking or sum(replicates for _, replicates in repeats(state)) or batch_size(state)
    spent = state.budget is not None and state.outcomes.rollouts + size > state.budget
    if spent or lacking or state.settings.stop == BUDGET:
        return spent
    return state.confidence.width <= state.settings.epsilon or state.decided


def needs_no_norm(state: SearchState) -> bool:
    """Return whether a refused certificate may still state what holds for every B and every kernel.

    Noise, independence and completeness remain assumed. So no such statement follows if R is refuted, if rollouts are
    missing, or if a setting was fitted; nor in the mode ``paper``, whose band rests on another event of probability δ.
    """
    _, of_norm = _first_refusal(state)
    if not of_norm or state.settings.fitted or state.settings.mode == PAPER:
        return False
    return not (_left_out(state) or _refuted_noise(state) or state.confidence.norm_free_empty)


def _first_refusal(state: SearchState) -> tuple[str, bool]:
    """Return the first reason to refuse the certificate, and whether it concerns only B and the kernel; ("", False)."""
    return next(((sentence, of_norm) for sentence, of_norm in _refusals(state) if sentence), ("", False))


def _refusals(state: SearchState) -> Iterator[tuple[str, bool]]:
    """Yield every reason to refuse the certificate, "" where there is none, and whether it concerns only the norm.

    The first one counts. Those after it are not computed: with bounds that contradict each other they mean nothing.
    """
    yield state.obstacles.constant, True
    yield "" if state.final else state.obstacles.too_many, True
    yield _left_out(state), False
    yield _refuted_noise(state), False
    yield _contradiction(state), True
    over = is_settled(state)
    yield _refuted_norm(state) if over else "", True
    yield _impossibility(state), False
    yield state.coverage.uncovered(state.tested, state.outcomes.samples.counts) if over else "", True


def _left_out(state: SearchState) -> str:
    words = f"rollouts are missing: {state.missing}; leaving out rollouts biases the bound"
    return words if state.missing else ""


def _refuted_noise(state: SearchState) -> str:
    delta, log_e = state.settings.delta, state.outcomes.log_e
    if log_e < math.log(1 / delta):
        return ""
    return (
        f"R = {state.settings.R:g} is refuted by the scatter of replicates (e-value 10^{log_e / math.log(10):.1f} "
        f"≥ 1/δ = {1 / delta:.3g}); choose R by `s2r pilot` and begin a new run"
    )


def _contradiction(state: SearchState) -> str:
    if not state.confidence.bounds.empty:
        return ""
    return (
        "the bounds of different times contradict each other: B, the kernel or R is wrong "
        "(with all of them right this happens with probability ≤ δ)"
    )


def _refuted_norm(state: SearchState) -> str:
    B, B_low = state.settings.B, state.confidence.smallest_norm
    if 2 * B_low <= B:
        return ""
    remedy = (
        f"the lengthscale of {state.coverage.names} may be wrong: it is longer than the range"
        if state.coverage.axes
        else "choose B by `s2r pilot` and begin a new run"
    )
    return f"B = {B:g} is less than twice the norm that the data already show (B_low = {at_least(B_low)}); {remedy}"


def _impossibility(state: SearchState) -> str:
    settings, width, rollouts = state.settings, state.confidence.width, state.outcomes.rollouts
    if width > settings.B or rollouts >= sequential_lower_bound(settings.R, width, settings.delta):
        return ""
    return (
        f"an interval of {width:.3g} after {rollouts} rollouts is below what any method can claim: "
        f"this is a defect of s2r, please report it"
    )
