"""A two-link arm for the blinded check: simulator and real machine by someone outside, who did not know the diagnosis.

``simulator/`` offers the backend ``arm`` where it is on the PYTHONPATH; :mod:`benchmarks.blind.arm.machine` is the
machine, which imports nothing of it. What both outsiders' sets share, drawing a case and writing it, is here, too.
Nothing here is hardware.
"""
