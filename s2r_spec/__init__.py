"""s2r: what can you promise about the real machine, and why does it differ from the simulator?

import s2r_spec as s2r

spec = s2r.load_spec("specs/a1_velocity.stl")
trace = s2r.load_backend("sim").rollout({"vd": 0.3}, seed=0)
spec.robustness(trace, params={"vd": 0.3})
"""

from s2r_spec.backend import Backend, Channel, Effect, EffectParameter, Parameter, load_backend
from s2r_spec.certify.certificate import Certificate, Label
from s2r_spec.certify.check import CheckResult, Verdict, check
from s2r_spec.certify.compose import Composition, compose
from s2r_spec.certify.kernels import Kernel
from s2r_spec.certify.measure import check_measure
from s2r_spec.certify.search import Query, Search
from s2r_spec.diagnose import Diagnosis, diagnose
from s2r_spec.errors import S2RError
from s2r_spec.logs import read as read_trace
from s2r_spec.logs import write as write_trace
from s2r_spec.space import Axis, Space
from s2r_spec.spec import Evaluation, Explanation, Spec, load_spec, parse_spec
from s2r_spec.trace import Trace

__all__ = [
    "Axis",
    "Backend",
    "Certificate",
    "Channel",
    "CheckResult",
    "Composition",
    "Diagnosis",
    "Effect",
    "EffectParameter",
    "Evaluation",
    "Explanation",
    "Kernel",
    "Label",
    "Parameter",
    "Query",
    "S2RError",
    "Search",
    "Space",
    "Spec",
    "Trace",
    "Verdict",
    "check",
    "check_measure",
    "compose",
    "diagnose",
    "load_backend",
    "load_spec",
    "parse_spec",
    "read_trace",
    "write_trace",
]
