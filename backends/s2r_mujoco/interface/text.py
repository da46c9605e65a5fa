"""A loop as keys of a robot file: its observation, and how an action becomes a target."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from s2r_mujoco.deploy.record import Term
from s2r_mujoco.plan import Plan
from s2r_spec.errors import UsageError


def loop_text(plan: Plan) -> str:
    """Return the keys ``observation``, ``history_by`` and ``action`` of a plan, as lines of TOML.

    Raises:
        UsageError: a term has limits that no key of a robot file states.
    """
    law = plan.law
    lines = [
        "observation = [", *(f"  {{ {_inline(_keys(term, plan))} }}," for term in plan.terms), "]",
        f'history_by = "{plan.history_by}"',
        f"action.scale = {_numbers(law.scale)}", f"action.offset = {_numbers(law.offset)}",
    ]  # fmt: skip
    if law.order is not None:
        lines.append(f"action.order = {law.order.tolist()}")
    return "\n".join(lines) + "\n"


def _keys(term: Term, plan: Plan) -> dict[str, Any]:
    keys: dict[str, Any] = {"term": term.name}
    if term.name == "sensor":
        keys = {"sensor": term.sensor}
    elif term.name == "phase":
        keys = {
            "phase": term.frequency,
            "start": list(term.start or (0.0,)),
            "as": list(term.parts or ("sin", "cos")),
        }
    names = [re.escape(plan.joints.names[k]) for k in term.joints] or list(term.names)
    if names:
        keys["joints"] = names
    if term.clip is not None:
        keys["clip"] = list(_limits_before_scale(term))
    others = {
        "scale": list(term.scale), "history": term.history if term.history > 1 else 0, "late": term.late,
        "newest_first": term.newest_first, "order": list(term.order),
    }  # fmt: skip
    keys |= {name: value for name, value in others.items() if value}
    return keys | ({"frame": term.frame} if term.frame != "body" else {})


def _limits_before_scale(term: Term) -> tuple[float, float]:
    """Return the limits of a term as a robot file has them: before the scale."""
    assert term.clip is not None
    factors = set(term.scale or (1.0,))
    if term.clip_first or factors == {1.0}:
        return term.clip
    if len(factors) > 1 or 0.0 in factors:
        raise UsageError(f"{term.source}: no key of a robot file states limits after scales that differ")
    low, high = sorted(limit / next(iter(factors)) for limit in term.clip)
    return low, high


def _inline(keys: dict[str, Any]) -> str:
    """Return the items of a table of numbers, texts and lists of them, which TOML writes as JSON does."""
    return ", ".join(f"{key} = {json.dumps(value)}" for key, value in keys.items())


def _numbers(values: Iterable[float]) -> str:
    return json.dumps(np.asarray(values, dtype=float).tolist())
