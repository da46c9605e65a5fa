"""A plant in which every force is a smooth function of position and velocity: see ``plant.py``."""

from benchmarks.plants.rollout import Author
from benchmarks.plants.smooth.plant import Plant
from benchmarks.plants.smooth.senses import Senses

SMOOTH = Author("smooth", Plant, Senses)

__all__ = ["SMOOTH"]
