"""The A1 backend: Unitree's A1 trotting in MuJoCo under an inverse-dynamics QP."""

from s2r_sim.backend import SimBackend
from s2r_sim.twins import TwinBackend

__all__ = ["SimBackend", "TwinBackend"]
