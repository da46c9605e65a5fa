"""Pools of worker processes: a crash or a hang in a worker loses one call."""
