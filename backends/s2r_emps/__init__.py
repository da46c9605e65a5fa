"""The EMPS backend: a motor-driven prismatic axis under its own cascade controller."""

from s2r_emps.backend import EmpsBackend

__all__ = ["EmpsBackend"]
