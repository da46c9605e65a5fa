"""Unmodelled effects of a robot of a robot file: the catalogue, and what each does to a model and to the loop."""
