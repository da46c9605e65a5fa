"""An axis for the blinded check: a twin of the EMPS machine by another code path than ``backends/s2r_emps``.

Shared with the simulator are the system under test (the controller's law and
its two gains), the test (the reference), and the figures of the machine. The
plant, every effect and every random number are this package's own. Nothing
here is hardware.
"""
