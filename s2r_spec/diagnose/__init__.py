"""Why the real machine and the simulator differ: where the gap lies, which effect causes it, how far it shrinks."""

from s2r_spec.diagnose.decision import Verdict
from s2r_spec.diagnose.diagnosis import Diagnosis
from s2r_spec.diagnose.run import diagnose

__all__ = ["Diagnosis", "Verdict", "diagnose"]
