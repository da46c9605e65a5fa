"""Specifications: requirements on a trace, the test space, and the settings of the certificate."""

from typing import TYPE_CHECKING, Any

from s2r_spec.lang.declarations import CertifySettings, KernelChoice, Param, Signal
from s2r_spec.lang.diagnostics import Diagnostic, SpecError
from s2r_spec.robustness.evaluation import Evaluation
from s2r_spec.robustness.explain import Explanation
from s2r_spec.spec.evaluated import Spec
from s2r_spec.spec.loading import load_spec, parse_spec

if TYPE_CHECKING:
    from s2r_spec.robustness.online.monitor import Monitor, RobustInterval, RobustnessStream

__all__ = [
    "CertifySettings",
    "Diagnostic",
    "Evaluation",
    "Explanation",
    "KernelChoice",
    "Monitor",
    "Param",
    "RobustInterval",
    "RobustnessStream",
    "Signal",
    "Spec",
    "SpecError",
    "load_spec",
    "parse_spec",
]


def __getattr__(name: str) -> Any:
    """Import a name of the online monitor when it is first asked for: a recorded trace needs none."""
    if name not in ("Monitor", "RobustInterval", "RobustnessStream"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from s2r_spec.robustness.online import monitor

    return getattr(monitor, name)
