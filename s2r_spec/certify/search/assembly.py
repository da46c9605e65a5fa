"""The certificate of a search, from its state."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from s2r_spec.certify.bound.certificate import ALL_COUNT, Certificate, Label
from s2r_spec.certify.bound.kernels import FAMILIES
from s2r_spec.certify.search.state import SearchState
from s2r_spec.certify.search.stopping import label, needs_no_norm
from s2r_spec.runs.stop_rule import BUDGET, DECIDED

RULES = {
    DECIDED: (
        "the search may end as soon as the verdict is known (stop = decided); the bound holds at every time",
    ),
    BUDGET: ("only the budget ends the search (stop = budget); the bound holds at every time",),
}
"""Definition: a sentence on each stopping rule but the usual one."""


def certificate(state: SearchState) -> Certificate:
    """Return the certificate from the outcomes so far; valid at any time."""
    settings, confidence, outcomes = state.settings, state.confidence, state.outcomes
    outcome, reason = label(state)
    ladder = confidence.ladder
    return Certificate(
        lower=ladder[0].lower,
        upper=ladder[0].upper,
        delta=settings.delta,
        target=settings.epsilon,
        label=outcome,
        reason=reason,
        worst=settings.space.point(confidence.points[int(confidence.bounds.lower[0].argmax())]),
        rollouts=outcomes.rollouts,
        iterations=state.batches,
        points=len(outcomes.samples),
        discretisation=ladder[0].discretisation,
        ladder=ladder,
        B_low=confidence.smallest_norm,
        log_e_value=outcomes.log_e,
        assumptions=_assumptions(state),
        settings=_record(state),
    )


def one_sided_certificate(state: SearchState) -> Certificate | None:
    """Return a certificate that the maximum is positive whatever B is; None if the data do not show it.

    Only a certificate that is refused because of B or the kernel has a one-sided one. Its lower end follows from the
    outcomes at the tests alone (:func:`s2r_spec.certify.bound.confidence.norm_free_lower`), and it has no upper end.
    """
    lower = state.confidence.norm_free_lower
    if not (lower > 0 and needs_no_norm(state)):
        return None
    return replace(
        certificate(state),
        label=Label.ONE_SIDED,
        lower=lower,
        worst=state.settings.space.point(state.confidence.norm_free_worst),
        assumptions=_about_rollouts(state),
    )


def _record(state: SearchState) -> dict[str, Any]:
    settings = state.settings
    return {
        "mode": settings.mode,
        "engine": settings.engine,
        "kernel": settings.kernel.name,
        "lengthscales": settings.kernel.lengthscales(settings.space.dim).tolist(),
        "B": settings.B,
        "R": settings.R,
        "delta": settings.delta,
        "epsilon": settings.epsilon,
        "mixture_scales": (state.confidence.mixture * settings.R**2).tolist(),
        "batch": settings.batch,
        "spread": settings.spread,
        "seed": settings.seed,
        "fitted": list(settings.fitted),
        **({"repeats": True} if settings.repeats else {}),
    }


def _assumptions(state: SearchState) -> tuple[str, ...]:
    settings, names = state.settings, state.coverage.names
    lengthscales = settings.kernel.lengthscales(settings.space.dim)
    scales = ", ".join(
        f"{scale:g} {axis.unit}".rstrip()
        for axis, scale in zip(settings.space.axes, lengthscales, strict=True)
    )
    inside = (
        f"the lengthscale is longer than the range of {names}: between tests the bound rests on the kernel, "
        f"and every eighth of the range was tested",
    )
    return (
        f"the expected outcome, as a function of the test, has RKHS norm ≤ B = {_with_unit(state, settings.B)} for the "
        f"{FAMILIES[settings.kernel.name].words} kernel with lengthscale {scales}; no data can prove this",
        *_about_rollouts(state),
        *(inside if state.coverage.axes else ()),
    )


def _about_rollouts(state: SearchState) -> tuple[str, ...]:
    settings = state.settings
    fixed = (
        f"{state.fixed} outcomes come from tests that were fixed beforehand or chosen only from earlier outcomes, "
        f"and none was left out because of its value",
    )
    return (
        f"the noise of one rollout is R-sub-Gaussian with R = {_with_unit(state, settings.R)}, declared before the "
        f"data",
        f"rollouts are independent given the tests, and {ALL_COUNT}",
        *(fixed if state.fixed else ()),
        *RULES.get(settings.stop, ()),
    )


def _with_unit(state: SearchState, value: float) -> str:
    return f"{value:g} {state.settings.unit}".rstrip()
