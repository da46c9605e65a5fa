"""A recorded signal and its times."""

from s2r_spec.trace.trace import SHOWN, Trace, thin

__all__ = ["SHOWN", "Trace", "thin"]
