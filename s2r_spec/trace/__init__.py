"""A recorded signal and its times."""

from s2r_spec.trace.channels import SHOWN
from s2r_spec.trace.trace import Trace, thin

__all__ = ["SHOWN", "Trace", "thin"]
