"""A recorded signal and its times."""

from s2r_spec.trace.trace import SHOWN, Trace, thinned

__all__ = ["SHOWN", "Trace", "thinned"]
