"""A twin of the robot behind its wire protocol: bytes in, bytes out; in a separate process or in a test."""

from s2r_a1.twin.injects import Inject, read_inject
from s2r_a1.twin.places import PLACES
from s2r_a1.twin.twin import Twin, TwinSettings

__all__ = ["PLACES", "Inject", "Twin", "TwinSettings", "read_inject"]
