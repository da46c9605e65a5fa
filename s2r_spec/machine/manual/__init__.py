"""A person as the backend: ``--real manual:FOLDER``."""

from s2r_spec.machine.manual.backend import ManualBackend

__all__ = ["ManualBackend"]
