"""A1 trots for the blinded check: a twin of the robot by another code path than ``backends/s2r_sim``.

Shared with the simulator are the system under test (its controller and its
velocity estimator, :mod:`benchmarks.blind.a1.robot`) and the nominal figures
of the A1. The plant, the ground, the drives, the sensors, every effect and
every random number are this package's own. Nothing here is hardware.
"""
