"""Experiment design: which experiments tell effects apart, and which one to run next."""

from s2r_spec.diagnose.design.test_space import basis, grid, unit_box, weights

__all__ = ["basis", "grid", "unit_box", "weights"]
