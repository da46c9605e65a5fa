"""Reporters: one result record in, one text out. By name, as ``--format`` says."""
