"""Experiment design: which experiments settle the effects that are possible, and which one to run next."""
