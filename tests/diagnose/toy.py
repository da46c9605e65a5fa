"""The machine of :mod:`s2r_swing`, which the command line knows as ``swing``."""

from s2r_swing import EFFECTS, SHOW, SPLIT, TEST, TIMES, Toy

__all__ = ["EFFECTS", "SHOW", "SPLIT", "TEST", "TIMES", "Toy"]
