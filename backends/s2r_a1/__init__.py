"""Unitree's A1 itself, over its own wire."""
