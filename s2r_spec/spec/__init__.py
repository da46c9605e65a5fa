"""Specifications: requirements on a trace, the test space, and the settings of the certificate."""

from s2r_spec.lang.declarations import CertifySettings, KernelChoice, Param, Signal
from s2r_spec.lang.diagnostics import Diagnostic, SpecError
from s2r_spec.robustness.evaluation import Evaluation
from s2r_spec.robustness.explain import Explanation
from s2r_spec.robustness.online.monitor import Monitor, RobustInterval, RobustnessStream
from s2r_spec.spec.evaluated import Spec
from s2r_spec.spec.loading import load_spec, parse_spec

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
