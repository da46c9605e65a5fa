"""A turtlebot for blind cases: a twin with another plant and other laws than ``backends/s2r_turtlebot/effects.py``.

Shared with the simulator are the system under test (the controller's ``command`` with its constants) and the tests. The
plant, every effect and every random number are this package's own. Nothing here is hardware.
"""
