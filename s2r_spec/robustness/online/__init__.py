"""Robustness while a trace is recorded, with bounded work for each sample and bounded memory."""
