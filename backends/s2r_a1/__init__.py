"""Unitree's A1, over its own wire protocol."""
