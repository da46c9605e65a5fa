"""A plant with nearly rigid contact, Coulomb friction and sampled drives: see ``plant.py``."""

from benchmarks.plants.rollout import Author
from benchmarks.plants.stiff.plant import Plant
from benchmarks.plants.stiff.senses import Senses

STIFF = Author("stiff", Plant, Senses)

__all__ = ["STIFF"]
