"""s2r: what can you promise about the real machine, and why does it differ from the simulator?

import s2r_spec as s2r

spec = s2r.load_spec("specs/a1_velocity.stl")
trace = s2r.load_backend("sim").rollout({"vd": 0.3}, seed=0)
spec.robustness(trace, params={"vd": 0.3})
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from s2r_spec.backend import Backend, Channel, Effect, EffectParameter, Parameter, load_backend
    from s2r_spec.backend.function import FunctionBackend
    from s2r_spec.base.errors import S2RError
    from s2r_spec.base.verdict import Verdict
    from s2r_spec.certify.bound.certificate import Certificate, Label
    from s2r_spec.certify.bound.kernels import Kernel
    from s2r_spec.certify.check import CheckResult, check
    from s2r_spec.certify.gap import gap
    from s2r_spec.certify.measure import check_measure
    from s2r_spec.certify.pilot.run import PilotResult, pilot
    from s2r_spec.certify.real_machine import CertifyResult, certify
    from s2r_spec.certify.result.compose import Composition, compose
    from s2r_spec.certify.result.gap_result import GapResult
    from s2r_spec.certify.search.plan import Plan
    from s2r_spec.certify.search.plan_request import plan
    from s2r_spec.certify.search.search import Query, Search
    from s2r_spec.diagnose import Diagnosis, diagnose
    from s2r_spec.logs import read as read_trace
    from s2r_spec.logs import write as write_trace
    from s2r_spec.recordings.log_episodes import read_episodes
    from s2r_spec.report.results import load_result
    from s2r_spec.robustness.profiles import profile
    from s2r_spec.runs.replay import Replay, replay
    from s2r_spec.space import Axis, Space
    from s2r_spec.spec import (
        Evaluation,
        Explanation,
        Monitor,
        RobustInterval,
        RobustnessStream,
        Spec,
        load_spec,
        parse_spec,
    )
    from s2r_spec.testing.assertion import assert_robust
    from s2r_spec.trace import Trace
    from s2r_spec.trace.messages import Messages

    __version__: str

__all__ = [
    "Axis",
    "Backend",
    "Certificate",
    "CertifyResult",
    "Channel",
    "CheckResult",
    "Composition",
    "Diagnosis",
    "Effect",
    "EffectParameter",
    "Evaluation",
    "Explanation",
    "FunctionBackend",
    "GapResult",
    "Kernel",
    "Label",
    "Messages",
    "Monitor",
    "Parameter",
    "PilotResult",
    "Plan",
    "Query",
    "Replay",
    "RobustInterval",
    "RobustnessStream",
    "S2RError",
    "Search",
    "Space",
    "Spec",
    "Trace",
    "Verdict",
    "assert_robust",
    "certify",
    "check",
    "check_measure",
    "compose",
    "diagnose",
    "gap",
    "load_backend",
    "load_result",
    "load_spec",
    "parse_spec",
    "pilot",
    "plan",
    "profile",
    "read_episodes",
    "read_trace",
    "replay",
    "write_trace",
]

# Where each name is found when it is first asked for: the help and every worker process import this package,
# and need next to none of it.
_HOMES = {
    "testing.assertion": ("assert_robust",),
    "backend": ("Backend", "Channel", "Effect", "EffectParameter", "Parameter", "load_backend"),
    "certify.bound.certificate": ("Certificate", "Label"),
    "certify.check": ("CheckResult", "check"),
    "certify.result.compose": ("Composition", "compose"),
    "certify.gap": ("gap",),
    "certify.result.gap_result": ("GapResult",),
    "certify.bound.kernels": ("Kernel",),
    "certify.measure": ("check_measure",),
    "certify.pilot.run": ("PilotResult", "pilot"),
    "certify.search.plan": ("Plan",),
    "certify.search.plan_request": ("plan",),
    "certify.real_machine": ("CertifyResult", "certify"),
    "certify.search.search": ("Query", "Search"),
    "diagnose": ("Diagnosis", "diagnose"),
    "base.errors": ("S2RError",),
    "backend.function": ("FunctionBackend",),
    "logs": ("read_trace", "write_trace"),
    "report.results": ("load_result",),
    "robustness.profiles": ("profile",),
    "recordings.log_episodes": ("read_episodes",),
    "runs.replay": ("Replay", "replay"),
    "space": ("Axis", "Space"),
    "spec": (
        "Evaluation",
        "Explanation",
        "Monitor",
        "RobustInterval",
        "RobustnessStream",
        "Spec",
        "load_spec",
        "parse_spec",
    ),
    "trace.messages": ("Messages",),
    "trace": ("Trace",),
    "base.verdict": ("Verdict",),
}
_RENAMED = {"read_trace": "read", "write_trace": "write"}
_HOME = {name: home for home, names in _HOMES.items() for name in names}


class _Package(ModuleType):
    """Keeps s2r.diagnose and s2r.certify functions: a package of that name would take the place as it is imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _HOME and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    """Import what is asked for."""
    if name == "__version__":
        from s2r_spec.base.distribution import version

        return version()
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(f"{__name__}.{_HOME[name]}"), _RENAMED.get(name, name))
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    """Return the public names, imported yet or not."""
    return sorted(__all__)
