"""An assertion for tests: a recorded trace satisfies a specification."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import Any

from s2r_spec import logs
from s2r_spec.base.errors import UsageError
from s2r_spec.lang.amounts import Amount
from s2r_spec.robustness.reading import Missing
from s2r_spec.spec import Spec, load_spec
from s2r_spec.trace import Trace


def assert_robust(
    trace: Trace | str | PathLike[str],
    spec: Spec | str | PathLike[str],
    requirement: str | None = None,
    *,
    params: Mapping[str, Amount] | None = None,
    at_least: float = 0.0,
    nan: Missing = "error",
) -> dict[str, float]:
    """Return requirement → ρ if a trace satisfies a specification; else fail like an ``assert``.

    The failure shows the explanation of each violated requirement, as ``print`` and ``s2r monitor`` do.

    Args:
        trace: a trace, or its file.
        spec: a specification, or its file.
        requirement: the requirement to evaluate; None for all.
        params: name → value; on top of those in ``trace.meta["params"]``.
        at_least: smallest ρ that passes, in the unit of ρ. At the default, 0, the comparisons decide at ρ = 0.
        nan: the treatment of a NaN sample, "error" or "hold".

    Raises:
        AssertionError: a requirement is violated, or its ρ is too small.
        UsageError: trace, specification and parameters do not fit together; see :meth:`Spec.robustness`.
    """
    __tracebackhide__ = True  # pytest shows the line of the test
    spec = spec if isinstance(spec, Spec) else load_spec(_path(spec, "spec"))
    names = spec.requirements if requirement is None else (requirement,)
    if not isinstance(trace, Trace):
        trace = logs.read(_path(trace, "trace"))
    recorded = trace.meta.get("params", {})
    known = recorded if isinstance(recorded, Mapping) else {}
    values = {name: known[name] for name in spec.params if name in known} | dict(params or {})
    robustness: dict[str, float] = {}
    failures: list[str] = []
    for name in names:
        one = spec.explain(trace, name, values, nan=nan)
        robustness[name] = one.rho
        if not one.satisfied or one.rho < at_least:
            shortfall = (
                f"\n  but ρ must be at least {at_least:g} {one.unit}".rstrip() if one.satisfied else ""
            )
            failures.append(f"{one}{shortfall}")
    if failures:
        raise AssertionError("\n".join(failures))
    return robustness


def _path(value: Any, what: str) -> str:
    """Return the path of a file.

    Raises:
        UsageError: it is another value.
    """
    if isinstance(value, str | PathLike):
        return str(value)
    kind = "a Trace" if what == "trace" else "a Spec"
    raise UsageError(
        f"{what} must be {kind} or the path of its file, not a value of type {type(value).__name__}"
    )
