"""The certificate of a search, from its state."""

from __future__ import annotations

from typing import Any

from s2r_spec.certify.certificate import ALL_COUNT, Certificate
from s2r_spec.certify.state import State
from s2r_spec.certify.stopping import label
from s2r_spec.rollouts.stop_rule import BUDGET, DECIDED

RULES = {
    DECIDED: (
        "the search may end as soon as the verdict is known (stop = decided); the bound holds at every time",
    ),
    BUDGET: ("only the budget ends the search (stop = budget); the bound holds at every time",),
}
"""Definition: a sentence on each stopping rule but the usual one."""


def certificate(state: State) -> Certificate:
    """Return the certificate from the outcomes so far; valid at any time."""
    settings, confidence, outcomes = state.settings, state.confidence, state.outcomes
    found, reason = label(state)
    ladder = confidence.ladder
    return Certificate(
        lower=ladder[0].lower,
        upper=ladder[0].upper,
        delta=settings.delta,
        target=settings.epsilon,
        label=found,
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


def _record(state: State) -> dict[str, Any]:
    """Return the declaration as plain JSON values."""
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
    }


def _assumptions(state: State) -> tuple[str, ...]:
    settings, names = state.settings, state.coverage.names
    lengthscales = settings.kernel.lengthscales(settings.space.dim)
    scales = ", ".join(
        f"{scale:g} {axis.unit}".rstrip()
        for axis, scale in zip(settings.space.axes, lengthscales, strict=True)
    )
    unit = f" {settings.unit}" if settings.unit else ""
    fixed = (
        f"{state.fixed} outcomes come from tests that were fixed beforehand or chosen only from earlier outcomes, "
        f"and none was left out because of its value",
    )
    inside = (
        f"the lengthscale is longer than the range of {names}: between tests the bound rests on the kernel, "
        f"and every eighth of the range was tested",
    )
    return (
        f"the expected outcome, as a function of the test, has RKHS norm ≤ B = {settings.B:g}{unit} for the "
        f"{settings.kernel.words} kernel with lengthscale {scales}; no data can prove this",
        f"the noise of one rollout is R-sub-Gaussian with R = {settings.R:g}{unit}, declared before the data",
        f"rollouts are independent given the tests, and {ALL_COUNT}",
        *(fixed if state.fixed else ()),
        *RULES.get(settings.stop, ()),
        *(inside if state.coverage.axes else ()),
    )
