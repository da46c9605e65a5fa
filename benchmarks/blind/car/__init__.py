"""A two-link arm for the blinded check: simulator and real machine by someone outside, who did not know the diagnosis.

``simulator/`` offers the backend ``arm`` where it is on the PYTHONPATH; :mod:`benchmarks.blind.arm.machine` is the
machine, which imports nothing of it. Cases are those of :mod:`benchmarks.blind.outsiders`.
Nothing here is hardware.
"""
