"""Robustness while a trace is being recorded: bounded work for a sample, bounded memory."""
